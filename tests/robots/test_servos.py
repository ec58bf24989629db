"""Servos of files as people own them: what drives a joint becomes a position servo, and what is changed is said."""

import mujoco
import numpy as np
import pytest
from compositions import STILL, walking
from incomplete_files import CASES, case, dog, trains
from suite_robots import load

from gctd3.envs.simulation import Simulation
from gctd3.errors import RobotError
from gctd3.robots.ground import contact_sensors
from gctd3.robots.robot import Robot
from gctd3.robots.servo_settings import ServoSettings
from gctd3.robots.settings import RobotSettings


def test_motors_become_servos_with_the_torque_of_the_motors():
    robot = case("robots/02_motors.xml").load()
    model = robot.model
    assert robot.action_names == ("hip_left", "knee_left", "hip_right", "knee_right")
    np.testing.assert_array_equal(model.actuator_forcerange, [[-30, 30]] * 4)
    np.testing.assert_array_equal(model.actuator_gear[:, 0], 1)
    np.testing.assert_allclose(model.actuator_ctrlrange, model.jnt_range[1:])
    # Stiff enough for the torque to be used, soft enough not to be at its limit at once.
    assert ((30 / model.actuator_gainprm[:, 0] >= 0.59) & (30 / model.actuator_gainprm[:, 0] <= 1.51)).all()
    np.testing.assert_array_equal(model.actuator_gainprm[::2], model.actuator_gainprm[[0, 0]])


def test_gains_follow_from_the_rotor(tmp_path):
    path = dog(tmp_path, '<motor joint="{n}" ctrlrange="-40 40"/>')
    path.write_text(path.read_text().replace('axis="0 1 0"', 'axis="0 1 0" armature="0.01"'))
    model = RobotSettings(name=str(path)).load().model
    # 10 Hz and a damping ratio of 2: 0.01 (20 pi)^2 and 4 * 0.01 * 20 pi.
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], 39.5, rtol=1e-3)
    np.testing.assert_allclose(-model.actuator_biasprm[:, 2], 2.51, rtol=1e-2)


def test_a_file_without_actuators_gets_servos_for_every_hinge(tmp_path):
    robot = RobotSettings(name=str(dog(tmp_path))).load()
    assert robot.actuated == tuple(joint.name for joint in robot.joints) and len(robot.joints) == 8
    trains(robot)


def test_servos_of_endless_joints_turn_by_half_a_turn(tmp_path):
    path = dog(tmp_path, '<position joint="{n}" kp="40" kv="1"/>')
    path.write_text(path.read_text().replace('name="hip_fl" axis="0 1 0" range="-90 90"', 'name="hip_fl" axis="0 1 0"'))
    robot = RobotSettings(name=str(path)).load()
    home = robot.standing_qpos[robot.joint("hip_fl").qpos]
    np.testing.assert_allclose(robot.action_range[0], [home - np.pi, home + np.pi])
    np.testing.assert_allclose(robot.action_range[1], robot.joint("knee_fl").range)
    assert any("turn hip_fl by half a turn" in note for note in robot.notes)


def test_settings_say_what_servos_are_like(tmp_path):
    servos = {"knee_*": ServoSettings(stiffness=50, damping=2, effort=20, armature=0.02), "*": ServoSettings(effort=9)}
    path = dog(tmp_path, '<position joint="{n}" kp="40" kv="1" ctrlrange="-1 1"/>')
    robot = RobotSettings(name=str(path), servos=servos).load()
    model = robot.model
    np.testing.assert_array_equal(model.actuator_gainprm[:2, 0], [40, 50])
    np.testing.assert_array_equal(model.actuator_biasprm[:2, 2], [-1, -2])
    np.testing.assert_array_equal(model.actuator_forcerange[:2, 1], [9, 20])
    assert model.dof_armature[model.joint("knee_fl").dofadr[0]] == 0.02
    with pytest.raises(RobotError, match=r"'knees', which fits no joint. Did you mean 'knee_"):
        RobotSettings(name=str(path), servos={"knees": ServoSettings(effort=1)}).load()


def test_a_range_in_degrees_is_named():
    with pytest.raises(RobotError, match=r"'a_hip_right', -45 to 45 rad, lies far outside .*'hip_right', -0.7854 to"):
        case("servos/ctrl_deg.xml").load()


def test_servos_with_a_gear_reach_the_angle_that_is_asked_for():
    robot = case("servos/gear2.xml").load()
    raw = mujoco.MjModel.from_xml_path(str(CASES / "servos/gear2.xml"))
    np.testing.assert_array_equal(robot.model.actuator_gear[:, 0], 1)
    np.testing.assert_allclose(robot.action_range, raw.actuator_ctrlrange / 2)
    # The same physics: half of what the servo with the gear is told.
    a, b, targets = mujoco.MjData(raw), mujoco.MjData(robot.model), np.array([0.3, -0.5, 0.2, -0.4])
    a.ctrl[:], b.ctrl[:] = targets, targets / 2
    for data in (a, b):
        data.qpos[:] = robot.standing_qpos
    for _ in range(40):
        mujoco.mj_step(raw, a)
        mujoco.mj_step(robot.model, b)
    np.testing.assert_allclose(a.qpos, b.qpos, atol=1e-9)


def test_no_position_servo_is_refused_before_training(tmp_path):
    text = dog(tmp_path, '<intvelocity joint="{n}" kp="40" actrange="-1 1" ctrlrange="-1 1"/>').read_text()
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(RobotError, match="must be a <position> servo"):
        walking(Robot.from_mjcf(path))
    robot = RobotSettings(name=str(path)).load()
    assert robot.model.na == 0 and robot.model.actuator_gainprm[0, 0] == 40
    trains(robot)


def test_a_joint_s_torque_limit_is_moved_to_its_servo(tmp_path):
    path = dog(tmp_path, '<position joint="{n}" kp="40" kv="1" ctrlrange="-1 1"/>')
    path.write_text(path.read_text().replace('range="', 'actuatorfrcrange="-12 12" range="', 1))
    robot = RobotSettings(name=str(path)).load()
    assert not robot.model.jnt_actfrclimited.any()
    assert robot.model.actuator_forcerange[0].tolist() == [-12, 12] and not robot.model.actuator_forcelimited[1]
    assert any("torque limits of hip_fl" in note for note in robot.notes)


@pytest.mark.parametrize("complete_it", [False, True])
def test_servos_with_a_state_of_their_own_stand_at_the_start(complete_it):
    path = str(CASES / "servos/timeconst_key.xml")
    robot = RobotSettings(name=path).load() if complete_it else Robot.from_mjcf(path)
    task = walking(robot, **STILL)
    simulation, env = Simulation(task, 1, threads=1), load(task)
    simulation.reset(np.ones(1, dtype=bool))
    env.reset()
    low, high = robot.action_range.T
    joints = [robot.joint(name).qpos for name in robot.actuated]
    action = 2 * (robot.standing_qpos[joints] - low) / (high - low) - 1
    simulation.step(action[None])
    env.step(action)
    for qpos in (simulation.qpos[0], env.physics.data.qpos):
        assert qpos[robot.joint("hip_right").qpos] == pytest.approx(0.3, abs=0.02)
    np.testing.assert_array_equal(simulation.qpos[0], env.physics.data.qpos)


def test_delayed_servos_stand_at_the_start(tmp_path):
    pose = f"0 0 {0.4 * np.cos(0.5) + 0.03} 1 0 0 0" + " .5 -1" * 4
    delayed = '<position joint="{n}" kp="60" kv="2" delay="0.016" nsample="9" ctrlrange="-2 2"/>'
    path = dog(tmp_path, delayed, rest=f'<keyframe><key name="home" qpos="{pose}"/></keyframe>')
    robot = RobotSettings(name=str(path)).load()
    task = walking(robot, **STILL)
    simulation, env = Simulation(task, 1, threads=1), load(task)
    simulation.reset(np.ones(1, dtype=bool))
    env.reset()
    joints = [robot.joint(name).qpos for name in robot.actuated]
    low, high = robot.action_range.T
    action = 2 * (robot.standing_qpos[joints] - low) / (high - low) - 1
    simulation.step(action[None])
    env.step(action)
    np.testing.assert_allclose(simulation.qpos[0, joints], robot.standing_qpos[joints], atol=0.05)
    np.testing.assert_array_equal(simulation.qpos[0], env.physics.data.qpos)


def test_a_servo_that_is_too_weak_is_named(tmp_path):
    path = dog(tmp_path, '<position joint="{n}" kp="400" kv="4" ctrlrange="-3 3" forcerange="-2 2"/>')
    notes = RobotSettings(name=str(path)).load().notes
    assert any("falling" in note or "all of their torque" in note for note in notes)


def test_soft_servos_that_sag_keep_the_sensors_of_the_shanks(tmp_path):
    """Told the pose itself they sag onto their shanks; an action of 0 carries the weight."""
    pose = "0 0 .35 1 0 0 0" + " .7 -1.4" * 4
    rest = f'<keyframe><key name="home" qpos="{pose}"/></keyframe>'
    path = dog(tmp_path, '<position joint="{n}" kp="15" kv=".5" ctrlrange="-3 3"/>', rest=rest)
    robot = RobotSettings(name=str(path)).load()
    assert not any("rests on" in note for note in robot.notes)
    data, sensors = mujoco.MjData(robot.model), contact_sensors(robot.model, robot.base.root)
    touched = {}
    for name, command in (("pose", robot.standing_qpos[7:]), ("zero", robot.standing_command)):
        mujoco.mj_resetData(robot.model, data)
        data.qpos[:], data.ctrl[:] = robot.standing_qpos, command
        mujoco.mj_step(robot.model, data, 1500)
        touched[name] = {body for body, address in sensors.items() if data.sensordata[address]} - set(robot.feet)
    assert touched == {"pose": {"thigh_hl", "thigh_hr"}, "zero": set()}
