"""The height scan: rays by hand arithmetic, its mirror image, its noise, and its place in observations."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.features import Sensed
from gctd3.tasks.ground import ORIGIN, turned
from gctd3.tasks.height_scan import HeightScan
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.sensor_noise import OWN_NOISE
from gctd3.tasks.terrain import Terrain
from gctd3.tasks.terrain_kinds import Boxes, RoughGround, Stairs
from gctd3.tasks.velocity import VelocitySettings
from gctd3.tasks.walk import WalkSettings

STEP = {"stairs": Stairs(rise=0.1, tread=0.3, steps=1, rest=3.0)}
EXACT = HeightScan(noise=0.0)


def task_of(scan, kinds=None, robot="quadruped", **features):
    terrain = None if kinds is None else Terrain(kinds=kinds, levels=1, length=6.0, behind=1.0, width=2.0, flat=0.5)
    base = WalkSettings()
    named = {**base.features, **({} if scan is None else {"scan": scan}), **features}
    still = {"joint_noise": JointNoise(0.0, 0.0)}
    return replace(base, terrain=terrain, features=named, randomisations=still).build(RobotSettings(robot))


def sensed(task, forward=0.0, side=0.0, up=0.0, yaw=0.0):
    """Return the measurement of the standing robot, moved and turned, and the memory of its episode."""
    spot = task.first()
    qpos = task.put(task.robot.standing_qpos.copy(), spot)
    qpos[:3] += np.array([forward, side, up]) @ task.robot.base.frame
    turn = np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), yaw)
    mujoco.mju_mulQuat(qpos[3:7], turn, qpos[3:7].copy())
    model = task.robot.model
    now = task.measure(qpos, np.zeros(model.nv), np.zeros(model.nsensordata), spot)
    return Sensed(now, task.begin(now, np.random.default_rng(0), spot=spot), task.facts)


def test_rays_are_spaced_over_the_array():
    rays = HeightScan(length=1.0, width=0.4, ahead=0.2, along=3, across=2).rays
    np.testing.assert_allclose(rays[:, 0], [[-0.3, -0.2], [0.2, -0.2], [0.7, -0.2]])
    np.testing.assert_allclose(rays[:, 1], [[-0.3, 0.2], [0.2, 0.2], [0.7, 0.2]])
    np.testing.assert_allclose(HeightScan(along=1, across=1, ahead=0.3).rays, [[[0.3, 0.0]]])


def test_a_step_ahead_reads_its_height():
    """Half a metre before a step of 0.1 m: rays at -0.3 and 0.2 m read 0, the ray at 0.7 m reads 0.1."""
    scan = HeightScan(length=1.0, width=0.4, ahead=0.2, along=3, across=1, noise=0.0)
    task = task_of(scan, STEP)
    np.testing.assert_allclose(scan(sensed(task))[0], [0.0, 0.0, 0.1], atol=1e-12)
    # Turned round, rays up to 0.7 m behind see the step there; a body 5 cm higher reads 5 cm less.
    behind = replace(scan, ahead=-0.2)
    np.testing.assert_allclose(behind(sensed(task, yaw=np.pi))[0], [0.1, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(scan(sensed(task, up=0.05))[0], [-0.05, -0.05, 0.05], atol=1e-12)
    np.testing.assert_allclose(scan(sensed(task, forward=2.0, up=0.1))[0], 0.0, atol=1e-12)
    # At most half a metre.
    np.testing.assert_allclose(scan(sensed(task, up=3.0))[0], -0.5)


def test_rays_turn_with_the_heading_alone():
    """MuJoCo's rays at the places that yaw gives by hand, on rough ground, for a base anywhere."""
    task = task_of(EXACT, {"rough": RoughGround(height=0.1)})
    model, frame = task.stage.model, task.robot.base.frame
    data = mujoco.MjData(model)
    data.qpos[:] = task.robot.standing_qpos
    data.qpos[2] += 50.0
    mujoco.mj_forward(model, data)
    for forward, side, yaw in ((1.0, 0.2, 0.0), (2.5, -0.3, 0.7), (4.0, 0.0, -2.0)):
        there = sensed(task, forward, side, 0.02, yaw)
        here = there.memory[ORIGIN] + [forward, side] + task.ground._standing
        cos, sin = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cos, -sin], [sin, cos]])
        heights = []
        for place in EXACT.rays.reshape(-1, 2):
            start = np.array([*(here + turn @ place) @ frame[:2, :2], 5.0])
            found = np.zeros(1, dtype=np.int32)
            heights.append(5.0 - mujoco.mj_ray(model, data, start, np.array([0.0, 0.0, -1.0]), None, 1, -1, found))
        # The soles are where the body's height puts them: 2 cm over the floor's level.
        np.testing.assert_allclose(EXACT(there)[0], np.array(heights) - 0.02, atol=1e-9)


def test_it_reads_the_height_where_there_is_no_terrain():
    task = task_of(EXACT)
    np.testing.assert_allclose(EXACT(sensed(task, up=0.03))[0], -0.03, atol=1e-12)
    np.testing.assert_allclose(task.node_features(sensed(task).now)[0, 2:], 0.0, atol=1e-7)


def test_the_mirror_image_sees_the_mirrored_ground():
    """What a robot sees on ground that is reflected at its plane is the table's reflection of what it saw."""
    task = task_of(EXACT, {"boxes": Boxes(share=0.4)})
    there = sensed(task, forward=2.0, side=0.1)
    ground = task.ground
    seen = task.node_features(there.now, {k: v for k, v in there.memory.items() if k != OWN_NOISE})
    source, sign = task.table.reflection()
    reflected = (sign * seen.reshape(-1)[source]).reshape(seen.shape)
    flipped = EXACT.rays * [1.0, -1.0]
    here = ground.whereabouts(there.now, there.now.base[task.facts.base.index("side"), 0], there.memory)
    places = here + turned(flipped.reshape(-1, 2), np.asarray(0.0))
    soles = there.now.height + ground.below(here, np.asarray(0.0))
    np.testing.assert_allclose(reflected[0, 2:], ground.height(places) - soles, atol=1e-6)
    assert (reflected[0, 2:] != seen[0, 2:]).any()


def test_each_ray_has_noise_of_its_own_in_trainings_alone():
    """A standard deviation of 2 cm over 400 robots and 18 rays, anew in each frame; other features stay exact."""
    task = task_of(HeightScan(noise=0.02), STEP)
    simulation = Simulation(task, 400, threads=1)
    simulation.reset(np.ones(400, dtype=bool))
    exact = {k: v for k, v in simulation.memory.items() if k != OWN_NOISE}
    off = task.node_features(simulation.now, simulation.memory) - task.node_features(simulation.now, exact)
    assert np.std(off[:, 0, 2:]) == pytest.approx(0.02, rel=0.05)
    assert not off[:, 1:].any() and not off[:, 0, :2].any()
    before = simulation.memory[OWN_NOISE]
    simulation.step(np.zeros((400, task.facts.actions)))
    assert (simulation.memory[OWN_NOISE][:, 0, 2:] != before[:, 0, 2:]).all()
    assert task.evaluated(task.reward).memory.noise is None


def test_critics_alone_may_see():
    """As a privileged feature it is in the critics' input, without noise, and not in the nodes."""
    terrain = Terrain(kinds=STEP, levels=1, length=6.0, behind=1.0, width=2.0, flat=0.5)
    base = VelocitySettings()
    blind = replace(base, terrain=terrain).build(RobotSettings("quadruped"))
    task = replace(base, terrain=terrain, privileged={**base.privileged, "scan": HeightScan()}).build(
        RobotSettings("quadruped")
    )
    assert task.features == blind.features and task.num_counters == blind.num_counters + 18
    there = sensed(task, forward=-0.05)
    counters = task.counters(there.memory, there.now)
    # Of the rays from -0.3 to 0.7 m those at 0.7 m are on the step 0.55 m ahead.
    assert np.isclose(counters, 0.1).sum() == 3
    assert OWN_NOISE not in there.memory


@pytest.mark.parametrize(
    ("scan", "said"),
    [
        (
            HeightScan(width=2.5),
            r"^task\.features\.scan\.width must be at most 2 m, that of the terrain",
        ),
        (HeightScan(length=9.0), r"^task\.features\.scan\.length must be at most 7 m"),
    ],
)
def test_a_scan_wider_than_the_terrain_is_refused(scan, said):
    with pytest.raises(ConfigError, match=said):
        task_of(scan, STEP)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"along": 0}, "along must be at least 1"),
        ({"along": 100, "across": 100}, "at most 1,000 rays"),
        ({"farthest": 0.0}, "farthest must be above 0"),
        ({"noise": -1.0}, "noise must be at least 0"),
    ],
)
def test_wrong_scans_are_refused(arguments, said):
    with pytest.raises(ConfigError, match=said):
        HeightScan(**arguments)
