"""Robots of other libraries' tasks give the same steps as environments built from TorchRL's own parts."""

import importlib
from itertools import product
from pathlib import Path

import pytest
import torch
from compositions import library_env
from torchrl.envs.utils import check_env_specs

from gctd3.envs.library_robots import LibraryRobots
from gctd3.envs.settings import LibrarySettings

SEED = 3
# Walker2d falls; dm_control's episodes have 1,000 steps and its actions are doubles; Humanoid's are scaled.
TASKS = [
    ("gymnasium", "Walker2d-v5", 60),
    ("gymnasium", "Humanoid-v5", 40),
    ("dm_control", "walker-walk", 1003),
    ("dm_control", "quadruped-walk", 10),
]


@pytest.fixture
def stock(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    return importlib.import_module("library_throughput").stock


def follow(env, actions):
    """Return every step's outputs, after the first state; for ours the node features too."""
    env.set_seed(SEED)
    state = env.reset()
    seen = [state.clone()]
    for action in actions:
        step, state = env.step_and_maybe_reset(state.set("action", action))
        seen.append(step["next"].clone())
        seen.append(state.clone())
        if isinstance(env.base_env, LibraryRobots):
            seen[-1]["sensed"] = torch.from_numpy(env.base_env.sensed.copy())
    return seen


OPTIONS = [{}, {"static": True}, {"observation": "flat", "history": 1}]
CASES = [
    pytest.param(*task, options, marks=[pytest.mark.nightly] if task[2] > 1000 else [])
    for task, options in product(TASKS, OPTIONS)
]


@pytest.mark.parametrize("library, name, steps, options", CASES)
def test_equal_torchrls_own_parts(stock, library, name, steps, options):
    settings = LibrarySettings(library=library, name=name, **options)
    env, theirs = library_env(library, name, num_envs=2, **options), stock(settings, 2)
    generator = torch.Generator().manual_seed(0)
    actions = 2 * torch.rand(steps, *env.action_spec.shape, generator=generator) - 1
    ours, expected = follow(env, actions), follow(theirs, actions)
    flat = settings.observation == "flat"
    for mine, other in zip(ours, expected, strict=True):
        for key in ("reward", "done", "terminated", "truncated", "is_init", "step_count"):
            if key in other:
                assert torch.equal(mine[key], other[key]), key
        assert torch.equal(mine["nodes"], other["flat"][:, None] if flat else other["nodes"])
        assert flat or mine["nodes"].std() > 0
        assert not flat or "sensed" not in mine or torch.equal(mine["sensed"], other["nodes"])
    assert "sensed" in ours[-1]
    ended = torch.stack([step["done"] for step in ours])
    assert ended.any() or name == "quadruped-walk"


@pytest.mark.parametrize("library, name, _", TASKS[::2])
@pytest.mark.parametrize("options", [{}, {"static": True}, {"observation": "flat"}])
def test_keeps_torchrls_rules(library, name, _, options):
    check_env_specs(library_env(library, name, num_envs=2, **options), seed=0)


def test_only_the_robots_that_are_to_be_reset_are():
    env = library_env("gymnasium", "Ant-v5", num_envs=3)
    state = env.reset()
    for _ in range(4):
        state = env.step(state.set("action", torch.full(env.action_spec.shape, 0.5)))["next"]
    before = state.clone()
    state = env.reset(state.set("_reset", torch.tensor([[False], [True], [False]])))
    assert torch.equal(state["nodes"][::2], before["nodes"][::2])
    assert state["step_count"].tolist() == [[4], [0], [4]] and state["is_init"].tolist() == [[False], [True], [False]]
    assert not torch.equal(state["nodes"][1], before["nodes"][1])
    # Earlier outputs stay unchanged.
    assert before["step_count"].tolist() == [[4], [4], [4]]


def test_ends_with_its_robots():
    env = library_env("gymnasium", "HalfCheetah-v5", num_envs=2)
    robots = env.base_env.robots
    env.close()
    assert env.is_closed and all(robot.is_closed for robot in robots)
    env.close(raise_if_closed=False)
