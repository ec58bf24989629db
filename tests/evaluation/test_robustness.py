"""Robustness results by hand, on robots that step in place, and from the command."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from compositions import walking
from running import command

from gctd3.envs.settings import EnvSettings
from gctd3.errors import ConfigError
from gctd3.evaluation.robustness import DIRECTIONS, Examination, largest, table, weakest
from gctd3.evaluation.settings import Perturbations
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.terminations import Fall, Survive
from gctd3.tasks.velocity import VelocitySettings
from gctd3.tasks.velocity_command import VelocityCommand

NEVER = Perturbations(shove=0.0)
FEW = Perturbations(impulses=(0.5, 300.0), phases=2, starts=3, settle=0.0, recover=0.1, masses=(1.2,), delays=(1,))


def test_the_largest_impulse_by_hand():
    rates = np.array([[1.0, 1.0, 0.8, 1.0], [0.9, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0], [np.nan, 1.0, 1.0, 1.0]])
    # One that survives more by luck after failing less does not count.
    assert largest(rates, [2, 4, 8, 16]) == pytest.approx([4.0, 0.0, 16.0, np.nan], nan_ok=True)


def test_the_weakest_moment_by_hand():
    results = {"pushes": {"largest": {"forward": [8.0, 2.0, 4.0], "backward": [8.0, None, 4.0]}}}
    assert weakest(results, "forward") == 2.0
    assert math.isnan(weakest({"pushes": None}, "forward"))
    # Nobody was pushed at one phase, so nothing is known of the weakest, wherever it stands.
    for values in ([None, 5.0], [5.0, None]):
        assert math.isnan(weakest({"pushes": {"largest": {"forward": values}}}, "forward"))


@pytest.mark.parametrize(
    "change, said",
    [
        ({"impulses": (4.0, 2.0)}, "impulses must hold numbers above 0 that rise, got [4.0, 2.0]."),
        ({"impulses": ()}, "impulses must hold"),
        ({"impulses": (0.0, 2.0)}, "impulses must hold"),
        ({"masses": (0.0,)}, "masses must hold factors above 0, got [0.0]."),
        ({"frictions": (-1.0,)}, "frictions must hold"),
        ({"delays": (0,)}, "delays must hold"),
        ({"phases": 0}, "phases must be at least 1, got 0."),
        ({"recover": 0.0}, "recover must be above 0 s, got 0.0."),
        ({"shove_every": 0.0}, "shove_every must be above 0 s, got 0.0."),
        ({"shove": -1.0}, "shove must be at least 0, got -1.0."),
        ({"angle_noise": -0.1}, "angle_noise must be at least 0, got -0.1."),
    ],
)
def test_wrong_perturbations_are_named(change, said):
    with pytest.raises(ConfigError) as caught:
        Perturbations(**change)
    assert said in str(caught.value)


class Stepping:
    """Lift one bent leg after the other, twice a second, by the clock: no walk, but with touchdowns."""

    def __init__(self, dt):
        self.dt, self.step = dt, 0

    def __call__(self, state):
        phase = math.sin(2 * math.pi * 2.0 * self.dt * self.step)
        self.step += 1
        legs = [(0.5 * up, 1.0 - 1.2 * up, 0.4 * up) for up in (max(phase, 0.0), max(-phase, 0.0))]
        action = torch.tensor([value for leg in legs for value in leg], dtype=torch.float32)
        return state.set("action", action.clamp(-1, 1).expand(*state.batch_size, 6).clone())


@pytest.fixture(scope="module")
def examination(robot):
    task = walking(robot)
    return Examination(Stepping(task.control_dt), task, EnvSettings(num_envs=2, threads=1), 3, FEW)


def test_a_hard_push_ends_what_a_soft_one_does_not(examination):
    found = examination.pushes(0.5)
    assert set(found["survived"]) == set(DIRECTIONS)
    rates = np.array([found["survived"][direction] for direction in DIRECTIONS], dtype=float)
    assert rates.shape == (2, 2, 2)
    assert found["never_pushed"] < 24
    assert (rates[..., 0] == 1.0).any() and (rates[..., 1] < 1.0).any()
    assert np.nanmax(rates[..., 0] - rates[..., 1]) > 0
    for direction in DIRECTIONS:
        expected = largest(np.array(found["survived"][direction], dtype=float), FEW.impulses)
        assert np.array(found["largest"][direction], dtype=float) == pytest.approx(expected, nan_ok=True)


@pytest.fixture(scope="module")
def run(finished, tmp_path_factory):
    return finished.copy("gctd3", tmp_path_factory.mktemp("trained") / "run")


def test_the_command_tries_everything(run, capsys):
    few = ["episodes=2", "threads=1", "robustness=true", "perturbations.masses=[0.8,1.2]", "perturbations.phases=2"]
    assert command("evaluate", f"run={run}", *few, "perturbations.starts=1", "perturbations.impulses=[1,5]") == 0
    out = capsys.readouterr().out
    found = json.loads((run / "robustness.json").read_text(encoding="utf-8"))
    names = ["as trained", "mass -20 %", "mass +20 %", "friction -50 %", "friction +50 %"]
    names += ["actions 1 step late", "actions 2 steps late", "sensor noise"]
    assert list(found["conditions"]) == names and all(f"\n{name} " in out for name in names)
    evaluation = json.loads((run / "evaluation.json").read_text(encoding="utf-8"))
    plain = found["conditions"]["as trained"]
    assert plain == {key: evaluation[key] for key in plain}
    # What is done to the robot shows.
    assert len({condition["return_mean"] for condition in found["conditions"].values()}) == len(names)
    assert found["perturbations"]["impulses"] == [1.0, 5.0] and found["mass_kg"] == pytest.approx(
        4.02 + 2 * (1.7324 + 0.7527 + 0.4111)
    )
    if found["pushes"] is None:
        assert "no strides, so there are no phases" in out
    assert str(run / "robustness.json") in out


def test_tables_say_what_is_known(examination):
    results = {**examination.results(None)}
    assert "no phases at which to push" in table(results)
    results["pushes"] = {
        "stride_time_s": 0.5,
        "never_pushed": 3,
        "survived": {},
        "largest": {"forward": [0.5, 300.0], "backward": [0.0, None]},
    }
    text = table(results)
    assert "forward                     0.5  ≥ 300" in text and "backward                      0      -" in text
    assert "forward, at the worst moment: 0.5 N s, 0.05 m/s of its mass" in text
    assert "3 robots fell before they could be pushed" in text and "mass +20 %" in text


def test_under_commands_falls_and_errors_are_told_and_robots_are_pushed_on_their_way():
    """Robots that stand in place never fall, but for the pushes, and are as far off as they are told to go."""
    command = VelocityCommand(forward=(0.5, 0.5), side=(0.0, 0.0), turn=(0.0, 0.0), standing=0.0)
    ends = {"fall": Fall(height=None, shanks=False), "time_limit": Survive(100)}
    settings = VelocitySettings(commands={"velocity": command}, terminations=ends, randomisations={})
    task = settings.build(RobotSettings("quadruped"))
    hard = replace(FEW, shove=5.0, shove_every=0.5)

    def still(state):
        return state.set("action", torch.zeros(*state.batch_size, task.facts.actions))

    results = Examination(still, task, EnvSettings(num_envs=4, threads=1), 3, hard).results(None)
    plain, shoved = (results["conditions"][name] for name in ("as trained", "pushes of 5 m/s, 0.5 s apart"))
    assert plain["fall_rate"] == 0.0 < shoved["fall_rate"] and plain["success_rate"] == 1.0
    assert plain["tracked_rate"] == plain["followed_rate"] == 0.0
    assert plain["error_forward"] == pytest.approx(0.5, abs=0.02) and plain["error_turn"] == pytest.approx(0, abs=0.05)
    lines = table(results).splitlines()
    assert lines[1].split()[:5] == ["as", "trained", "100%", "0%", "0%"]
    assert any(line.startswith("pushes of 5 m/s, 0.5 s apart ") for line in lines)
    assert "at most 0.3 m/s in the plane" in table(results)
    assert not any(name.startswith("pushes") for name in Examination(still, task, None, 3, NEVER)._conditions())


def test_wrong_calls_are_answered(run, capsys):
    for argument, said in {
        "robustness=maybe": "robustness must be true or false, got 'maybe'",
        "perturbations.phase=3": "Did you mean 'perturbations.phases'?",
        "perturbations.delays=[1.5]": "perturbations.delays must be a list of a whole number",
        "perturbations.impulses=[3,1]": "perturbations.impulses must hold numbers above 0 that rise",
    }.items():
        assert command("evaluate", f"run={run}", argument) == 2
        assert said in capsys.readouterr().err


def test_another_librarys_task_is_refused(finished, tmp_path, capsys):
    run = finished.copy("library", tmp_path / "run")
    assert command("evaluate", f"run={run}", "robustness=true") == 2
    assert "Walker2d-v5: robustness is for tasks that gctd3 simulates" in capsys.readouterr().err
    assert not (run / "evaluation.json").exists()
