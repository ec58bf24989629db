"""An exported policy runs in MuJoCo from named readings alone, and refuses every wrong reading."""

import math

import mujoco
import numpy as np
import pytest
import torch
from compositions import env_of

import gctd3
from gctd3.deploy.policy import Policy
from gctd3.errors import ReadingError

pytest.importorskip("onnxruntime")
PERIOD = 0.02


@pytest.fixture
def policy(exported):
    return Policy(exported)


def still(policy, **changed):
    """Return the readings of a robot that stands."""
    return {**dict.fromkeys(policy.contract.readings, 0.0), "down_foot_right": 1.0, "down_foot_left": True, **changed}


class Fixed:
    """Replace the network: return given actions in turn, and keep the inputs."""

    def __init__(self, *actions):
        self.actions, self.seen = [np.full((1, 6), a, dtype=np.float32) for a in actions], []

    def run(self, names, given):
        self.seen.append(given["nodes"])
        return [self.actions[min(len(self.seen), len(self.actions)) - 1]]


def with_network(policy, *actions):
    policy._session = Fixed(*actions)
    return policy._session


# In the loop.


def sense(model, data):
    """Read the biped by name; height counts from standing, 0.0235 m below the reference pose."""
    readings = {"height_m": data.joint("root_z").qpos[0] + 0.0235, "velocity_m_s": data.joint("root_x").qvel[0]}
    for side in ("right", "left"):
        for joint in (f"hip_{side}", f"knee_{side}", f"ankle_{side}"):
            readings[f"angle_{joint}_rad"] = data.joint(joint).qpos[0]
            readings[f"velocity_{joint}_rad_s"] = data.joint(joint).qvel[0]
        readings[f"down_foot_{side}"] = data.sensor(f"foot_{side}").data[0] > 0
    return readings


def walk(policy, robot, start, steps):
    """Drive MuJoCo through the policy's commands alone; return ``qpos`` and commands after each control step."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:], data.qvel[:] = np.split(start, [model.nq])
    mujoco.mj_forward(model, data)
    rows = []
    for step in range(steps):
        command = policy.step(sense(model, data), step * PERIOD)
        for name, angle in command.items():
            data.actuator(name).ctrl[0] = angle
        mujoco.mj_step(model, data, 4)
        rows.append((data.qpos.copy(), np.array(list(command.values()))))
    return tuple(np.stack(column) for column in zip(*rows, strict=True))


def test_the_loop_through_it_is_the_torch_policys(robot, task, policy):
    """From the same start to the finish, actions and positions equal those of the PyTorch policy."""
    env = env_of(task, seed=7, num_envs=1)
    state = env.reset()
    simulation = env.base_env.simulation
    start = simulation.state[0, 1:].copy()
    rows = []
    torch_policy = gctd3.load_policy()
    while not state["done"].item():
        state = env.step(torch_policy(state))
        rows.append((simulation.qpos[0].copy(), simulation.desired(state["action"].numpy().astype(float))[0]))
        state = state["next"]
    assert state["success"].item()
    qpos, desired = (np.stack(column) for column in zip(*rows, strict=True))

    mine, commands = walk(policy, robot, start, len(rows))
    assert policy.limited == 0
    assert mine[-1, 0] >= 15.0
    # The first step's inputs are the same to the bit; then differences of float32 go around the loop.
    np.testing.assert_allclose(commands[0], desired[0], atol=1e-5)
    np.testing.assert_allclose(commands[:100], desired[:100], atol=1e-3)
    np.testing.assert_allclose(mine[:100], qpos[:100], atol=1e-4)


def test_history_is_the_environments(robot, task, policy):
    """The network's input equals, bit for bit, CatFrames of the same frames, from the first one on."""
    network = with_network(policy, 0.0)
    env = env_of(task, num_envs=1)
    state, expected = env.reset(), []
    simulation = env.base_env.simulation
    for step in range(8):
        now = simulation.now
        readings = {"height_m": now.height[0], "velocity_m_s": now.velocity[0]}
        for i, joint in enumerate(robot.joints):
            readings[f"angle_{joint.name}_rad"] = now.angles[0, i]
            readings[f"velocity_{joint.name}_rad_s"] = now.velocities[0, i]
        for i, foot in enumerate(robot.feet):
            readings[f"down_{foot}"] = now.feet_down[0, i]
        policy.step(readings, step * PERIOD)
        expected.append(state["nodes"].numpy().copy())
        state = env.step(state.set("action", 2 * torch.rand(1, 6) - 1))["next"]
    assert all(np.array_equal(a, b) for a, b in zip(network.seen, expected, strict=True))
    # The first frame stands for those before it.
    assert np.array_equal(network.seen[0][..., :2], network.seen[0][..., -2:])


def test_reset_begins_a_new_walk(policy):
    first = policy.step(still(policy), 0.0)
    policy.step(still(policy, velocity_m_s=1.0), PERIOD)
    policy.reset(at_home=True)
    assert policy.step(still(policy), 0.0) == first


# Limits, by hand: the hip's range is -0.7854 to 0.7854, the knee's -1.3962 to 0.0012.


def test_actions_become_angles_within_the_limits(policy):
    policy._most[:] = 10.0
    with_network(policy, 0.0, 0.5, -3.0)
    command = policy.step(still(policy), 0.0)
    assert list(command) == ["hip_right", "knee_right", "ankle_right", "hip_left", "knee_left", "ankle_left"]
    assert command["hip_left"] == 0.0 and command["knee_left"] == pytest.approx((-1.3962 + 0.0012) / 2)
    # A quarter of the range below its upper end.
    assert policy.step(still(policy), PERIOD)["knee_left"] == pytest.approx(0.0012 - 0.25 * (0.0012 + 1.3962))
    assert policy.step(still(policy), 2 * PERIOD)["knee_left"] == -1.3962
    assert policy.limited == 0


def test_a_desired_angle_changes_no_faster_than_allowed(policy):
    policy._most[:] = 0.3
    with_network(policy, 1.0, 1.0, 1.0, -1.0)
    hips = [policy.step(still(policy), i * PERIOD)["hip_right"] for i in range(4)]
    assert hips == pytest.approx([0.3, 0.6, 0.7854, 0.4854])
    # The first, the second and the last step were limited, and the knee (from 0 to 0.0012) never before the last.
    assert policy.limited == 3


# Refusals: a message, the last command to hold, and no other change; test_safe_command.py has what follows.


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"angle_knee_left_rad": None}, "angle_knee_left_rad must be a finite number, got None"),
        ({"angle_knee_left_rad": math.nan}, "angle_knee_left_rad must be a finite number, got nan"),
        ({"velocity_m_s": math.inf}, "velocity_m_s must be a finite number, got inf"),
        ({"velocity_m_s": 1e300}, "velocity_m_s must be between -1.5"),
        ({"velocity_m_s": 10**400}, "velocity_m_s must be a finite number, got 1000"),
        ({"height_m": "0.1"}, "height_m must be a finite number, got '0.1'"),
        ({"height_m": [0.1, 0.2]}, "height_m must be a finite number"),
        ({"height_m": np.zeros(1)}, "height_m must be a finite number"),
        ({"height_m": np.array([[0.1]])}, "height_m must be a finite number, got array([[0.1]])"),
        ({"height_m": 0.1 + 0.1j}, "height_m must be a finite number"),
        ({"height_m": np.complex64(0.1)}, "height_m must be a finite number"),
        ({"height_m": object()}, "height_m must be a finite number, got <object object"),
        ({"velocity_m_s": 1e30}, "velocity_m_s must be between -1.5"),
        ({"angle_knee_left_rad": 57.0}, "angle_knee_left_rad must be between -1.74555 and 0.35055 rad, got 57.0"),
        ({"down_foot_left": 2}, "down_foot_left must be 0 or 1, got 2"),
        ({"down_foot_left": 0.5}, "down_foot_left must be 0 or 1, got 0.5"),
        ({"pitch_rad": 0.0}, "missing none; unknown pitch_rad"),
        ({"height_m": ..., "down_foot_left": ..., "heigth_m": 0.0}, "missing height_m, down_foot_left; unknown heigth"),
    ],
)
def test_wrong_readings_are_refused(policy, change, said):
    last = policy.step(still(policy), 0.0)
    wrong = {key: value for key, value in still(policy, **change).items() if value is not ...}
    with pytest.raises(ReadingError) as refused:
        policy.step(wrong, PERIOD)
    assert said in str(refused.value)
    assert refused.value.command == last == policy.command
    # Valid readings are still accepted.
    follows = policy.step(still(policy), PERIOD)
    policy.reset(at_home=True)
    policy.step(still(policy), 0.0)
    assert policy.step(still(policy), PERIOD) == follows


@pytest.mark.parametrize(
    ("time", "now", "said"),
    [
        (0.0, None, "Stale readings: they are 0.0000 s newer than those before, expected 0.0200 s"),
        (-0.02, None, "The clock went back by 0.0200 s. If it was set back, call reset()"),
        (0.02, 0.05, "Stale readings: they are 0.0300 s old, expected between 0 and 0.0200 s"),
        (0.02, 0.01, "The readings come from the future: time is 0.0100 s after now"),
        (math.nan, None, "time must be a finite number of seconds, got nan"),
        (None, None, "time must be a finite number of seconds, got None"),
        ("0.02", None, "time must be a finite number of seconds, got '0.02'"),
        (np.array([0.02]), None, "time must be a finite number of seconds, got array([0.02])"),
        (0.02, math.nan, "now must be a finite number of seconds, got nan"),
        (0.15, None, "Steps were missed: the readings are 0.1500 s newer than those before, expected 0.0200 s"),
    ],
)
def test_stale_readings_are_refused(policy, time, now, said):
    last = policy.step(still(policy), 0.0)
    with pytest.raises(ReadingError) as refused:
        policy.step(still(policy), time, now)
    assert said in str(refused.value)
    assert refused.value.command == last


@pytest.mark.parametrize(("periods", "accepted"), [(0.45, False), (0.55, True), (6.45, True), (6.55, False)])
def test_readings_may_come_half_a_period_early_and_five_periods_late(policy, periods, accepted):
    policy.step(still(policy), 0.0)
    if accepted:
        policy.step(still(policy), periods * 0.02)
        return
    with pytest.raises(ReadingError, match=r"Stale|missed"):
        policy.step(still(policy), periods * 0.02)


def test_after_missed_steps_a_new_history_begins(policy):
    network = with_network(policy, 0.0)
    policy.step(still(policy), 0.0)
    with pytest.raises(ReadingError, match="missed"):
        policy.step(still(policy), 1.0)
    # One wrong time does not set the clock forward; two that agree do.
    policy.step(still(policy), 0.02)
    with pytest.raises(ReadingError, match="missed"):
        policy.step(still(policy), 1.0)
    policy.step(still(policy, height_m=-0.01), 1.02, now=1.03)
    assert (network.seen[-1][0, 0, ::2] == np.float32(-0.01)).all()


def test_an_output_that_is_not_finite_is_refused(policy):
    with_network(policy, math.nan)
    with pytest.raises(ReadingError, match="output is not finite") as refused:
        policy.step(still(policy), 0.0)
    # Before the first command: the pose in which the robot starts.
    assert refused.value.command == dict.fromkeys(policy.command, 0.0)


@pytest.mark.parametrize("readings", [None, 3.0, [1.0], "height_m", [("height_m", 0.0)]])
def test_what_is_no_mapping_is_refused(policy, readings):
    with pytest.raises(ReadingError, match="must be a mapping from names to numbers, got") as refused:
        policy.step(readings, 0.0)
    assert refused.value.command == policy.command


def test_a_network_that_fails_is_refused(policy):
    class Broken:
        def run(self, names, given):
            raise RuntimeError("no memory")

    policy._session = Broken()
    with pytest.raises(ReadingError, match="The network failed: no memory"):
        policy.step(still(policy), 0.0)
