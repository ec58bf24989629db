"""NaN and infinite values and diverged robots are named, saved for analysis, and do not affect other robots."""

import csv

import numpy as np
import pytest
import torch
from compositions import env_of, walking
from running import Recorded, command, rows, tiny, train
from suite_robots import load
from thinned import parametrize
from torchrl.envs import Compose, Transform, TransformedEnv

from gctd3.envs.check import CheckStep
from gctd3.envs.simulation import BEGINNING, Simulation
from gctd3.errors import NumericalError
from gctd3.files import load_tree, read_manifest
from gctd3.training.checkpoint import Checkpoints
from gctd3.training.evaluations import Evaluations
from gctd3.training.saved_configuration import load_settings

STEP = 25  # control steps of the four robots before the fault: 100 frames, after the warm-up
ROBOT = 2


class Poisoned(Recorded):
    """Train until the environment, networks or losses give NaN after ``STEP`` steps."""

    poison = staticmethod(lambda trainer: None)

    def _iterate(self, bar):
        if self.counters.frames == 4 * STEP:
            self.save()
            type(self).poison(self)
        super()._iterate(bar)


def poisoned(poison):
    return type("Bad", (Poisoned,), {"poison": staticmethod(poison)})


def bad_output(key, index):
    """Return a function that puts NaN into the environment's next output for ``key``."""

    def poison(trainer):
        env = trainer.collector.env
        step = env.step_and_maybe_reset

        def bad(tensordict):
            done, after = step(tensordict)
            done["next", key][(ROBOT, *index)] = torch.nan
            return done, after

        env.step_and_maybe_reset = bad

    return poison


def bad_state(trainer):
    trainer.collector._state["nodes"][ROBOT, 1, 3] = torch.nan


def bad_actor(trainer):
    for parameter in trainer.explorer.actor.parameters():
        parameter.data.fill_(torch.nan)


def bad_loss(trainer):
    update = trainer.algorithm.update
    trainer.algorithm.update = lambda batch: {**update(batch), "loss_critic": torch.tensor(torch.nan)}


FAULTS = {
    "observation": (bad_output("nodes", (3, 1)), "next.nodes of robot 2 is nan"),
    "what is acted on": (bad_state, "nodes of robot 2 is nan"),
    "reward": (bad_output("reward", (0,)), "next.reward of robot 2 is nan"),
    "action": (bad_actor, "action of robot 0 is nan"),
    "loss": (bad_loss, "loss_critic is nan"),
}


@parametrize(len(FAULTS), "fault", FAULTS)
def test_a_number_that_is_none_ends_the_training(tmp_path, capsys, fault):
    poison, said = FAULTS[fault]
    run = tmp_path / "run"
    before = {}

    def remember(trainer):
        before.update(contents(run / "checkpoints"))
        poison(trainer)

    capsys.readouterr()
    assert command("train", *tiny(run), trainer=poisoned(remember)) == 2
    error = capsys.readouterr().err.split("error: ")
    assert len(error) == 2 and "Traceback" not in error[1]
    assert "After 100 frames and " in error[1] and said in error[1] and str(run / "post_mortem") in error[1]
    # Files saved before are unchanged.
    assert before and contents(run / "checkpoints") == before
    assert Checkpoints(run).newest() is not None
    aside = run / "post_mortem"
    assert said in read_manifest(aside)["error"]
    kept = {file.stem: load_tree(file) for file in aside.glob("*.safetensors")}
    assert kept["state"]["counters"]["frames"] == 100
    collected = kept["collected"]
    if fault in ("observation", "reward"):
        key = {"observation": "nodes", "reward": "reward"}[fault]
        assert collected["next"][key][ROBOT].isnan().any()
    elif fault == "loss":
        assert kept["batch"]["action"].shape == (16, 6)
    else:
        assert collected["nodes" if fault == "what is acted on" else "action"][ROBOT].isnan().any()


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_policy_of_nan_is_not_evaluated(tmp_path, capsys):
    class Bad(Recorded):
        def _evaluate(self):
            bad_actor(self)
            for parameter in self.algorithm.policy().parameters():
                parameter.data.fill_(torch.nan)
            return super()._evaluate()

    capsys.readouterr()
    assert command("train", *tiny(tmp_path / "run", "algo.average_policy=false"), trainer=Bad) == 2
    assert "action of robot 0 is nan" in capsys.readouterr().err
    assert (tmp_path / "run" / "post_mortem").is_dir()


# env.check.


class Poison(Transform):
    """Change one value of one robot in the third step."""

    def __init__(self, key, change):
        super().__init__(in_keys=[], out_keys=[])
        self.key, self.change, self.steps = key, change, 0

    def _step(self, tensordict, next_tensordict):
        self.steps += 1
        if self.steps == 3:
            next_tensordict[self.key] = self.change(next_tensordict[self.key].clone())
        return next_tensordict

    def _reset(self, tensordict, tensordict_reset):
        return tensordict_reset


def spoil(value):
    def change(tensor):
        tensor[ROBOT] = value
        return tensor

    return change


POISONS = {
    "NaN": ("nodes", spoil(torch.nan), "nodes of robot 2 is nan in step 3"),
    "infinite reward": ("reward", spoil(torch.inf), "reward of robot 2 is inf in step 3"),
    "another type": (
        "nodes",
        lambda nodes: nodes.double(),
        r"nodes in step 3 must be .* torch.float32 .* torch.float64",
    ),
    "another shape": ("position", lambda position: position.expand(4, 2), r"position in step 3 must be \[4, 1\]"),
    "out of bounds": ("step_count", spoil(-1), "step_count of robot 2 is -1 in step 3, outside"),
}


@pytest.mark.parametrize("backend", ["batched", "dm_control"])
@pytest.mark.parametrize("case", POISONS)
def test_a_spoiled_step_is_found(task, case, backend):
    key, change, said = POISONS[case]
    env = env_of(task, backend=backend)
    checked = TransformedEnv(
        env.base_env, Compose(*[t.clone() for t in env.transform], Poison(key, change), CheckStep())
    )
    with pytest.raises(NumericalError, match=said):
        checked.rollout(5, break_when_any_done=False)


@pytest.mark.parametrize("value, said", [(1.5, "action of robot 2 is 1.5 in step 1, outside"), (torch.nan, "is nan")])
def test_an_action_out_of_its_range_is_found(task, value, said):
    env = env_of(task, check=True)
    state = env.reset()
    state["action"] = spoil(value)(torch.zeros(4, 6))
    with pytest.raises(NumericalError, match=said):
        env.step(state)


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["batched", "dm_control"])
def test_checking_changes_nothing(finished, tmp_path, backend):
    unchecked = finished["gctd3" if backend == "batched" else backend]
    assert not load_settings(unchecked).env.check
    checked = train(tmp_path / "run", f"env.backend={backend}", "env.check=true")
    assert rows(checked, drop=("wall_s",)) == rows(unchecked, drop=("wall_s",))


def test_what_the_check_finds_is_kept(tmp_path, capsys):
    def poison(trainer):
        trainer.collector.env.transform.insert(
            len(trainer.collector.env.transform) - 1, Poison("reward", spoil(torch.nan))
        )

    capsys.readouterr()
    assert command("train", *tiny(tmp_path / "run", "env.check=true"), trainer=poisoned(poison)) == 2
    assert "reward of robot 2 is nan in step 28" in capsys.readouterr().err
    assert load_tree(tmp_path / "run" / "post_mortem" / "collected.safetensors")["action"].shape == (4, 6)


# Simulations that diverge.


@pytest.mark.parametrize("control_dt", [0.02, 0.005])  # 0.005: one physics step, after which the clock looks normal
@pytest.mark.parametrize("age", [0, 7])
def test_a_batched_robot_that_explodes_falls_alone(robot, age, control_dt, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    task = walking(robot, control_dt=control_dt)
    good, bad = (Simulation(task, 4, seed=0, threads=2) for _ in range(2))
    actions = np.random.default_rng(0).uniform(-1, 1, (age + 3, 4, 6))
    for simulation in (good, bad):
        simulation.reset(np.ones(4, bool))
        for action in actions[:age]:
            simulation.step(action)
    bad.state[ROBOT, bad._qvel] = 1e12
    others = [0, 1, 3]
    for i, action in enumerate(actions[age:]):
        expected, outcome = good.step(action), bad.step(action)
        if i == 0:
            assert outcome.diverged.tolist() == [False, False, True, False]
            assert outcome.terminated[ROBOT] and not outcome.success[ROBOT] and np.isfinite(outcome.reward).all()
        np.testing.assert_array_equal(bad.state[others], good.state[others])
        np.testing.assert_array_equal(outcome.reward[others], expected.reward[others])
        bad.reset(outcome.terminated & (np.arange(4) == ROBOT))
    assert np.isfinite(bad.state).all() and bad.state[ROBOT, 0] >= BEGINNING


def test_a_dm_control_robot_that_explodes_falls(task):
    env = load(task, 0)
    for age in (0, 5):
        env.reset()
        for _ in range(age):
            env.step(np.zeros(6))
        env.physics.data.qvel[:] = 1e12
        last = env.step(np.zeros(6))
        assert last.last() and last.discount == 0.0 and last.observation["diverged"]
        assert np.isfinite(last.reward) and np.isfinite(last.observation["nodes"]).all()
        assert env.step(np.zeros(6)).first()


def explode(trainer):
    base = trainer.collector.env.base_env
    if hasattr(base, "simulation"):
        base.simulation.state[ROBOT, base.simulation._qvel] = 1e12
    else:
        base._envs[ROBOT]._env.physics.data.qvel[:] = 1e12


@parametrize(2, "backend", ["batched", "dm_control"])
def test_a_divergence_is_counted(tmp_path, monkeypatch, backend):
    shown, figures = [], Evaluations.figures

    def watched(self, row, diverged):
        shown.append(figures(self, row, diverged))
        return shown[-1]

    monkeypatch.setattr(Evaluations, "figures", watched)
    run = tmp_path / "run"
    assert command("train", *tiny(run, f"env.backend={backend}"), trainer=poisoned(explode)) == 0
    with (run / "progress.csv").open() as file:
        assert [row["diverged"] for row in csv.DictReader(file)] == ["0", "1", "1"]
    assert ["diverged" in one for one in shown] == [False, True, True] and shown[-1]["diverged"] == "1"
