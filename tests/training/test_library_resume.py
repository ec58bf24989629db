"""Tasks of other libraries resume exactly: runs, and single robots across the end of an episode."""

import pytest
import torch
from compositions import library_env
from resuming import assert_same_run, stopped
from running import command, train
from tensordict import TensorDict

from gctd3.envs.checkpointing import env_state, load_env_state
from gctd3.envs.library import make_robot
from gctd3.files import load_tree, save_tree
from gctd3.training.checkpoint import Checkpoints

FEW = ["env.num_envs=2", "task.history=2", "evaluation.episodes=1", "total_frames=200", "network.graph_layers=[8]"]
FLAT = ["task.observation=flat", "algo=td3", "network.graph_layers=[]"]
WITHOUT = ["env.num_envs", "env.threads", "evaluation.every", "evaluation.episodes", "total_frames"]


# Walker2d falls within the frames of the test; dm_control's episodes have 1,000 steps, so it is evaluated only once.
@pytest.mark.nightly
@pytest.mark.parametrize(
    "task, every",
    [
        (["task=walker2d"], 100),
        pytest.param(["task=walker2d", *FLAT], 100, marks=pytest.mark.nightly),
        pytest.param(["task=walker2d", "task.static=true"], 100, marks=pytest.mark.nightly),
        pytest.param(["task=ant", "task.name=Humanoid-v5"], 100, marks=pytest.mark.nightly),
        pytest.param(["task=walker_walk"], 200, marks=pytest.mark.nightly),
    ],
)
def test_stopped_and_resumed_equals_left_alone(tmp_path, task, every):
    settings = [*FEW, *task, f"evaluation.every={every}"]
    whole = train(tmp_path / "whole", *settings, without=WITHOUT)
    part = stopped(tmp_path / "part", 130, *settings, without=WITHOUT)
    assert Checkpoints(part).newest()[0]["counters"]["frames"] == 130
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


def follow(env, state, actions):
    """Return every step's outputs, and the state after the last."""
    seen = []
    for action in actions:
        step, state = env.step_and_maybe_reset(state.set("action", action))
        seen.append(step.clone())
    return torch.stack(seen), state


# Ant falls; its reward reads what was derived before the last integration. The others' episodes have 1,000 steps; the
# swimmer's target is moved in the model at each reset. The actions of Humanoid and of the quadruped are scaled.
@pytest.mark.parametrize(
    "library, name, before, after",
    [
        ("gymnasium", "Ant-v5", 30, 20),
        ("gymnasium", "HalfCheetah-v5", 990, 20),
        ("gymnasium", "Humanoid-v5", 15, 30),
        ("dm_control", "swimmer-swimmer6", 990, 20),
        pytest.param("dm_control", "quadruped-walk", 990, 20, marks=pytest.mark.nightly),
    ],
)
def test_a_robot_goes_on_as_it_would_have(tmp_path, library, name, before, after):
    env, other = (library_env(library, name, seed=seed) for seed in (3, 4))
    generator = torch.Generator().manual_seed(0)
    actions = 2 * torch.rand(before + after, 1, *env.action_spec.shape[1:], generator=generator) - 1
    _, state = follow(env, env.reset(), actions[:before])
    save_tree(tmp_path / "state", {"state": state.clone().to_dict(), "env": env_state(env)})
    expected, _ = follow(env, state, actions[before:])
    assert expected["next", "done"].any()

    other.reset()
    kept = load_tree(tmp_path / "state")
    load_env_state(other, kept["env"])
    seen, _ = follow(other, TensorDict(kept["state"], [1]), actions[before:])
    for key in expected.keys(True, True):
        assert torch.equal(seen[key], expected[key]), key
    assert expected["next", "nodes"].std() > 0


def test_the_state_of_another_robot_is_refused(tmp_path):
    envs = []
    for name in ("Walker2d-v5", "Ant-v5"):
        envs.append(library_env("gymnasium", name))
        envs[-1].reset()
    with pytest.raises(ValueError, match=r"state has \d+ numbers, got \d+"):
        load_env_state(envs[0].base_env, env_state(envs[1].base_env))
    with pytest.raises(TypeError, match="state of a GymEnv cannot be read"):
        env_state(make_robot("gymnasium", "Ant-v5"))
