"""Files that are written completely or not at all: state as tensors and JSON in one safetensors file, with a checksum.

Nothing here is pickled, so reading a file never executes code from it.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import shlex
import shutil
import stat
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gctd3.errors import RunError

# Deployed policies read files too, on robots without PyTorch: it is imported only where tensors are used.
if TYPE_CHECKING:
    from torch import Tensor

MANIFEST = "manifest.json"
TREE = "tree"  # key of the structure in a file's header
BLOCK = 1 << 20
OWN_ROBOT, OWN_MJCF = "robot", "robot.xml"  # a run's own copy of its robot, and the MJCF in it
ASIDE = ".tmp"  # ending of names under which files are written before they are renamed


def title(place: str) -> str:
    """Return the name of a file that is given by its path or by ``PACKAGE:PATH``: the last part, without its ending."""
    return Path(place.rpartition(":")[2]).stem


def quoted(path: object) -> str:
    """Return a path, or an argument with one, such that it can be pasted into a shell."""
    return shlex.quote(str(path))


def save_tree(path: Path, tree: Any) -> str:  # noqa: ANN401 - any nesting
    """Write nested dicts and lists of tensors, arrays, numbers, texts and ``None``, flushed to the disk.

    Returns:
        The file's checksum.

    Raises:
        OSError: If it cannot be written.
    """
    from safetensors import SafetensorError
    from safetensors.torch import save_file

    tensors: dict[str, Tensor] = {}
    structure = _pack(tree, "", tensors)
    try:
        save_file(tensors, str(path), metadata={TREE: json.dumps(structure)})
    except SafetensorError as error:
        # safetensors gives the system's error as text, without its number.
        full = "No space left" in str(error)
        raise OSError(errno.ENOSPC if full else errno.EIO, os.strerror(errno.ENOSPC) if full else str(error)) from error
    _flush(path)
    return checksum(path)


def load_tree(path: Path) -> Any:  # noqa: ANN401
    """Read the tree that :func:`save_tree` wrote; tuples come back as lists.

    Raises:
        RunError: If the file is missing or damaged.
    """
    from safetensors import SafetensorError, safe_open

    try:
        check_regular(path)
        with safe_open(str(path), framework="pt") as file:
            structure = json.loads((file.metadata() or {})[TREE])
            return _unpack(structure, file)
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise RunError(f"{path} cannot be read: {error}") from error


def _pack(value: Any, path: str, tensors: dict[str, Tensor]) -> Any:  # noqa: ANN401
    import torch

    if isinstance(value, torch.Tensor):
        tensors[path] = value.detach().to("cpu").contiguous().clone()
        return {"tensor": path}
    if isinstance(value, np.ndarray):
        # Row by row: a copy of a transposed array would be transposed, which the format does not hold.
        tensors[path] = torch.from_numpy(np.array(value, order="C"))
        return {"array": path}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        # Pairs, because keys may be whole numbers, and a mapping may hold "tensor" itself.
        return {"pairs": [[key, _pack(item, f"{path}/{key}", tensors)] for key, item in value.items()]}
    if isinstance(value, (list, tuple)):
        return [_pack(item, f"{path}/{i}", tensors) for i, item in enumerate(value)]
    return value


def _unpack(value: Any, file: Any) -> Any:  # noqa: ANN401
    if isinstance(value, list):
        return [_unpack(item, file) for item in value]
    if not isinstance(value, dict):
        return value
    if "pairs" in value:
        return {key: _unpack(item, file) for key, item in value["pairs"]}
    # A tensor lies where the file puts it, at any multiple of its item's size. Matrix libraries choose their kernels by
    # alignment, so a copy in memory of PyTorch's own (at multiples of 64 bytes) is needed to compute the same bits.
    kind = "array" if "array" in value else "tensor"
    tensor = file.get_tensor(value[kind]).clone()
    return tensor.numpy() if kind == "array" else tensor


@contextmanager
def new_directory(path: Path) -> Iterator[Path]:
    """Yield a directory to fill, which is renamed to ``path`` only once it is complete and flushed.

    If the block raises, the directory is removed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = new_aside(path, os.mkdir)
    try:
        yield aside
        _flush(aside)
        os.replace(aside, path)
    except BaseException:
        shutil.rmtree(aside, ignore_errors=True)
        raise
    _flush(path.parent)


def new_aside(path: Path, make: Callable[[Path], None]) -> Path:
    """Make something new beside ``path``, under a name that nobody can know before, and return its path."""
    # A name that can be guessed may be taken already, by a symbolic link to a file elsewhere.
    aside = path.with_name(f".{path.name}.{secrets.token_hex(8)}{ASIDE}")
    make(aside)  # refuses a name that is taken, by a link too
    return aside


def remove(path: Path) -> None:
    """Remove a file, a whole directory, or a symbolic link but not what it points to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def remove_leftovers(directory: Path) -> None:
    """Remove what writes that were killed have left in a directory."""
    for path in directory.glob(f".*{ASIDE}"):
        remove(path)


def refuse_links(directory: Path, besides: Collection[str] = ()) -> None:
    """Refuse a directory in which a symbolic link leads elsewhere: what is written or deleted there is not its own.

    Args:
        directory: The directory; it may be a link itself.
        besides: Names of directories in it that are not looked at.

    Raises:
        RunError: If there is a link in it; the message names the link.
    """
    for here, folders, files in os.walk(directory):
        for name in (*folders, *files):
            path = Path(here, name)
            if path.is_symlink():
                raise RunError(
                    f"{path} is a symbolic link, to {os.readlink(path)}: what a run writes and deletes must be its "
                    "own. Put what it points to in its place."
                )
        folders[:] = [name for name in folders if name not in besides]


def unwritable(directory: Path) -> str | None:
    """Return the reason why no file can be written to a directory, or to the nearest one above it that exists.

    Returns:
        The system's reason; ``None`` if a file can be written.
    """
    existing = next(place for place in (directory, *directory.absolute().parents) if os.path.lexists(place))
    if not existing.is_dir():
        return f"{existing} is not a directory"
    try:
        new_aside(existing / "writable", _make_file).unlink()
    except OSError as error:
        return f"{error.strerror}: {existing}"
    return None


def check_writable(file: Path) -> None:
    """Raise a :class:`RunError` unless a file can be written, before the work whose result it is to hold."""
    if file.is_dir():
        raise RunError(f"out={file} is a directory, a file is expected.")
    reason = unwritable(file.absolute().parent)
    if reason is not None:
        raise RunError(f"out={file} cannot be written: {reason}.")


def _make_file(path: Path) -> None:
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))


@contextmanager
def made(path: Path | None) -> Iterator[None]:
    """Make a directory, if any, and remove it if the block raises and it is empty."""
    if path is not None:
        path.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        if path is not None:
            remove_empty(path)
        raise


def remove_empty(directory: Path) -> None:
    """Remove a directory, and those above it in the working directory, while they are empty."""
    while directory != Path.cwd() and directory.is_dir() and not any(directory.iterdir()):
        directory.rmdir()
        directory = directory.parent
        if Path.cwd() not in directory.parents:
            return


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically: it holds the old content or the new one, never a part of it."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file of bytes atomically, as :func:`write_text` writes text."""
    with new_file(path) as aside:
        aside.write_bytes(content)
        _flush(aside)


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Yield the path of a file to write and flush, which is renamed to ``path`` only afterwards.

    If the block raises, the file is removed.
    """
    aside = new_aside(path, _make_file)
    try:
        yield aside
        os.replace(aside, path)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise
    _flush(path.parent)


def write_manifest(directory: Path, content: Mapping[str, Any]) -> None:
    """Write ``manifest.json`` with a checksum of its content."""
    path = directory / MANIFEST
    whole = {"sha256": seal(content), "content": content}
    path.write_text(json.dumps(whole, sort_keys=True, indent=1), encoding="utf-8")
    _flush(path)


def read_manifest(directory: Path) -> dict[str, Any]:
    """Read the content that :func:`write_manifest` wrote, and verify its checksum.

    Raises:
        RunError: If it is missing or damaged.
    """
    path = directory / MANIFEST
    try:
        check_regular(path)
        whole = json.loads(path.read_text(encoding="utf-8"))
        content: dict[str, Any] = whole["content"]
        if not isinstance(content, dict):
            raise TypeError("its content is no mapping")
        if seal(content) != whole["sha256"]:
            raise RunError(f"{path} is damaged: its checksum does not fit.")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise RunError(f"{path} cannot be read: {error}") from error
    return content


def check_regular(path: Path) -> None:
    """Raise an :class:`OSError` for a pipe, a socket or a device, which may make whoever reads it wait forever."""
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))


def seal(content: Mapping[str, Any]) -> str:
    """Compute the SHA-256 checksum of content that JSON can hold, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def check_file(path: Path, expected: str) -> None:
    """Raise a :class:`RunError` unless ``path`` has the checksum ``expected``."""
    try:
        actual = checksum(path)
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}") from error
    if actual != expected:
        raise RunError(f"{path} is damaged: its checksum does not fit.")


def checksum(path: Path) -> str:
    """Compute the SHA-256 checksum of a file."""
    digest = hashlib.sha256()
    check_regular(path)
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()


def _flush(path: Path) -> None:
    """Wait until a file, or the names in a directory, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
