"""Trainings for commanded velocities: each network and algorithm begins one, and a resumed one goes on exactly."""

from itertools import product

import pytest
from finished import BRIEF
from resuming import assert_same_run, stopped
from running import command, rows, train

from gctd3.runs.load import load_run

COMMANDED = ["task=velocity", "robot=quadruped"]


def test_errors_of_the_commands_are_recorded(finished):
    recorded = rows(finished["velocity"])
    assert recorded
    for row in recorded:
        assert 0.0 < float(row["error_forward"]) < 3.0 and 0.0 < float(row["error_side"]) < 3.0
        assert float(row["error_turn"]) > 0.0 and 0.0 <= float(row["fall_rate"]) <= 1.0


@pytest.mark.nightly
def test_stopped_and_resumed_equals_left_alone(finished, tmp_path):
    """The commands that are due, and each robot's share of the box, are saved and restored."""
    part = stopped(tmp_path / "part", 128, "algo=gctd3", *COMMANDED, BRIEF)
    assert command("train", f"resume={part}") == 0
    assert_same_run(finished["velocity"], part)


@pytest.mark.nightly
def test_a_training_begins_with_the_networks_of_another(finished, tmp_path, capsys):
    """Commands may differ; a run of another task observes other things, which is said in a line."""
    wider = "task.commands.velocity.forward=[-1.0,2.0]"
    train(tmp_path / "run", "algo=gctd3", *COMMANDED, wider, f"init={finished['velocity']}")
    assert "Networks begin as" in capsys.readouterr().out
    assert command("train", "algo=gctd3", *COMMANDED, f"init={finished['quadruped']}") == 2
    assert "what a node observes must be the same" in capsys.readouterr().err


CASES = [
    pytest.param(robot, algo, backend, marks=[] if (robot, algo) == ("biped", "sac") else [pytest.mark.nightly])
    for robot, algo, backend in [
        *product(("quadruped", "biped_planar", "hexapod"), ("gctd3", "td3", "sac"), ["batched"]),
        ("quadruped", "sac network=gcn", "dm_control"),
        ("biped", "sac", "batched"),
    ]
]


@pytest.mark.nightly
@pytest.mark.parametrize(("robot", "algo", "backend"), CASES)
def test_robots_networks_and_algorithms(tmp_path, robot, algo, backend):
    algo, *network = algo.split()
    run = train(tmp_path / "run", "task=velocity", f"robot={robot}", f"algo={algo}", *network, f"env.backend={backend}")
    assert rows(run)[-1]["error_forward"]
    assert load_run(run).setup.task.num_counters > 0


def test_wrong_settings_are_answered_in_a_line(capsys, tmp_path):
    for wrong, said in (
        (
            "task.commands.velocity.forward=[1.0,0.5]",
            "task.commands.velocity.forward must be [lowest, highest], got [1.0, 0.5]",
        ),
        ("task.commands.velocity.turn=[]", "task.commands.velocity.turn must be [lowest, highest], got []"),
        ("task.commands.velocity=null", "task.commands must hold a command by the name velocity"),
    ):
        assert command("train", "task=velocity", f"hydra.run.dir={tmp_path / 'run'}", wrong) == 2
        error = capsys.readouterr().err
        assert said in error and len(error.splitlines()) == 1
    assert not (tmp_path / "run").exists()
