"""Equivariant networks map the mirror image of a state to the mirror image of their actions."""

from dataclasses import replace
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest
import torch
from compositions import walking
from networks import NETWORKS, SIZES, randomised
from robots import opposite_axes
from tensordict import TensorDict

from gctd3 import KinematicGraph, Robot, make_actor, make_critic, make_stochastic_actor
from gctd3.data.mirror_augmentation import MirrorAugmentation
from gctd3.envs.nodes import STATIC, NodeSensor
from gctd3.errors import ConfigError, RobotError
from gctd3.nn import Actor, Critic, Network
from gctd3.robots.mjcf import body_name
from gctd3.tasks.reflection import Reflection, SignedPermutation


@pytest.fixture(scope="module", params=["equal axes", "opposite axes"])
def either(request, robot, tmp_path_factory):
    """Return the biped, or the biped whose mirrored joints turn the other way round."""
    return robot if request.param == "equal axes" else opposite_axes(robot, tmp_path_factory.mktemp("robot"))


@pytest.mark.parametrize("name", [name for name, network in NETWORKS.items() if network.equivariant])
@pytest.mark.parametrize("leading", [(), (7,), (2, 3)])
def test_acting_in_the_mirror_is_the_mirror_of_acting(either, name, leading):
    graph, reflection = KinematicGraph.from_robot(either), walking(either).reflection()
    mirror = MirrorAugmentation(reflection, 5)
    nodes, action = torch.randn(*leading, 8, 10), 2 * torch.rand(*leading, 6) - 1
    counters = torch.rand(*leading, 4)
    seen = {key: mirror.reflect(key, v) for key, v in (("nodes", nodes), ("action", action), ("counters", counters))}
    assert not torch.equal(seen["nodes"], nodes)
    network = NETWORKS[name]
    actor = randomised(Actor(network, graph, *SIZES, reflection=reflection))
    critic = randomised(Critic(network, graph, *SIZES, 4, reflection))
    exact = {"atol": 1e-6, "rtol": 1e-6}
    torch.testing.assert_close(actor(seen["nodes"]), mirror.reflect("action", actor(nodes)), **exact)
    value = critic(nodes, action, counters)
    assert value.shape == (*leading, 1)
    torch.testing.assert_close(critic(seen["nodes"], seen["action"], seen["counters"]), value, **exact)
    gaussian = randomised(make_stochastic_actor(graph, *SIZES, network, reflection))
    dist, mirrored = (gaussian.get_dist(TensorDict({"nodes": x}, leading)) for x in (nodes, seen["nodes"]))
    torch.testing.assert_close(mirrored.loc, mirror.reflect("action", dist.loc), **exact)
    torch.testing.assert_close(mirrored.scale, mirror.reflect("action", dist.scale).abs(), **exact)
    # And it is no trivial one: what is averaged is not equivariant by itself.
    plain = Actor(replace(network, equivariant=False), graph, *SIZES)
    plain.load_state_dict(actor.state_dict())
    with torch.no_grad():
        apart = (plain(seen["nodes"]) - mirror.reflect("action", plain(nodes))).abs().max()
    assert apart > 1e-3 and actor(nodes).std() > 0


def test_reflection_is_what_replay_mirrors(either):
    reflection = Reflection.from_robot(either)
    mirror = MirrorAugmentation(reflection, 3)
    nodes = torch.randn(4, 8, 6)
    by_matrix = nodes.flatten(-2) @ torch.from_numpy(reflection.nodes(6).matrix).float()
    assert torch.equal(by_matrix.reshape(4, 8, 6), mirror.reflect("nodes", nodes))
    # Of one frame it is the frame's own.
    assert np.array_equal(reflection.nodes(2).matrix, reflection.frame.matrix)
    for width in (7, 2 + len(STATIC), 0):
        with pytest.raises(ValueError, match=f"2 features a frame cannot be {width} features wide"):
            reflection.nodes(width)
    still = Reflection.from_robot(either, static=3)
    with pytest.raises(ValueError, match="2 features a frame and 3 that never change cannot be 8"):
        still.nodes(8)
    with pytest.raises(RobotError, match="done twice"):
        SignedPermutation(np.array([1, 2, 0]), np.ones(3))


@pytest.mark.parametrize("task", ["walker", "humanoid", "quadruped"])
def test_reflection_of_robots_with_base_nodes_and_many_feet(task):
    suite = pytest.importorskip("dm_control.suite")
    model = suite.load(task, "walk").physics.model.ptr
    robot = Robot.from_mjcf(model)
    graph, matrix = KinematicGraph.from_robot(robot), Reflection.from_robot(robot).frame.matrix
    assert np.array_equal(matrix @ matrix, np.eye(2 * graph.num_nodes))
    values = np.random.default_rng(0).normal(size=(graph.num_nodes, 2))
    seen = (values.reshape(-1) @ matrix).reshape(values.shape)
    assert np.array_equal(seen[0], values[0])  # height and forward velocity
    for name, sign in (("pitch", 1.0), ("roll", -1.0), ("yaw", -1.0), ("side", -1.0)):
        rows = [i for i, node in enumerate(graph.nodes) if node == f"torso_{name}"]
        assert len(rows) == (name == "pitch" or task != "walker")
        assert np.array_equal(seen[rows], sign * values[rows])
    feet = [i for i, kind in enumerate(graph.kinds) if kind == "ground"]
    assert np.array_equal(seen[feet], values[feet, ::-1]) and len(feet) == (2 if task == "quadruped" else 1)


def test_an_equivariant_network_needs_a_reflection(robot, graph):
    reflection = Reflection.from_robot(robot)
    for make in (make_actor, make_critic, make_stochastic_actor):
        with pytest.raises(ConfigError, match=r"equivariant: true needs .*reflection=Reflection\.from_robot"):
            make(graph, *SIZES, Network(equivariant=True))
        with pytest.raises(ConfigError, match="reflection of all 5 actions, got one of 6"):
            make(graph, 10, 5, Network(equivariant=True), reflection=reflection)
    # What critics see besides is a task's, so that the robot alone does not say how it looks in the mirror.
    with pytest.raises(ConfigError, match=r"all 4 numbers of the extra input, got one of 0: .* task\.reflection\(\)"):
        make_critic(graph, *SIZES, Network(equivariant=True), privileged_dim=4, reflection=reflection)


def reflected_state(robot, qpos, qvel):
    """Reflect the state of a robot with a free base and hinges in the xz plane."""
    qpos, qvel, q, v = qpos.copy(), qvel.copy(), qpos, qvel
    # The place's y; the turn about x and about z, which is all but the w and y of the quaternion; rates likewise.
    qpos[[1, 4, 6]] *= -1
    qvel[[1, 3, 5]] *= -1
    for joint in robot.joints:
        other, sign = robot.joint(robot.mirror[joint.name]), robot.mirror_sign(joint.name)
        qpos[other.qpos], qvel[other.qvel] = sign * q[joint.qpos], sign * v[joint.qvel]
    return qpos, qvel


@pytest.mark.parametrize("static", [False, True])
@pytest.mark.parametrize("name", ["ant", "humanoid"])
def test_a_mirrored_simulation_gets_the_mirrored_action(name, static):
    assets = Path(gymnasium.__file__).parent / "envs/mujoco/assets"
    model = mujoco.MjModel.from_xml_path(str(assets / f"{name}.xml"))
    sensor, rng = NodeSensor(model), np.random.default_rng(0)
    robot, (order, sign) = sensor.robot, sensor.robot.action_mirror
    actor = make_actor(
        sensor.graph,
        3 * sensor.features + static * len(STATIC),
        len(order),
        Network(equivariant=True),
        Reflection.from_robot(robot, static * len(STATIC)),
    )
    actor = randomised(actor)
    frames, down = ([], []), []
    for _ in range(3):
        qpos, qvel = robot.standing_qpos.copy(), 0.3 * rng.normal(size=model.nv)
        for joint in robot.joints:
            qpos[joint.qpos] += rng.uniform(-0.3, 0.3)
        qpos[3:7] += 0.1 * rng.normal(size=4)
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        # Down until the lowest foot's middle is in the ground.
        lowered = mujoco.MjData(model)
        lowered.qpos[:] = qpos
        mujoco.mj_kinematics(model, lowered)
        bodies = [body_name(model, body) for body in model.geom_bodyid]
        qpos[2] -= min(lowered.geom_xpos[i, 2] for i, body in enumerate(bodies) if body in robot.feet)
        for seen, state in zip(frames, ((qpos, qvel), reflected_state(robot, qpos, qvel)), strict=True):
            data = mujoco.MjData(model)
            data.qpos[:], data.qvel[:] = state
            mujoco.mj_forward(model, data)
            seen.append(torch.from_numpy(sensor.read(model, data)))
            down.append(sensor.feet_down(model, data).tolist())
    behind = [torch.from_numpy(sensor.static())] * static
    nodes, mirrored = (torch.cat([*seen, *behind], dim=-1)[None] for seen in frames)
    acts, acted = (actor(TensorDict({"nodes": x}, [1]))["action"][0].detach().numpy() for x in (nodes, mirrored))
    np.testing.assert_allclose(acted, sign * acts[order], atol=1e-5)
    # No trivial case: some feet are down and some are not, and the reflection is another state.
    assert any(any(feet) and not all(feet) for feet in down)
    assert np.abs(acted - acts).max() > 1e-3 and (nodes - mirrored).abs().max() > 0.1


def test_a_ball_joint_has_no_reflection():
    text = """<mujoco><worldbody><body name="trunk"><freejoint/><geom size=".1"/><body name="leg" pos="0 0 -.2">
    <joint name="hip" type="ball"/><geom size=".05"/></body></body></worldbody></mujoco>"""
    robot = Robot.from_mjcf(mujoco.MjModel.from_xml_string(text))
    with pytest.raises(RobotError, match=r"replay\.mirror and equivariant must be false; ball joints: hip"):
        Reflection.from_robot(robot)
