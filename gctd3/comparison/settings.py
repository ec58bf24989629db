"""Settings of the report."""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.evaluation.settings import Judging


@dataclass(frozen=True)
class ReportSettings(Judging):
    """What ``gctd3.report`` is asked to do; the judging is that of runs that have no evaluation.

    Attributes:
        runs: Directory below which the runs are.
        out: Directory to write to: empty, not there yet, or that of an earlier report, which is replaced.
        keep_runs: Whether to copy there, as ``runs``, what the numbers were made of.
    """

    runs: str
    out: str = "report"
    keep_runs: bool = False
