"""The directory of a report: which files may be overwritten, and how a new report replaces an earlier one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gctd3.errors import RunError
from gctd3.files import ASIDE, new_aside, remove

REPORT = "report"
PAGE, VERDICT, FIGURES, TABLES = "index.html", "verdict.txt", "figures", "tables"
# What a report consists of; a directory with the first two is one.
WRITTEN = (PAGE, VERDICT, f"{FIGURES}/*.svg", f"{FIGURES}/*.png", f"{TABLES}/*.csv")


def check_place(out: Path, runs: Path) -> None:
    """Refuse to write a report over something else.

    Args:
        out: Directory to write the report to.
        runs: Directory of the runs, which may be inside ``out``.

    Raises:
        RunError: If ``out`` is no directory, or holds something, but no report.
    """
    existing = next(path for path in (out, *out.absolute().parents) if path.exists() or path.is_symlink())
    if not existing.is_dir():
        raise RunError(f"out={out} cannot be a directory, for {existing} is not one: choose another out.")
    if existing != out or all((out / name).is_file() for name in (PAGE, VERDICT)):
        return
    others = sorted(
        path.name
        for path in out.iterdir()
        if not (path.name.startswith(f".{REPORT}.") and path.name.endswith(ASIDE))
        and not runs.resolve().is_relative_to(path.resolve())
    )
    if others:
        raise RunError(
            f"out={out} holds {', '.join(others[:3])}{', ...' * (len(others) > 3)}, but no report that could be "
            "replaced: choose a new or empty directory."
        )


@contextmanager
def in_place(out: Path) -> Iterator[Path]:
    """Yield a directory to write a report to, which replaces an earlier one in ``out`` once it is complete.

    If the block raises, ``out`` stays as it was.
    """
    out.mkdir(parents=True, exist_ok=True)
    for left in out.glob(f".{REPORT}.*{ASIDE}"):  # by a report that was killed
        remove(left)
    aside = new_aside(out / REPORT, os.mkdir)
    try:
        yield aside
        new = {file.relative_to(aside) for pattern in WRITTEN for file in aside.glob(pattern)}
        old = {file.relative_to(out) for pattern in WRITTEN for file in out.glob(pattern)}
        for file in new:
            (out / file).parent.mkdir(exist_ok=True)
            os.replace(aside / file, out / file)
        for file in old - new:
            (out / file).unlink()
    finally:
        shutil.rmtree(aside, ignore_errors=True)
