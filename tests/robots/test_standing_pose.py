"""Shipped robots stand and start in their reference pose, others as their MJCF says or on the ground."""

import mujoco
import numpy as np
import pytest
from compositions import STILL, walking
from robots import FREE_LEGS, TWO_LEGS, write
from suite_robots import load

from gctd3.envs.gym import BipedVectorEnv
from gctd3.envs.simulation import BEGINNING, Simulation
from gctd3.errors import RobotError
from gctd3.evaluation.perturbations import resting_action
from gctd3.robots.robot import Robot

HILL = '<asset><hfield name="hill" nrow="2" ncol="2" size="5 5 1 1" elevation="0 1 0 1"/></asset><worldbody>'
# Legs of 0.52 m swung forward by 0.6 rad: 0.5 m cos 0.6 and the sphere of 0.02 m at their ends.
CROUCHED = 0.5 * np.cos(0.6) + 0.02


def key(text, name, *qpos):
    pose = " ".join(str(float(value)) for value in qpos)
    return text.replace("</mujoco>", f'<keyframe><key name="{name}" qpos="{pose}"/></keyframe></mujoco>')


def starts(robot):
    """Return ``qpos`` at the start of an episode without noise, on both backends."""
    task = walking(robot, **STILL)
    simulation, env = Simulation(task, 2, threads=1), load(task)
    simulation.reset(np.ones(2, dtype=bool))
    env.reset()
    np.testing.assert_array_equal(simulation.qpos[0], simulation.qpos[1])
    return simulation.qpos[0], env.physics.data.qpos.copy()


@pytest.mark.parametrize("name", ["biped", "biped_planar", "quadruped", "hexapod"])
def test_shipped_robots_drop_from_their_reference_pose(name):
    robot = Robot.from_mjcf(name)
    model, data = robot.model, mujoco.MjData(robot.model)
    np.testing.assert_array_equal(robot.standing_qpos, model.key("stand").qpos)
    for start in starts(robot):
        np.testing.assert_array_equal(start, model.qpos0)
    # To the last bit: MuJoCo's own result from the same random numbers.
    simulation, rng = Simulation(walking(robot), 1, seed=7, threads=1), np.random.default_rng(7)
    simulation.reset(np.ones(1, dtype=bool))
    data.time = BEGINNING
    data.qpos[[j.qpos for j in robot.joints]] += rng.uniform(-0.05, 0.05, len(robot.joints))
    data.qvel[[j.qvel for j in robot.joints]] += rng.uniform(-0.1, 0.1, len(robot.joints))
    action = rng.uniform(-1.0, 1.0, (5, 1, model.nu))
    for step in action:
        data.ctrl[:] = simulation.desired(step)[0]
        mujoco.mj_step(model, data, simulation.substeps)
        simulation.step(step)
        np.testing.assert_array_equal(simulation.qpos[0], data.qpos)


@pytest.mark.parametrize("text", [TWO_LEGS, TWO_LEGS.replace('axis="0 0 1"', 'axis="0 0 -1"'), FREE_LEGS])
@pytest.mark.parametrize("spawned", [1.0, 0.3, 0.0])
def test_without_a_key_it_stands_where_its_feet_touch(tmp_path, text, spawned):
    robot = Robot.from_mjcf(write(tmp_path, text.replace('pos="0 0 1"', f'pos="0 0 {spawned}"')))
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(robot.model, data)
    assert data.body("torso").xpos[2] == pytest.approx(0.52)
    for start in starts(robot):
        np.testing.assert_array_equal(start, robot.standing_qpos)


def test_it_stays_up_where_it_stands(tmp_path):
    path = write(tmp_path, TWO_LEGS)
    robot = Robot.from_mjcf(path)
    simulation = Simulation(walking(robot, contact_steps=None, hip_steps=None, **STILL), 1)
    simulation.reset(np.ones(1, dtype=bool))
    for _ in range(60):
        outcome = simulation.step(resting_action(robot).numpy()[None])
        assert abs(simulation.now.height[0]) < 0.01 and not outcome.terminated[0]
    assert simulation.now.feet_down.all()
    # Through Gymnasium: the root's first feature is its height from standing.
    assert BipedVectorEnv(2, str(path), history=1, threads=1, observation="nodes").reset(seed=0)[0][
        :, 0, 0
    ] == pytest.approx(0.0, abs=1e-6)


def test_a_small_drop_is_left_as_it_is(tmp_path):
    robot = Robot.from_mjcf(write(tmp_path, TWO_LEGS.replace('pos="0 0 1"', 'pos="0 0 0.55"')))
    assert robot.standing_qpos.tolist() == pytest.approx([0.0, -0.03, 0.0, 0.0])
    for start in starts(robot):
        np.testing.assert_array_equal(start, np.zeros(4))


@pytest.mark.parametrize("name", ["stand", "home"])
@pytest.mark.parametrize(
    ("text", "base"), [(TWO_LEGS, (0, CROUCHED - 1.0)), (FREE_LEGS, (0, 0, CROUCHED, 1, 0, 0, 0))], ids=["boom", "free"]
)
def test_it_starts_in_the_named_pose(tmp_path, name, text, base):
    path = write(tmp_path, key(text, name, *base, 0.6, -0.6))
    robot = Robot.from_mjcf(path)
    pose = robot.model.key(name).qpos
    np.testing.assert_array_equal(robot.standing_qpos, pose)
    for start in starts(robot):
        np.testing.assert_array_equal(start, pose)
    frame = BipedVectorEnv(1, str(path), history=1, threads=1, observation="nodes").reset(seed=0)[0][0]
    assert frame[0, 0] == pytest.approx(0.0, abs=1e-6)
    # The joints, off by noise; those of a free base are measured from the pose.
    np.testing.assert_allclose(np.abs(frame[[-3, -2], 0]), 0.0 if text == FREE_LEGS else 0.6, atol=0.05)
    asked = Simulation(walking(robot), 1, threads=1).desired(resting_action(robot).numpy()[None].astype(float))
    np.testing.assert_allclose(asked, [[0.6, -0.6]], atol=1e-6)


def test_the_key_stand_comes_before_home(tmp_path):
    text = key(key(TWO_LEGS, "home", 0, -0.48, 0.1, 0.1), "stand", 0, CROUCHED - 1.0, 0.6, -0.6)
    assert Robot.from_mjcf(write(tmp_path, text)).standing_qpos[2] == 0.6


@pytest.mark.parametrize(
    ("above", "said"), [(0.17, r"0\.17 m: lower it by 0\.17 m"), (-0.3, r"-0\.3 m: raise it by 0\.3 m")]
)
def test_a_named_pose_off_the_ground_is_refused(tmp_path, above, said):
    robot = Robot.from_mjcf(write(tmp_path, key(TWO_LEGS, "home", 0, -0.48 + above, 0, 0)))
    with pytest.raises(RobotError, match=rf"key 'home' must stand .* at z = 0 m, but its lowest foot .* z = {said}"):
        robot.check_walking()


@pytest.mark.parametrize(
    ("ground", "height"),
    [('type="plane" size="0 0 1" pos="0 0 0.2"', 0.2), ('type="box" size="9 9 0.1" pos="0 0 -0.3"', -0.2)],
)
def test_ground_at_another_height(tmp_path, ground, height):
    text = TWO_LEGS.replace('type="plane" size="0 0 1"', ground)
    assert text != TWO_LEGS
    robot = Robot.from_mjcf(write(tmp_path, text))
    assert robot.standing_qpos[robot.vertical] == pytest.approx(height - 0.48)


@pytest.mark.parametrize("ground", ['type="plane" size="0 0 1" euler="0 0.2 0"', 'type="hfield" hfield="hill"'])
def test_on_ground_that_is_not_level_it_starts_where_the_mjcf_puts_it(tmp_path, ground):
    text = TWO_LEGS.replace('type="plane" size="0 0 1"', ground).replace("<worldbody>", HILL, 1)
    for start in starts(Robot.from_mjcf(write(tmp_path, text))):
        np.testing.assert_array_equal(start, np.zeros(4))
