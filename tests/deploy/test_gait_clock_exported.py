"""A policy with a clock, exported: what its network sees is what the environment observes, clock and all."""

import numpy as np
import pytest
import torch
from running import command, tiny

from gctd3.deploy import Policy
from gctd3.envs.factory import build_env
from gctd3.runs.load import load_run


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    run = tmp_path_factory.mktemp("clock") / "run"
    assert command("train", *tiny(run, "robot=quadruped", "robot.action_scale=0.3")) == 0
    assert command("export", f"run={run}", f"out={run / 'policy.onnx'}", "episodes=2") == 0
    return run


@pytest.mark.nightly
def test_the_clock_is_no_reading(exported):
    policy = Policy(exported / "policy.onnx")
    assert len(policy.contract.clocks) == 4
    assert not any("clock" in name for name in policy.contract.readings)


@pytest.mark.nightly
def test_the_networks_input_is_the_environments(exported):
    """Bit for bit but for the clock's float32 rounding, over a second of control steps with random actions."""
    policy, run = Policy(exported / "policy.onnx"), load_run(exported)
    task = run.setup.task
    env = build_env(task, run.settings.env.for_evaluation(1, 1), 3)
    simulation, seen = env.base_env.simulation, []

    class Watching:
        def run(self, outputs, inputs):
            seen.append(next(iter(inputs.values())).copy())
            return [np.zeros((1, task.facts.actions), dtype=np.float32)]

    policy._session = Watching()
    state, expected = env.reset(), []
    readings = {f.reading: (i, k) for i, n in enumerate(policy.contract.nodes) for k, f in enumerate(n.features)}
    zero = {f.reading: f.zero for n in policy.contract.nodes for f in n.features}
    period = task.control_dt
    for step in range(50):
        frame = task.node_features(simulation.now, simulation.memory)[0]
        now = {name: float(frame[readings[name]]) + zero[name] for name in policy.contract.readings}
        policy.step(now, step * period)
        expected.append(state["nodes"].numpy().copy())
        if state["done"].any():
            break
        # Little, so that nothing leaves the contract's limits.
        state = env.step(state.set("action", 0.1 * torch.rand(1, task.facts.actions)))["next"]
    assert len(seen) == len(expected) > 10
    np.testing.assert_allclose(np.concatenate(seen), np.concatenate(expected), atol=2e-6)
