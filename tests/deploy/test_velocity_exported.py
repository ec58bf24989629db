"""A policy of commanded velocities, exported: its readings, its commands, and the frames that it makes of them."""

import math

import numpy as np
import pytest
import torch

from gctd3.deploy import Policy
from gctd3.deploy.cpp_policy import to_cpp
from gctd3.envs.factory import build_env
from gctd3.errors import ReadingError
from gctd3.runs.load import load_run
from gctd3.tasks.memory import target_of
from gctd3.tasks.velocity_command import VELOCITY

pytest.importorskip("onnx")
pytest.importorskip("onnxscript")
pytest.importorskip("onnxruntime")
# The ranges of the training, by conf/task/velocity.yaml (m/s, m/s, rad/s).
RANGES = {
    "command_forward_m_s": (-0.5, 1.0),
    "command_side_m_s": (-0.4, 0.4),
    "command_turn_rad_s": (-0.8, 0.8),
}


@pytest.fixture(scope="module")
def file(exported_velocity):
    return exported_velocity


def test_every_reading_names_its_source_and_commands_their_range(file):
    contract = Policy(file).contract
    sources = {f.reading: f.source for node in contract.nodes for f in node.features if f.reading is not None}
    assert "not stated" not in sources.values()
    assert sources["gravity_up"] == sources["gravity_side"] == "IMU orientation"
    assert {sources[f"{axis}_rate_rad_s"] for axis in ("pitch", "roll", "yaw")} == {"IMU gyroscope"}
    assert [name for name, source in sources.items() if source == "command"] == list(contract.commands)
    assert contract.commands == RANGES
    rates = [f.slew_rate for node in contract.nodes for f in node.features if f.reading in RANGES]
    assert sorted(rates) == [2.0, 2.0, 4.0]
    assert len(contract.own_actions) == 12 and not RANGES.keys() & set(contract.readings)
    assert contract.safety.tilt_readings == ("gravity_up",)


def test_the_networks_input_is_the_environments(file, finished):
    """Over a second of random actions; another command from the middle on is approached by both alike."""
    policy, run = Policy(file), load_run(finished["velocity"])
    task = run.task("export")
    env = build_env(task, run.settings.env.for_evaluation(1, 1), 3)
    simulation, seen, actions = env.base_env.simulation, [], []
    generator = torch.Generator().manual_seed(0)

    class Watching:
        def run(self, outputs, inputs):
            seen.append(next(iter(inputs.values())).copy())
            actions.append(0.1 * torch.rand(1, task.facts.actions, generator=generator))
            return [actions[-1].numpy()]

    policy._session = Watching()
    state, expected, orders, told = env.reset(), [], set(), []
    place = {f.reading: (i, k) for i, n in enumerate(policy.contract.nodes) for k, f in enumerate(n.features)}
    zero = {f.reading: f.zero for n in policy.contract.nodes for f in n.features}
    for step in range(50):
        frame = task.node_features(simulation.now, simulation.memory)[0]
        now = {name: float(frame[place[name]]) + zero[name] for name in policy.contract.readings}
        order = dict(zip(RANGES, simulation.memory[target_of(VELOCITY)][0].tolist(), strict=True))
        orders.add(tuple(order.values()))
        told.append(simulation.memory[VELOCITY][0])
        policy.step(now, step * task.control_dt, command=order)
        expected.append(state["nodes"].numpy().copy())
        if state["done"].any():
            break
        if step == 20:
            simulation.memory = {**simulation.memory, f"{VELOCITY}.left": np.array([1])}
        state = env.step(state.set("action", actions[-1]))["next"]
    assert len(seen) == len(expected) == 50 and len(orders) == 2
    assert (np.abs(np.diff(told, axis=0)).max(axis=0) <= np.array([0.04, 0.04, 0.08]) + 1e-12).all() and np.any(told)
    np.testing.assert_allclose(np.concatenate(seen), np.concatenate(expected), atol=2e-6)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"command_forward_m_s": 1.01}, "command_forward_m_s must be between -0.5 and 1 m/s, got 1.01."),
        ({"command_turn_rad_s": math.nan}, "command_turn_rad_s must be a finite number, got nan."),
    ],
)
def test_a_command_out_of_range_is_refused(file, change, reason):
    policy = Policy(file)
    # In the middle of what is accepted, with the body upright.
    readings = {f.reading: (f.low + f.high) / 2 for f in policy.contract.features if f.reading not in RANGES}
    readings |= {"gravity_up": -1.0} | {name: 1.0 for name in readings if name.startswith("down_")}
    stand = dict.fromkeys(RANGES, 0.0)
    policy.step(readings, 0.0, command=stand)
    period = 1.0 / policy.contract.control_rate_hz
    with pytest.raises(ReadingError) as error:
        policy.step(readings, period, command={**stand, **change})
    assert str(error.value) == reason


def test_in_cpp_commands_are_readings_with_the_trainings_range(file):
    contract = Policy(file).contract
    text = to_cpp(file.read_bytes(), contract)

    def numbers(name):
        return text.split(f" {name}[")[1].split("{")[1].split("}")[0].split(", ")

    names = numbers("READING_NAMES")
    for name, (low, high) in RANGES.items():
        place = names.index(f'"{name}"')
        assert (float(numbers("LEAST")[place]), float(numbers("MOST")[place])) == (low, high)
