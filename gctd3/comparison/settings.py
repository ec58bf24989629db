"""Settings of the report."""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.evaluation.settings import EpisodeSettings


@dataclass(frozen=True)
class ReportSettings(EpisodeSettings):
    """Set the runs that ``gctd3.report`` compares, how it evaluates them, and where it writes.

    Attributes:
        episodes: Episodes for evaluating runs that have no evaluation.json; must equal those of existing evaluations.
        seed: Seed of the starts of these episodes, likewise.
        runs: Directory below which the runs are: a sweep of gctd3.train -m, or any folder of runs.
        out: Directory to write to: a new or empty one, or one with an earlier report, which is replaced.
        keep_runs: Also copy there, as runs, the data behind the numbers (some 10 kB a run): runs=OUT/runs makes the
            same report.
    """

    runs: str
    out: str = "report"
    keep_runs: bool = False
