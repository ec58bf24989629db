"""Write and read the checkpoints with which a run is continued, evaluated and shipped, each of them whole or absent.

``checkpoints/step-FRAMES`` holds the whole state of a training but the replay's rows, which lie once for all
checkpoints in ``checkpoints/replay``; ``checkpoints/best-FRAMES`` holds the best policy. Every file has a checksum.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tensordict.nn import TensorDictModuleBase
from torch import Tensor

import gctd3
from gctd3.config.build import again
from gctd3.data.frame_buffer import FrameBuffer
from gctd3.errors import RunError
from gctd3.files import (
    MANIFEST,
    check_file,
    load_tree,
    new_directory,
    new_file,
    read_manifest,
    remove,
    remove_leftovers,
    save_tree,
    write_manifest,
)

if TYPE_CHECKING:
    from gctd3.data.replay import StackedBuffer

FORMAT = 2  # of a checkpoint; 1 was TorchRL's own
FOLDER = "checkpoints"
STATE, POLICY, REPLAY = "state.safetensors", "policy.safetensors", "replay"
PACKAGES = ("gctd3", "torch", "torchrl", "tensordict", "mujoco", "dm-control", "numpy")


def versions(more: Iterable[str] = ()) -> dict[str, str]:
    """Return the versions of the packages that a result depends on, and of ``more``."""
    installed = {}
    for package in (*PACKAGES, *more):
        with contextlib.suppress(PackageNotFoundError):
            installed[package] = version(package)
    return installed


class Checkpoints:
    """Write and read the checkpoints of a run.

    Args:
        run: The run's directory.
        keep: Number of the newest checkpoints to keep.
        about: Further content of every manifest: the configuration, the graph.
    """

    def __init__(self, run: Path, keep: int = 2, about: Mapping[str, Any] | None = None) -> None:
        self.run, self.directory, self.keep = run, run / FOLDER, keep
        self.about = dict(about or {})

    def save(self, frames: int, state: Mapping[str, Any], replay: FrameBuffer | StackedBuffer) -> None:
        """Write a checkpoint, then delete the ones before the newest ``keep``.

        Args:
            frames: Frames collected so far; names and orders the checkpoints.
            state: State of everything but the replay.
            replay: Replay buffer. Of a :class:`.FrameBuffer` only the rows are written that no checkpoint has.
        """
        target = self.directory / f"step-{frames:012d}"
        if target.exists():
            return
        with self._room(), new_directory(target) as aside:
            parts = self._save_rows(replay) if isinstance(replay, FrameBuffer) else []
            seal = save_tree(aside / STATE, {**state, "replay": replay.state_dict()})
            write_manifest(aside, self._manifest(frames, {STATE: seal}, replay=parts))
        self._drop()

    def save_best(self, frames: int, policy: TensorDictModuleBase, metrics: Mapping[str, float]) -> None:
        """Write a policy that is better than those before, and delete those."""
        target = self.directory / f"best-{frames:012d}"
        if not target.exists():
            with self._room(), new_directory(target) as aside:
                seal = save_tree(aside / POLICY, dict(policy.state_dict()))
                finite = {key: value for key, value in metrics.items() if math.isfinite(value)}
                write_manifest(aside, self._manifest(frames, {POLICY: seal}, metrics=finite))
        for other in self.directory.glob("best-*"):
            if other != target:
                remove(other)

    def newest(self) -> tuple[dict[str, Any], Iterator[tuple[int, dict[str, Tensor]]]] | None:
        """Return state and replay rows of the newest checkpoint that is whole; ``None`` if there is no checkpoint.

        A damaged one is passed over, with a line on stderr.

        Raises:
            RunError: If all checkpoints are damaged, or have another format.
        """
        self._refuse_other_formats()
        paths = sorted(self.directory.glob("step-*"), reverse=True)
        for path in paths:
            try:
                manifest = checked(path)
                parts = _parts_in(manifest, path)
                for part in parts:
                    check_file(self.directory / REPLAY / part["file"], part["sha256"])
                state: dict[str, Any] = load_tree(path / STATE)
            except RunError as error:
                print(f"Passed over a checkpoint: {error}", file=sys.stderr)
                continue
            rows = ((part["start"], load_tree(self.directory / REPLAY / part["file"])) for part in parts)
            return state, rows
        if paths:
            raise RunError(f"All {len(paths)} checkpoints in {self.directory} are damaged.")
        return None

    def best(self) -> Path:
        """Return the best policy's directory.

        Raises:
            RunError: If no policy has been written.
        """
        self._refuse_other_formats()
        paths = sorted(path for path in self.directory.glob("best-*") if (path / MANIFEST).is_file())
        if not paths:
            raise RunError(f"No policy in {self.directory}: the run was stopped before its first evaluation.")
        # Two only if the one before was about to be dropped.
        return paths[-1]

    def forget_after(self, frames: int) -> bool:
        """Delete checkpoints and policies later than ``frames``, damaged or not: continuing there makes them again.

        Returns:
            Whether a policy was among them, for which an earlier one had been deleted.
        """
        later = [
            path for path in (*self.directory.glob("step-*"), *self.directory.glob("best-*")) if _of(path) > frames
        ]
        for path in later:
            remove(path)
        self._drop()
        return any(path.name.startswith("best-") for path in later)

    def _manifest(self, frames: int, files: Mapping[str, str], **more: Any) -> dict[str, Any]:  # noqa: ANN401
        return {"format": FORMAT, "frames": frames, "versions": versions(), "files": dict(files), **self.about, **more}

    def _save_rows(self, buffer: FrameBuffer) -> list[dict[str, Any]]:
        """Write the new rows, and return the parts that hold all rows of the ring, in order."""
        folder = self.directory / REPLAY
        folder.mkdir(parents=True, exist_ok=True)
        oldest = buffer.total - buffer.filled
        parts = [part for part in self._parts() if part["stop"] > oldest and part["stop"] <= buffer.total]
        start = parts[-1]["stop"] if parts else oldest
        if start < buffer.total:
            name = f"rows-{start:012d}-{buffer.total:012d}.safetensors"
            with new_file(folder / name) as aside:
                seal = save_tree(aside, buffer.rows_between(start, buffer.total))
            parts.append({"file": name, "start": start, "stop": buffer.total, "sha256": seal})
        return parts

    def _parts(self) -> list[dict[str, Any]]:
        """Return the parts of the replay that the newest checkpoint names."""
        for path in sorted(self.directory.glob("step-*"), reverse=True):
            with contextlib.suppress(RunError):
                return _parts_in(read_manifest(path), path)
        return []

    def _drop(self) -> None:
        """Delete checkpoints before the newest ones, parts of the replay that none of those names, and leftovers."""
        remove_leftovers(self.directory)
        paths = sorted(self.directory.glob("step-*"))
        for path in paths[: -self.keep]:
            remove(path)
        named = set()
        for path in paths[-self.keep :]:
            with contextlib.suppress(RunError):
                named |= {part["file"] for part in _parts_in(read_manifest(path), path)}
        for file in (self.directory / REPLAY).glob("*"):
            if file.name not in named:
                remove(file)

    @contextlib.contextmanager
    def _room(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise RunError(
                f"Cannot write a checkpoint to {self.directory}: {error.strerror or error}. Earlier checkpoints are "
                f"whole; once there is room again:  {again(self.about, 'train', f'resume={self.run}')}"
            ) from error

    def _refuse_other_formats(self) -> None:
        if any(self.directory.glob("checkpoint-*")):
            raise RunError(
                f"{self.directory} has checkpoints of format 1, as gctd3 wrote before format {FORMAT}; "
                "train again, or use the version that wrote them."
            )


def _of(path: Path) -> float:
    """Return the frames in the name of a checkpoint or policy; infinity for another name."""
    frames = path.name.partition("-")[2]
    return int(frames) if frames.isdecimal() else math.inf


def checked(path: Path) -> dict[str, Any]:
    """Return the manifest of a checkpoint or policy after checking its format and its files.

    Raises:
        RunError: If it is damaged, or of another format.
    """
    manifest = read_manifest(path)
    versions, files, frames = (manifest.get(key) for key in ("versions", "files", "frames"))
    writer = versions.get("gctd3") if isinstance(versions, dict) else None
    if manifest.get("format") != FORMAT:
        raise RunError(
            f"{path} has format {manifest.get('format')!r}, written by gctd3 {writer!r}; gctd3 {gctd3.__version__} "
            f"reads format {FORMAT}."
        )
    needed = STATE if path.name.startswith("step-") else POLICY
    known = isinstance(versions, dict) and _is_count(frames)
    if not (known and isinstance(files, dict) and needed in files and all(map(_is_file_name, files))):
        raise RunError(f"{path / MANIFEST} is damaged: it must name {needed}, the frames and the versions.")
    for name, seal in files.items():
        check_file(path / name, seal)
    return manifest


def _parts_in(manifest: Mapping[str, Any], path: Path) -> list[dict[str, Any]]:
    """Return the parts of the replay that the manifest of a checkpoint names.

    Raises:
        RunError: If they are not in the form in which :meth:`Checkpoints.save` writes them.
    """
    parts = manifest.get("replay")
    if not isinstance(parts, list) or not all(map(_is_part, parts)):
        raise RunError(
            f"{path / MANIFEST} is damaged: its replay must be a list of parts with file, rows and checksum."
        )
    return list(parts)


def _is_part(part: object) -> bool:
    if not isinstance(part, dict) or not all(_is_count(part.get(key)) for key in ("start", "stop")):
        return False
    return _is_file_name(part.get("file")) and isinstance(part.get("sha256"), str)


def _is_file_name(name: object) -> bool:
    """Tell whether a name in a manifest is that of a file beside it, not a path to elsewhere."""
    return isinstance(name, str) and name == Path(name).name and name not in ("", ".", "..")


def _is_count(number: object) -> bool:
    return isinstance(number, int) and not isinstance(number, bool) and number >= 0


def fit(path: Path, load: Callable[[], object]) -> None:
    """Call ``load``, and raise a :class:`RunError` that names the file if its content does not fit."""
    try:
        load()
    except RunError:
        raise
    except (RuntimeError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise RunError(f"{path} does not fit the run's configuration: {error}") from error
