"""The report's gait table, on seeds whose gaits differ, slide or stay near the start."""

import pytest

pytest.importorskip("matplotlib")

from gctd3.comparison.gaits import gaits
from gctd3.comparison.runs import Run

SLIDES = {"periodic_fraction": 0.2, "duty_factor": None, "floquet_max": None, "flight_fraction": 0.1}
FEW = {"periodic_fraction": 0.9, "duty_factor": 0.4, "floquet_max": None, "flight_fraction": 0.3}
WALKS = {"periodic_fraction": 1.0, "duty_factor": 0.6, "floquet_max": 0.5, "flight_fraction": 0.2}


def cells(tmp_path, *found):
    """Return the table's cells for one group of seeds with these gaits, by metric."""
    runs = [
        Run(tmp_path, str(seed), {"seed": seed}, "td3", evaluation={"gait": gait}) for seed, gait in enumerate(found)
    ]
    return {row[0]: row[2] for row in gaits({"td3": runs}).rows}


def test_seeds_without_strides_are_counted(tmp_path):
    said = cells(tmp_path, WALKS, FEW, SLIDES, {})
    assert said["seeds evaluated here"] == "3 of 4"
    assert said["flight"] == "0.20 (0.10 to 0.30)"
    assert said["duty factor"] == "0.50 (0.40 to 0.60); 1 not periodic"
    assert said["largest Floquet multiplier"] == "0.50; 1 too few strides; 1 not periodic"
    assert cells(tmp_path, SLIDES, SLIDES)["duty factor"] == "2 not periodic"
    assert "phase offset" not in said  # no seed has it
    assert cells(tmp_path, {}, {}) == {}  # no seed got far enough for a gait


@pytest.mark.parametrize(
    ("phases", "said"),
    [
        ((0.48, 0.52), "0.50 (0.48 to 0.52)"),
        ((0.98, 0.02, 0.97, 0.03), "0.00 (-0.03 to 0.03)"),  # both feet at once
        ((0.9, 0.8), "0.85 (0.80 to 0.90)"),
    ],
)
def test_phases_of_seeds_are_averaged_around_the_stride(tmp_path, phases, said):
    found = cells(tmp_path, *({**WALKS, "phase_offset": phase} for phase in phases))
    assert found["phase offset"] == said
