"""Settings of the report."""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.evaluation.settings import Judging


@dataclass(frozen=True)
class ReportSettings(Judging):
    """Set what ``gctd3.report`` compares.

    Attributes:
        episodes: Episodes of the evaluation of runs that have no evaluation.json; as many as in those that there are.
        seed: Seed of their starts, likewise.
        runs: Directory below which the runs are: a sweep of gctd3.train -m, or any folder of runs.
        out: Directory to write to: empty, not there yet, or that of an earlier report, which is replaced.
        keep_runs: Also keep there, as runs, what the numbers were made of (some 10 kB a run): runs=OUT/runs makes the
            same report.
    """

    runs: str
    out: str = "report"
    keep_runs: bool = False
