"""Actions about the standing pose: their scale, the command that carries the weight, and the hips."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError
from gctd3.robots.action_scale import find_action_scale
from gctd3.robots.actuators import torque_limit
from gctd3.robots.geometry import lowest_point
from gctd3.robots.mjcf import colliding_geoms
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.terminations import Fall
from gctd3.tasks.walk import WalkingTask, WalkSettings, paper_terminations

CASES = Path(__file__).parent / "cases" / "robots"


@pytest.fixture(scope="module")
def quadruped():
    return RobotSettings("quadruped", action_scale=0.3).load()


def softened(robot, factor):
    """Return the robot crouching, with servos of a fraction of their stiffness, by MuJoCo's own specification."""
    spec = mujoco.MjSpec.from_file(str(robot.path))
    for actuator in spec.actuators:
        actuator.gainprm[0] *= factor
        actuator.biasprm[1] *= factor
    model = spec.compile()
    pose = robot.standing_qpos.copy()
    for joint in robot.joints:
        bent = {"hip": 0.5, "knee": -1.0, "ankle": 0.5}
        pose[joint.qpos] = next(angle for part, angle in bent.items() if joint.name.startswith(part))
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    feet = [geom for foot in robot.feet for geom in colliding_geoms(model, model.body(foot).id)]
    pose[2] -= lowest_point(model, data, feet)
    for key in list(spec.keys):
        spec.delete(key)
    spec.add_key(name="stand", qpos=pose)
    return Robot.from_mjcf(spec)


def test_the_papers_robot_keeps_its_table():
    """Without a scale, [-1, 1] is mapped onto the servos' ranges: the ends and the middle, exactly."""
    robot = RobotSettings("biped").load()
    low, high = robot.model.actuator_ctrlrange.T
    assert robot.action_scale is None
    for action, expected in ((-1.0, low), (1.0, high), (0.0, (low + high) / 2), (7.0, high)):
        np.testing.assert_allclose(robot.desired_angles(np.full(6, action)), expected, rtol=0, atol=1e-15)


def test_an_action_moves_the_angle_by_its_scale_within_the_servos_range(quadruped):
    centre, scale = quadruped.action_map
    low, high = quadruped.model.actuator_ctrlrange.T
    np.testing.assert_array_equal(scale, 0.3)
    np.testing.assert_array_equal(quadruped.desired_angles(np.zeros(12)), centre)
    for action in (-1.0, -0.4, 0.25, 1.0, 3.0):
        expected = np.clip(centre + 0.3 * np.clip(action, -1, 1), low, high)
        np.testing.assert_allclose(quadruped.desired_angles(np.full((2, 12), action)), [expected] * 2, atol=1e-15)


def test_a_derived_scale_uses_the_whole_torque(quadruped):
    """Torque over stiffness, between 0.15 and 0.5 rad: 60 N m at 150 N m/rad are 0.4 rad."""
    model = mujoco.MjModel.from_xml_path(str(quadruped.path))
    for index, (stiffness, effort) in enumerate([(150.0, 60.0), (1000.0, 60.0), (50.0, 60.0)]):
        model.actuator_gainprm[index, 0], model.actuator_biasprm[index, 1] = stiffness, -stiffness
        model.actuator_forcelimited[index], model.actuator_forcerange[index] = 1, (-effort, effort)
    model.actuator_forcelimited[3] = 0
    robot = Robot.from_mjcf(model)
    scale = find_action_scale(robot, None, least=0.15)
    assert scale[:4] == pytest.approx((0.4, 0.15, 0.5, 0.5))
    assert torque_limit(robot, 0) == 60.0 and torque_limit(robot, 3) == np.inf


def test_scales_by_pattern(quadruped):
    scale = find_action_scale(quadruped, {"hip_*": 0.2, "*": 0.4}, least=0.15)
    assert scale == tuple(0.2 if name.startswith("hip_") else 0.4 for name in quadruped.actuated)
    assert find_action_scale(quadruped, "range", least=0.15) is None


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("home", "must be range, a number, a mapping or null, got 'home'"),
        (0.0, "must be above 0 rad"),
        ({"hop_*": 0.2}, "'hop_\\*' fits no driven joint.*Joints: "),
        ({"hip_*": 0.2}, "gives no scale for joint 'knee_"),
    ],
)
def test_wrong_scales_are_refused(quadruped, asked, message):
    with pytest.raises(ConfigError, match=message):
        find_action_scale(quadruped, asked, least=0.15)


def height_after(robot, seconds=2.0):
    """Return how much higher than standing (m) the body is after holding an action of 0."""
    ends = {**paper_terminations(), "long_contact": None, "stuck_hip": None, "fall": Fall(height=-1.0)}
    simulation = Simulation(
        WalkingTask(robot, settings=WalkSettings(terminations=ends, randomisations={})), 1, threads=1
    )
    simulation.reset(np.ones(1, dtype=bool))
    for _ in range(round(seconds / 0.02)):
        simulation.step(np.zeros((1, len(robot.actuated))))
    return float(simulation.now.height[0])


def test_an_action_of_zero_carries_the_weight(quadruped):
    """Soft servos that are told the standing pose sag; the command that was found for them keeps the height."""
    from gctd3.robots.standing_command import find_standing_command

    soft = replace(softened(quadruped, 0.1), action_scale=(0.3,) * 12)
    carried = replace(soft, standing_command=tuple(find_standing_command(soft).tolist()))
    sagging, standing = height_after(soft), height_after(carried)
    assert sagging < -0.02
    assert abs(standing) < 0.5 * abs(sagging)
    order, sign = carried.action_mirror
    command = np.array(carried.standing_command)
    np.testing.assert_allclose(command, sign * command[order], atol=1e-12)


@pytest.mark.parametrize("case", ["06_waist_above_legs.xml", "08_abduction_first.xml"])
def test_the_hip_swings_its_own_leg_forwards(case):
    """Neither a shared waist nor abduction: the joint that moves the foot forwards in MuJoCo's kinematics."""
    robot = RobotSettings(str(CASES / case)).load()
    assert sorted(hip.name for hip in robot.hips) == ["hip_left", "hip_right"]
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(robot.model, data)
    before = [robot.foot_place(data, foot) for foot in robot.feet]
    for hip, foot, place in zip(robot.hips, robot.feet, before, strict=True):
        data.qpos[:] = robot.standing_qpos
        data.qpos[hip.qpos] += 0.01
        mujoco.mj_kinematics(robot.model, data)
        moved = np.abs(robot.base.frame @ (robot.foot_place(data, foot) - place))
        assert moved.argmax() == 0 and moved[0] > 1e-3
