"""Errors of commanded velocities by hand, and the grid of commands on robots that stand and that fall."""

import json

import numpy as np
import pytest
import torch
from running import command

from gctd3.envs.settings import EnvSettings
from gctd3.errors import ConfigError
from gctd3.evaluation.command_grid import examine, table
from gctd3.evaluation.episode import Episode
from gctd3.evaluation.settings import CommandGrid
from gctd3.evaluation.tracking import errors, followed, is_near, settled, tracking_errors
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.terminations import Fall, Survive
from gctd3.tasks.velocity import VelocitySettings

DT = 0.25  # so that a second is four steps
BOX = np.array([[-0.5, 1.0], [-0.4, 0.4], [-0.8, 0.8]])


def test_the_first_second_of_each_command_does_not_count():
    asked = np.array([[0.5, 0.0, 0.0]] * 6 + [[0.5, 0.1, 0.0]] * 5 + [[0.0, 0.0, 0.0]] * 2)
    assert settled(asked, DT).tolist() == [False] * 4 + [True] * 2 + [False] * 4 + [True] + [False] * 2


def episode(asked, moved, fell=False):
    steps = len(asked)
    nothing = {"hips": np.zeros((steps, 2)), "feet_down": np.zeros((steps, 2), dtype=bool), "success": not fell}
    numbers = {name: np.zeros(steps) for name in ("reward", "position", "height")}
    return Episode(**numbers, **nothing, command=np.array(asked), moved=np.array(moved), fell=fell)


def test_errors_by_hand():
    """Steps 4 and 5 count: |0.4 - 0.5| and |0.8 - 0.5| forward, 0.2 to the side, 0.3 and 0.1 turning."""
    asked = [[0.5, 0.0, -0.3]] * 6
    moved = [[9.0, 9.0, 9.0]] * 4 + [[0.4, 0.2, 0.0], [0.8, -0.2, -0.2]]
    assert errors(episode(asked, moved), DT) == pytest.approx([0.2, 0.2, 0.2])
    # Another one, exact, that fell; and one that fell too soon to count.
    exact, soon = episode(asked, asked, fell=True), episode(asked[:3], asked[:3], fell=True)
    assert errors(soon, DT) is None
    found = tracking_errors([episode(asked, moved), exact, soon], DT)
    # Followed: on average 0.1 m/s and 0.2 rad/s off; not followed: the two that fell.
    expected = {"error_forward": 0.1, "error_side": 0.1, "error_turn": 0.1, "followed_rate": 1 / 3, "fall_rate": 2 / 3}
    # Only the first one did not fall, 0.2 m/s off in both directions.
    expected["tracked_rate"] = 1 / 3
    assert found == pytest.approx(expected)
    assert np.isnan(tracking_errors([soon], DT)["error_forward"])


@pytest.mark.parametrize(
    ("off", "near"),
    [
        # 3-4-5 triangles of 0.15 m/s, and a little more.
        ((0.09, 0.12, 0.0), True),
        ((0.091, 0.121, 0.0), False),
        ((0.0, 0.0, -0.2), True),
        ((0.0, 0.0, 0.21), False),
    ],
)
def test_how_near_a_command_is_followed(off, near):
    assert is_near(np.array(off) * (1 - 1e-9)) is near


def test_each_command_of_an_episode_is_followed_or_not():
    """The mean after a second counts, whatever the sway; a command that was too short does not, and a fall is none."""
    asked = [[0.5, 0.0, 0.0]] * 8 + [[0.0, 0.0, 0.5]] * 8 + [[0.2, 0.0, 0.0]] * 3 + [[0.0, 0.3, 0.0]] * 8
    moved = np.array(asked)
    moved[:4] = 9.0
    moved[4:8, 0] += [1.0, -1.0, 1.0, -1.0]
    moved[8:16, 2] -= 0.3
    assert followed(episode(asked, moved), DT) == [True, False, True]
    assert followed(episode(asked, moved, fell=True), DT) == [True, False, False]
    # It fell before the last command had held for long.
    assert followed(episode(asked[:18], moved[:18], fell=True), DT) == [True, False, False]


def test_the_grid_by_hand():
    rows = CommandGrid(forward=3, side=(0.1,), turn=2).commands(BOX)
    # Standing first, which is not among the others.
    assert rows.tolist() == [
        [0.0, 0.0, 0.0],
        [-0.5, 0.1, -0.8],
        [-0.5, 0.1, 0.8],
        [0.25, 0.1, -0.8],
        [0.25, 0.1, 0.8],
        [1.0, 0.1, -0.8],
        [1.0, 0.1, 0.8],
    ]
    # Standing is not asked for twice, one of many is the middle, and an axis without a range has one number.
    rows = CommandGrid(forward=1, side=3, turn=5).commands(np.array([[-0.5, 0.5], [-0.4, 0.4], [0.0, 0.0]]))
    assert rows.tolist() == [[0.0, -0.4, 0.0], [0.0, 0.0, 0.0], [0.0, 0.4, 0.0]]


def standing(task):
    """Return the policy that holds the standing pose."""
    return lambda state: state.set("action", torch.zeros(*state.batch_size, task.facts.actions))


def test_robots_that_stand_miss_each_command_by_as_much():
    task = VelocitySettings().build(RobotSettings("quadruped"))
    task = task.evaluated(task.reward)

    grid = CommandGrid(forward=(0.6,), side=(0.0, 0.3), turn=(-0.5,), starts=2, seconds=2.0)
    results = examine(standing(task), task, EnvSettings(num_envs=1, threads=1), 0, grid)
    assert [list(one["command"].values()) for one in results["commands"]] == [
        [0, 0, 0],
        [0.6, 0, -0.5],
        [0.6, 0.3, -0.5],
    ]
    for one in results["commands"]:
        assert one["episodes"] == 2 and one["falls"] == 0
        for axis, asked in one["command"].items():
            assert one["mean"][axis] == pytest.approx(0.0, abs=0.02)
            assert one["mean_abs_error"][axis] == pytest.approx(abs(asked), abs=0.03)
    assert [one["followed"] for one in results["commands"]] == [True, False, False]
    assert "1 of 3 commands are followed." in table(results)
    whole = results["whole"]
    assert whole["mean_abs_error"]["forward_m_s"] == pytest.approx(0.4, abs=0.03) and whole["fall_rate"] == 0.0
    assert "0.60    0.30   -0.50" in table(results)


def test_robots_that_fall_at_once_have_no_error():
    # Any tilt is a fall.
    ends = {"fall": Fall(tilt=1e-6), "time_limit": Survive(1000)}
    task = VelocitySettings(terminations=ends).build(RobotSettings("quadruped"))
    task = task.evaluated(task.reward)
    grid = CommandGrid(forward=(0.6,), side=(0.0,), turn=(0.0,), starts=1, seconds=4.0)
    results = examine(standing(task), task, EnvSettings(num_envs=1, threads=1), 0, grid)
    for one in results["commands"]:
        assert one["falls"] == one["episodes"] == 1 and one["mean"] is None and one["mean_abs_error"] is None
    assert results["whole"] == {"commands": 2, "followed": 0, "mean_abs_error": None, "fall_rate": 1.0}
    assert table(results).splitlines()[-2].endswith("100%")


@pytest.mark.nightly
def test_the_command_writes_every_number(finished, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    out = tmp_path / "out"
    grid = ["grid.forward=3", "grid.side=1", "grid.turn=[0.0]", "grid.starts=1", "grid.seconds=1.5"]
    arguments = [f"run={finished['velocity']}", f"out={out}", "episodes=2", "threads=1", "commands=true", *grid]
    assert command("evaluate", *arguments) == 0
    printed = capsys.readouterr().out
    assert "error of the yaw rate, rad/s" in printed and "success rate" not in printed and "mean absolute" in printed
    results, report = (json.loads((out / f"{name}.json").read_text()) for name in ("commands", "evaluation"))
    asked = [one["command"] for one in results["commands"]]
    assert [one["forward_m_s"] for one in asked] == [0.0, -0.5, 0.25, 1.0]
    assert results["grid"]["turn"] == [0.0] and results["settle_s"] == 1.0
    # Episodes with commands that are drawn anew.
    assert 0.0 <= report["fall_rate"] <= 1.0 and "error_side" in report
    assert (out / "commands.png").read_bytes()[:4] == b"\x89PNG"


def test_a_walk_is_not_tested_with_commands(finished, capsys):
    assert command("evaluate", f"run={finished['gctd3']}", "commands=true") == 2
    error = capsys.readouterr().err
    assert "was trained on walk: commands is for task=velocity." in error and len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"forward": 0}, "forward must be at least 1"),
        ({"side": ()}, r"side must be a number of velocities, or a list of them, got \[\]"),
        ({"seconds": 1.0}, "seconds must be above 1, the time that a robot has to settle"),
        ({"starts": 0}, "starts must be at least 1"),
    ],
)
def test_wrong_grids_are_named(wrong, said):
    with pytest.raises(ConfigError, match=said):
        CommandGrid(**wrong)
