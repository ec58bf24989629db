"""The runs of a report without their checkpoints: all that its numbers were made of, small enough to be committed."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from gctd3.comparison.groups import typical, with_trace
from gctd3.comparison.runs import READ, Run
from gctd3.errors import RunError
from gctd3.files import OWN_ROBOT, new_directory
from gctd3.robots.own_copy import OwnCopy
from gctd3.runs.evaluate import TRACE
from gctd3.training.saved_configuration import CONFIG

FOLDER = "runs"


def check_keep(runs: Path, out: Path) -> None:
    """Refuse to copy runs to a path that exists already, or to one where the next report would find them twice.

    Raises:
        RunError: If the path exists already, or lies below ``runs``.
    """
    if (out / FOLDER).exists():
        raise RunError(f"{out / FOLDER} exists already: remove it, or choose another out, for keep_runs=true.")
    if out.resolve().is_relative_to(runs.resolve()):
        raise RunError(f"out={out} is below runs={runs}, whose next report would find the copies of keep_runs=true.")


def keep(groups: Mapping[str, Sequence[Run]], out: Path, lost: Sequence[str] = ()) -> None:
    """Copy the files that are read of each run to ``out/runs``; of the traces only those that are drawn.

    Args:
        groups: Runs by the name of their group.
        out: Directory of the report.
        lost: Names of runs without a configuration, which get an empty one.
    """
    copies = (OwnCopy.read(run.directory) for runs in groups.values() for run in runs)
    kept = next((copy for copy in copies if copy is not None and copy.present), None)
    with new_directory(out / FOLDER) as aside:
        for runs in groups.values():
            drawn = typical(with_trace(runs))
            for run in runs:
                for file in READ:
                    if (run.directory / file).is_file() and (run is drawn or file != Path(TRACE)):
                        (aside / run.name / file).parent.mkdir(parents=True, exist_ok=True)
                        shutil.copyfile(run.directory / file, aside / run.name / file)
        if kept is not None:
            # One for all: it may be large, and these runs have no policies that would need it.
            first = next(run for runs in groups.values() for run in runs if run.directory == kept.folder.parent)
            shutil.copytree(kept.folder, aside / first.name / OWN_ROBOT, dirs_exist_ok=True)
        for name in lost:
            (aside / name / CONFIG).parent.mkdir(parents=True)
            (aside / name / CONFIG).touch()
