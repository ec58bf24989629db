"""Nodes read from dm_control's and Gymnasium's simulators agree with these environments' own observations."""

import mujoco
import numpy as np
import pytest
import torch
from torchrl.envs import DMControlEnv, GymEnv, SerialEnv, TransformedEnv, check_env_specs

from gctd3 import KinematicGraph, make_actor
from gctd3.envs.nodes import STATIC, NodeSensor, with_nodes
from gctd3.errors import ConfigError, RobotError

# Nodes: root, base nodes, joints, ground nodes.
SUITE = {
    "walker-walk": 1 + 1 + 6 + 1,
    "cheetah-run": 9,
    "humanoid-walk": 1 + 4 + 21 + 1,
    "quadruped-walk": 1 + 4 + 16 + 2,
}
GYM = {"Walker2d-v5": 9, "HalfCheetah-v5": 9, "Ant-v5": 1 + 4 + 8 + 2}
EVERY = [*(pytest.param(name, marks=pytest.mark.dm_control) for name in SUITE), *GYM]
OF_SUITE = {case.values[0]: case for case in EVERY if not isinstance(case, str)}


def base_env(name):
    return DMControlEnv(*name.split("-")) if name in SUITE else GymEnv(name)


def make(name, **options):
    return with_nodes(base_env(name), **options)


def simulator(env):
    inner = env.base_env._env
    physics = getattr(inner, "physics", None)
    return (physics.model.ptr, physics.data.ptr) if physics else (inner.unwrapped.model, inner.unwrapped.data)


@pytest.mark.parametrize("name", EVERY)
def test_environment_is_sound(name):
    env = make(name, history=3, static=True)
    check_env_specs(env)
    sensor, rollout = env.transform[0].sensor, env.rollout(6)
    nodes = {**SUITE, **GYM}[name]
    assert sensor.graph.num_nodes == nodes == rollout["nodes"].shape[-2]
    assert rollout["nodes"].shape[-1] == 3 * sensor.features + len(STATIC) and rollout["nodes"].dtype == torch.float32
    # Oldest to newest, the newest is what the next step's stack holds one place further back.
    now, after = rollout["nodes"][1:, :, 2:6], rollout["next", "nodes"][1:, :, :4]
    torch.testing.assert_close(now, after)
    actor = make_actor(sensor.graph, rollout["nodes"].shape[-1], env.action_spec.shape[-1])
    assert env.rollout(3, actor)["action"].shape == (3, env.action_spec.shape[-1])


@pytest.mark.parametrize("name", EVERY)
def test_every_joint_is_read_at_its_node(name):
    env = make(name)
    env.reset()
    model, data = simulator(env)
    sensor = env.transform[0].sensor
    for joint in sensor.robot.joints:
        data.qpos[joint.qpos], data.qvel[joint.qvel] = 0.25, -2.0
        row = sensor.graph.nodes.index(joint.name)
        assert sensor.read(model, data)[row].tolist() == [0.25, -2.0]
        data.qpos[joint.qpos] = data.qvel[joint.qvel] = 0.0


@pytest.mark.parametrize("name, angles", [("Walker2d-v5", slice(2, 8)), ("HalfCheetah-v5", slice(2, 8))])
def test_gymnasiums_own_observation_is_in_the_nodes(name, angles):
    # Documented: height, pitch, six angles, forward velocity, vertical velocity, rate of pitch, six velocities.
    env = make(name)
    rollout = env.rollout(20)
    sensor, seen = env.transform[0].sensor, rollout["next", "observation"].float()
    rows = [sensor.graph.nodes.index(joint.name) for joint in sensor.robot.joints]
    nodes = rollout["next", "nodes"]
    torch.testing.assert_close(nodes[:, rows, 0], seen[:, angles])
    # Gymnasium clips Walker2d's velocities at 10.
    torch.testing.assert_close(nodes[:, rows, 1].clamp(-10, 10), seen[:, 11:17].clamp(-10, 10))
    heights = nodes[:, 0, 0] - seen[:, 0]
    torch.testing.assert_close(heights, heights[:1].expand_as(heights))  # another origin, nothing else
    torch.testing.assert_close(nodes[:, 0, 1], seen[:, 8])
    torch.testing.assert_close(nodes[:, 1].clamp(-10, 10), seen[:, [1, 10]].clamp(-10, 10))


@pytest.mark.dm_control
def test_dm_controls_own_height_is_in_the_root():
    env = make("walker-walk")
    rollout = env.rollout(20)
    gap = rollout["next", "nodes"][:, 0, 0] - rollout["next", "height"][:, 0]
    torch.testing.assert_close(gap, gap[:1].expand_as(gap), atol=1e-5, rtol=1e-5)
    assert torch.equal(rollout["next", "nodes"][:, 0, 1], rollout["next", "velocity"][:, 1].float())


@pytest.mark.parametrize("name", [OF_SUITE["walker-walk"], OF_SUITE["quadruped-walk"], "Ant-v5"])
def test_feet_are_down_when_they_are_on_the_floor(name):
    env = make(name)
    env.reset()
    model, data = simulator(env)
    sensor = env.transform[0].sensor
    # High in the air nothing touches; dropped without control, feet come down within five seconds.
    data.qpos[sensor.robot.vertical] += 5.0
    mujoco.mj_forward(model, data)
    assert not sensor.feet_down(model, data).any()
    data.qpos[:], data.qvel[:] = sensor.robot.standing_qpos, 0.0
    seen = np.zeros(len(sensor.robot.feet), dtype=bool)
    while data.time < 5.0 and not seen.all():
        mujoco.mj_step(model, data)
        # By hand: the foot's body in a contact with a geom of the world.
        touching = {
            model.body(model.geom_bodyid[geom]).id
            for contact in data.contact
            for geom, other in (contact.geom, contact.geom[::-1])
            if contact.dist <= 0 and model.geom_bodyid[other] == 0
        }
        down = sensor.feet_down(model, data)
        bodies = {(model.body(b).name or f"body_{b}"): b for b in range(model.nbody)}
        assert down.tolist() == [bodies[foot] in touching for foot in sensor.robot.feet]
        seen |= down
    assert seen.any()
    nodes = sensor.read(model, data)
    ground = [i for i, kind in enumerate(sensor.graph.kinds) if kind == "ground"]
    pairs = [foot for pair in sensor.robot.foot_pairs for foot in pair]
    assert nodes[ground].reshape(-1)[: len(pairs)].tolist() == down[pairs].astype(float).tolist()


BALL = """<mujoco model="ball"><compiler angle="radian"/><worldbody><geom type="plane" size="5 5 .1"/>
<body name="trunk" pos="0 0 1"><freejoint/><geom size=".1"/>
<body name="leg" pos="0 0 -.2"><joint name="hip" type="ball"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03"/>
<body name="foot" pos="0 0 -.3"><joint name="knee" axis="0 1 0" range="-1 2" limited="true"/><geom size=".05"/></body>
</body></body></worldbody><actuator><motor joint="knee"/></actuator></mujoco>"""


def test_a_ball_joint_widens_every_node():
    model = mujoco.MjModel.from_xml_string(BALL)
    data, sensor = mujoco.MjData(model), NodeSensor(model)
    hip, knee = model.joint("hip"), model.joint("knee")
    mujoco.mju_axisAngle2Quat(data.qpos[hip.qposadr[0] : hip.qposadr[0] + 4], np.array([0.0, 1.0, 0.0]), 0.5)
    data.qvel[hip.dofadr[0] : hip.dofadr[0] + 3] = 1.0, 2.0, 3.0
    data.qpos[knee.qposadr[0]], data.qvel[knee.dofadr[0]] = 0.75, -1.0
    nodes = sensor.read(model, data)
    assert sensor.features == 6 and nodes.shape == (sensor.graph.num_nodes, 6)
    assert nodes[sensor.graph.nodes.index("hip")] == pytest.approx([0.0, 0.5, 0.0, 1.0, 2.0, 3.0])
    assert nodes[sensor.graph.nodes.index("knee")].tolist() == [0.75, 0.0, 0.0, -1.0, 0.0, 0.0]
    static = dict(zip(STATIC, sensor.static()[sensor.graph.nodes.index("knee")].tolist(), strict=True))
    mass = model.body("foot").mass[0] / model.body_mass.sum()
    expected = {"hinge": 1.0, "actuated": 1.0, "limited": 1.0, "lower": -1.0, "upper": 2.0, "mass": mass}
    assert static == pytest.approx({name: expected.get(name, 0.0) for name in STATIC})


@pytest.mark.dm_control
def test_several_robots_and_what_is_none():
    env = SerialEnv(2, [lambda: make("walker-walk", history=2)] * 2)
    assert env.rollout(4)["nodes"].shape == (2, 4, 9, 4)
    for wrong in (GymEnv("Pendulum-v1"), TransformedEnv(base_env("walker-walk"))):
        with pytest.raises(ConfigError, match="read from a DMControlEnv or from a GymEnv of one MuJoCo robot"):
            with_nodes(wrong)


def test_the_graph_is_that_of_the_model():
    env = make("Walker2d-v5")
    assert env.transform[0].sensor.graph.nodes == KinematicGraph.from_mjcf(simulator(env)[0]).nodes


def test_feet_and_forward_of_a_robot_that_lies():
    named = {"feet": ["right_foot", "left_foot"], "forward": "-x"}
    env = make("HumanoidStandup-v5", **named)
    sensor, graph = env.transform[0].sensor, KinematicGraph.from_mjcf(simulator(env)[0], **named)
    assert (sensor.robot.feet, sensor.robot.forward_axis) == (("right_foot", "left_foot"), "-x")
    ends = [node for edge in sensor.graph.edges if "ground" in edge for node in edge if node != "ground"]
    assert sensor.graph.edges == graph.edges and ends == ["right_knee", "left_knee"]
    env.reset()
    model, data = simulator(env)
    data.qvel[0] = 1.5
    assert sensor.read(model, data)[0, 1] == -1.5
    with pytest.raises(RobotError, match="has no body 'nonsense'"):
        make("HumanoidStandup-v5", feet=["nonsense"])
    with pytest.raises(RobotError, match="forward must be one of x, -x, y, -y, got 'up'"):
        KinematicGraph.from_mjcf("biped", forward="up")
