"""Files of robots as people own them train: what they lack is added and said, and what they have stays."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from compositions import STILL, walking
from suite_robots import load

from gctd3.envs.simulation import Simulation
from gctd3.errors import RobotError
from gctd3.robots.completion import complete
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.ground import contact_sensors
from gctd3.robots.robot import Robot
from gctd3.robots.servo_settings import ServoSettings
from gctd3.robots.settings import RobotSettings

CASES = Path(__file__).parent / "cases"
SHIPPED = ("biped", "biped_planar", "quadruped", "hexapod")
LEG = """
<body name="thigh_{n}" pos="{x} {y} 0"><joint name="hip_{n}" axis="0 1 0" range="-90 90"/>
  <geom name="thigh_{n}" type="capsule" fromto="0 0 0 0 0 -.2" size=".03" mass=".5"/>
  <body name="shank_{n}" pos="0 0 -.2"><joint name="knee_{n}" axis="0 1 0" range="-150 5"/>
    <geom name="shank_{n}" type="capsule" fromto="0 0 0 0 0 -.17" size=".02" mass=".3"/>
    <geom name="ball_{n}" size=".03" pos="0 0 -.2" mass=".05"/>
  </body>
</body>"""
LEGS = [("fl", 0.2, 0.1), ("fr", 0.2, -0.1), ("hl", -0.2, 0.1), ("hr", -0.2, -0.1)]


def dog(tmp_path, actuator="", floor='<geom name="floor" type="plane" size="0 0 1"/>', rest="", inside="", legs=LEGS):
    """A robot with four legs of two joints; ``{n}`` in ``actuator`` is each joint's name."""
    joints = [f"{part}_{n}" for n, *_ in legs for part in ("hip", "knee")]
    drives = "".join(actuator.format(n=joint) for joint in joints)
    path = tmp_path / "dog.xml"
    path.write_text(
        f"""<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>{floor}
        <body name="trunk" pos="0 0 .5"><freejoint/><geom name="trunk" type="box" size=".25 .08 .05" mass="6"/>
        {"".join(LEG.format(n=n, x=x, y=y) for n, x, y in legs)}{inside}</body></worldbody>
        <actuator>{drives}</actuator>{rest}</mujoco>"""
    )
    return path


def case(name):
    return RobotSettings(name=str(CASES / name))


def trains(robot, steps=20):
    """The simulation after some steps of random actions, which must stay finite."""
    simulation = Simulation(walking(robot, **STILL), 2, threads=1)
    simulation.reset(np.ones(2, dtype=bool))
    rng = np.random.default_rng(0)
    for _ in range(steps):
        simulation.step(rng.uniform(-0.1, 0.1, (2, len(robot.actuated))))
    assert np.isfinite(simulation.state).all()
    return simulation


def bits(model):
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer


# What lacks nothing.


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_robots_are_as_their_files_say(name):
    robot, raw = RobotSettings(name=name).load(), Robot.from_mjcf(name)
    assert robot.notes == () and robot.held == {}
    np.testing.assert_array_equal(bits(robot.model), bits(mujoco.MjModel.from_xml_path(str(raw.path))))
    assert (robot.joints, robot.feet, robot.actuated) == (raw.joints, raw.feet, raw.actuated)


@pytest.mark.parametrize("file", ["robots/02_motors.xml", "robots/16_jointless_feet_FL_FR.xml", "servos/gear2.xml"])
def test_a_completed_file_lacks_nothing(tmp_path, file):
    first = case(file).load()
    spec = mujoco.MjSpec.from_file(str(CASES / file))
    completed = complete(spec, CASES / file, case(file))
    path = tmp_path / "again.xml"
    path.write_text(completed.spec.to_xml())
    again = RobotSettings(name=str(path)).load()
    assert again.notes == ()
    assert again.feet == first.feet and again.actuated == first.actuated
    assert [j.name for j in again.joints] == [j.name for j in first.joints]
    np.testing.assert_allclose(again.standing_qpos, first.standing_qpos, atol=1e-5)


# Ground, contact and feet.


@pytest.mark.parametrize(
    "name",
    [
        "01_no_contact_sensor",
        "02_motors",
        "03_contact_pairs",
        "06_waist_above_legs",
        "08_abduction_first",
        "09_key_standing",
        "10_passive_ball_rod",
        "12_no_joint_actuator",
        "16_jointless_feet_FL_FR",
    ],
)
def test_small_files_train_as_they_are(name):
    robot = case(f"robots/{name}.xml").load()
    robot.check_walking()
    assert all(note.endswith(".") and "\n" not in note for note in robot.notes)
    assert len(robot.feet) == 2
    trains(robot)


def test_a_level_plane_is_added_where_there_is_no_ground(tmp_path):
    robot = RobotSettings(name=str(dog(tmp_path, floor=""))).load()
    floor = robot.model.geom("floor")
    assert floor.type == mujoco.mjtGeom.mjGEOM_PLANE and floor.pos.tolist() == [0, 0, 0]
    assert any("no ground" in note for note in robot.notes)
    # Dropped, it rests on its feet.
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.start_qpos
    mujoco.mj_step(robot.model, data, 500)
    assert data.qpos[2] > 0.0 and data.ncon >= 4


def test_the_velocity_of_a_foot_is_that_of_its_sole(tmp_path):
    """A shank that turns about its knee moves its sole by the height of the knee over the ground."""
    robot = RobotSettings(name=str(dog(tmp_path))).load()
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    for foot, sensor in zip(robot.feet, robot.foot_velocity_sensors, strict=True):
        knee = robot.joint(f"knee_{foot[-2:]}")
        data.qvel[:] = 0.0
        data.qvel[knee.qvel] = 2.0  # rad/s
        mujoco.mj_forward(model, data)
        sole = data.geom_xpos[model.geom(f"ball_{foot[-2:]}").id, 2] - 0.03
        assert abs(data.sensordata[sensor[0]]) == pytest.approx(2.0 * (data.xanchor[knee.id, 2] - sole), rel=0.01)


def test_the_ground_that_pairs_name_is_added(tmp_path):
    pairs = "".join(f'<pair geom1="ball_{n}" geom2="arena"/>' for n, *_ in LEGS)
    path = dog(tmp_path, floor="", rest=f"<contact>{pairs}</contact>")
    assert RobotSettings(name=str(path)).load().model.geom("arena").type == mujoco.mjtGeom.mjGEOM_PLANE


def test_geoms_for_collisions_touch_the_ground_in_a_file_without_its_scene(tmp_path):
    path = dog(tmp_path, floor="")
    text = path.read_text().replace('<geom name="', '<geom contype="0" conaffinity="0" group="3" name="')
    path.write_text(text)
    robot = RobotSettings(name=str(path)).load()
    assert len(robot.feet) == 4 and any("those of group 3 and above touch the ground" in note for note in robot.notes)
    path.write_text(text.replace('group="3"', ""))
    with pytest.raises(RobotError, match=r"has no foot: no .* can touch the ground"):
        RobotSettings(name=str(path)).load()


def test_a_level_box_and_a_height_field_are_ground(tmp_path):
    box = '<geom name="slab" type="box" size="5 5 .1" pos="0 0 -.3"/>'
    robot = RobotSettings(name=str(dog(tmp_path, floor=box))).load()
    # Two links at 0.87 of their length above the top of the slab.
    assert robot.standing_qpos[2] == pytest.approx(0.87 * 0.4 + 0.03 - 0.2, abs=0.005)
    field = '<geom name="hill" type="hfield" hfield="hill" pos="0 0 .5"/>'
    path = dog(tmp_path, floor=field, rest="")
    asset = (
        '<asset><hfield name="hill" nrow="3" ncol="3" size="5 5 1 1" elevation="1 1 1 1 1 1 1 1 1"/></asset><worldbody>'
    )
    path.write_text(path.read_text().replace("<worldbody>", asset))
    robot = RobotSettings(name=str(path)).load()
    assert [name for name in range(robot.model.ngeom) if robot.model.geom_type[name] == 0] == []
    assert len(robot.feet) == 4


def test_shanks_that_carry_a_ball_get_feet_of_their_own(tmp_path):
    path = dog(tmp_path)
    robot, before = RobotSettings(name=str(path)).load(), mujoco.MjModel.from_xml_path(str(path))
    assert robot.feet == ("ball_fl", "ball_fr", "ball_hl", "ball_hr")
    assert robot.shanks == ("shank_fl", "shank_fr", "shank_hl", "shank_hr")
    assert {"thigh_fl", "trunk"} <= set(robot.other_contact_bodies)
    same_dynamics(before, robot.model)


@pytest.mark.parametrize("inertial", ["", '<inertial pos=".01 0 -.1" mass=".4" diaginertia=".002 .002 .0003"/>'])
def test_masses_stay_where_they_are_when_feet_are_split_off(tmp_path, inertial):
    path = dog(tmp_path)
    text = path.read_text()
    for n, *_ in LEGS:
        text = text.replace(f'<joint name="knee_{n}"', f'{inertial}<joint name="knee_{n}"')
    path.write_text(text)
    same_dynamics(mujoco.MjModel.from_xml_path(str(path)), RobotSettings(name=str(path)).load().model)


def same_dynamics(before, after):
    """Total mass, inertia matrix and accelerations in the air are equal in random states."""
    assert before.nv == after.nv
    np.testing.assert_allclose(before.body_mass.sum(), after.body_mass.sum(), rtol=1e-12)
    a, b = mujoco.MjData(before), mujoco.MjData(after)
    rng = np.random.default_rng(3)
    for _ in range(3):
        a.qpos[:] = before.qpos0
        a.qpos[2] += 1.0
        a.qpos[7:] += rng.uniform(-0.3, 0.0, before.nq - 7)
        a.qvel[:] = rng.uniform(-1, 1, before.nv)
        torque = rng.uniform(-1, 1, before.nv)
        b.qpos[:], b.qvel[:] = a.qpos, a.qvel
        full = []
        for model, data in ((before, a), (after, b)):
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
            data.qfrc_applied[:] = torque
            mujoco.mj_forward(model, data)
            inertia = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, inertia)
            full.append(inertia)
        np.testing.assert_allclose(full[0], full[1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(a.qacc, b.qacc, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", ["body", "geom", "site"])
def test_feet_are_named_by_body_geom_or_site(tmp_path, kind):
    path = dog(tmp_path)
    text = path.read_text()
    for n, *_ in LEGS:
        text = text.replace(f'<geom name="ball_{n}"', f'<site name="tip_{n}" pos="0 0 -.23"/><geom name="ball_{n}"')
    path.write_text(text)
    names = {"body": "shank", "geom": "ball", "site": "tip"}
    feet = [f"{names[kind]}_{n}" for n, *_ in LEGS]
    expected = ("shank" if kind == "body" else "ball") + "_fl"
    assert RobotSettings(name=str(path), feet=feet).load().feet[0] == expected
    with pytest.raises(RobotError, match=r"no body, geom or site 'ball_f1'. Did you mean 'ball_f"):
        RobotSettings(name=str(path), feet=["ball_f1"]).load()


@pytest.mark.parametrize("name", ["data_dist", "body2", "ball_sensor"])
def test_feet_are_down_when_they_touch(name):
    robot = case(f"sensors/{name}.xml").load()
    assert "ball" not in robot.other_contact_bodies
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    data.qpos[robot.vertical] -= 0.001
    feet = robot.contact_sensors(robot.feet)
    mujoco.mj_forward(model, data)
    assert (data.sensordata[feet] > 0).all()
    data.qpos[robot.vertical] += 0.05
    mujoco.mj_forward(model, data)
    assert not (data.sensordata[feet] > 0).any()
    trains(robot)


def test_sensors_on_either_side_are_read_without_completion():
    robot = Robot.from_mjcf(CASES / "sensors/body2.xml")
    assert robot.contact_sensors(robot.feet).tolist() == [0, 1]
    with pytest.raises(RobotError, match="no ground-contact sensor for foot_right, foot_left"):
        Robot.from_mjcf(CASES / "sensors/data_dist.xml").check_walking()


# Poses.


def test_a_key_in_which_it_stands_is_taken_whatever_its_name(tmp_path):
    pose = "0 0 {z} 1 0 0 0" + " .5 -1" * 4
    height = 0.2 * np.cos(0.5) * 2 + 0.03
    flat = '<key name="lying" qpos="0 0 .2 .7071 .7071 0 0 0 0 0 0 0 0 0 0"/>'
    path = dog(tmp_path, rest=f'<keyframe>{flat}<key name="standing" qpos="{pose.format(z=height)}"/></keyframe>')
    robot = RobotSettings(name=str(path)).load()
    np.testing.assert_allclose(robot.standing_qpos[7:], [0.5, -1.0] * 4)
    assert "The robot stands in key 'standing'." in robot.notes
    for asked, message in (("standin", "Did you mean 'standing'"), ("lying", "does not stand in key 'lying'")):
        with pytest.raises(RobotError, match=message):
            RobotSettings(name=str(path), pose=asked).load()


def test_a_key_off_the_ground_is_put_on_it(tmp_path):
    pose = "0 0 .6 1 0 0 0" + " .5 -1" * 4
    path = dog(tmp_path, rest=f'<keyframe><key name="home" qpos="{pose}"/></keyframe>')
    robot = RobotSettings(name=str(path)).load()
    # Two links of 0.2 m at 0.5 rad to the vertical, and the ball's radius.
    assert robot.standing_qpos[2] == pytest.approx(0.4 * np.cos(0.5) + 0.03, abs=1e-4)
    assert any("lowered by 0.219 m" in note for note in robot.notes)


@pytest.mark.parametrize(
    "wrong",
    ['qpos="0 0 .5 1 0 0 0"', f'qpos="{" 1" * 20}"', f'qpos="nan{" 1" * 14}"', 'ctrl="1"', 'act="1 2 3"', 'mpos="1"'],
)
@pytest.mark.parametrize("name", ["stand", ""])
def test_a_key_that_cannot_be_used_is_passed_over_by_name(tmp_path, wrong, name):
    path = dog(
        tmp_path, rest=f"<keyframe><key/><key {f'name={chr(34)}{name}{chr(34)}' if name else ''} {wrong}/></keyframe>"
    )
    # Parts without names are named for the sensors that are added.
    path.write_text(path.read_text().replace('<body name="shank_fl"', "<body"))
    robot = RobotSettings(name=str(path)).load()
    assert len(robot.feet) == 4
    if name:
        assert any(note.startswith("Key 'stand' is ") for note in robot.notes)
        with pytest.raises(
            RobotError,
            match=r"stand in key 'stand': (its size does not fit|it has n)",
        ):
            RobotSettings(name=str(path), pose="stand").load()


@pytest.mark.parametrize("foot, lower", [("trunk", "shank_fl is 0.38 m"), ("stub", "shank_fl is 0.3")])
def test_feet_that_do_not_reach_the_ground_are_refused(tmp_path, foot, lower):
    inside = '<body name="stub" pos=".3 0 0"><joint name="nod" axis="0 1 0" range="-9 9"/><geom size=".1"/></body>'
    path = dog(tmp_path, inside=inside)
    with pytest.raises(RobotError, match=f"the feet {foot} do not reach the ground: in the standing pose {lower}"):
        RobotSettings(name=str(path), feet=[foot]).load()


def test_what_mujoco_says_takes_one_line(tmp_path):
    path = dog(tmp_path, actuator='<motor joint="{n}x"/>')
    with pytest.raises(RobotError, match=r"unknown transmission target 'hip_flx'") as caught:
        RobotSettings(name=str(path)).load()
    assert "\n" not in str(caught.value)


def test_a_key_in_which_feet_hang_in_the_air_is_passed_over(tmp_path):
    pose = "0 0 .4 1 0 0 0 1.2 -2.4 1.2 -2.4 .2 -.4 .2 -.4"
    path = dog(tmp_path, rest=f'<keyframe><key name="home" qpos="{pose}"/></keyframe>')
    robot = RobotSettings(name=str(path)).load()
    assert len(robot.feet) == 4
    assert any(note.startswith("Key 'home' is passed over") for note in robot.notes)


def test_a_found_pose_has_bent_legs_and_feet_below_the_hips(tmp_path):
    robot = RobotSettings(name=str(dog(tmp_path))).load()
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(model, data)
    for n, *_ in LEGS:
        foot, hip = data.xpos[model.body(f"ball_{n}").id], data.xanchor[model.joint(f"hip_{n}").id]
        assert abs(foot[0] - hip[0]) < 0.01
        # Of a leg of 0.4 m.
        assert 0.84 < (hip[2] - foot[2]) / 0.4 < 0.91
        assert foot[2] == pytest.approx(0.03, abs=1e-6)
    np.testing.assert_array_equal(robot.standing_qpos[7:9], robot.standing_qpos[9:11])
    assert not any("falling" in note for note in robot.notes)


def test_a_waist_stays_straight_in_a_found_pose(tmp_path):
    """Several legs hang on it: each would bend it its own way."""
    legs = "".join(LEG.format(n=n, x=x, y=y) for n, x, y in LEGS)
    belly = '<joint name="waist" axis="0 1 0" range="-1 1"/><geom size=".02" mass=".1" contype="0" conaffinity="0"/>'
    robot = RobotSettings(name=str(dog(tmp_path, inside=f'<body name="belly">{belly}{legs}</body>', legs=[]))).load()
    assert any("one with bent legs is found" in note for note in robot.notes)
    assert robot.standing_qpos[robot.joint("waist").qpos] == 0.0
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(robot.model, data)
    assert np.ptp([data.xpos[robot.model.body(f"ball_{n}").id][2] for n, *_ in LEGS]) < 1e-3


def test_a_pose_outside_of_a_range_is_put_into_it_and_named():
    robot = case("start/key_outside_range.xml").load()
    assert [note for note in robot.notes if "knee_right" in note and "0.1 rad instead of 0.6" in note]
    assert robot.start_qpos[robot.joint("knee_right").qpos] == pytest.approx(0.1)
    # It is not kicked.
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.start_qpos
    data.ctrl[:] = robot.start_qpos[[robot.joint(name).qpos for name in robot.actuated]]
    mujoco.mj_step(robot.model, data, 4)
    assert np.abs(data.qvel).max() < 1.0


@pytest.mark.parametrize("read", [Robot.from_mjcf, lambda path: RobotSettings(name=path).load()])
def test_start_noise_keeps_loops_closed(read):
    robot = read(str(CASES / "start/loop.xml"))
    task, rng = walking(robot), np.random.default_rng(0)
    data, ends = mujoco.MjData(robot.model), np.array([0.0, 0.0, -0.25])
    opened = 0.0
    for _ in range(5):
        data.qpos[:], data.qvel[:] = task.start(rng)
        mujoco.mj_forward(robot.model, data)
        for side in ("right", "left"):
            rod, foot = data.body(f"rod_{side}"), data.body(f"foot_{side}")
            # The anchor is at the foot's sole when nothing moved: compared in the frame of the foot.
            place = foot.xmat.reshape(3, 3).T @ (rod.xpos + rod.xmat.reshape(3, 3) @ ends - foot.xpos)
            opened = max(opened, float(np.abs(place - [0.05, 0.0, 0.0]).max()))
        assert np.abs(data.qpos[2:]).max() > 0.01
    assert opened < 1e-6


# Servos.


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


# Joints.


def test_joints_that_nothing_drives_move_without_nodes():
    robot = case("robots/10_passive_ball_rod.xml").load()
    assert [joint.name for joint in robot.joints] == ["hip_left", "knee_left", "hip_right", "knee_right"]
    assert robot.joint("knee_left").parent == "hip_left"
    graph = KinematicGraph.from_robot(robot)
    assert not any("rod" in node for node in graph.nodes)
    assert any("Nothing drives rod_left, rod_right" in note for note in robot.notes)
    # Without completion every joint is read.
    assert len(Robot.from_mjcf(robot.path).joints) == 6


def test_the_parent_of_a_driven_joint_is_the_next_driven_one(tmp_path):
    path = dog(tmp_path, '<position joint="{n}" kp="40" ctrlrange="-1 1"/>')
    text = path.read_text().replace(
        '<joint name="knee_fl"', '<joint name="spring" axis="1 0 0" armature=".01"/><joint name="knee_fl"'
    )
    path.write_text(text)
    robot = RobotSettings(name=str(path)).load()
    assert robot.joint("knee_fl").parent == "hip_fl"
    assert Robot.from_mjcf(path).joint("knee_fl").parent == "spring"


def test_a_tendon_s_actuator_is_left_out_by_name(tmp_path):
    tendon = '<tendon><fixed name="pull"><joint joint="hip_fl" coef="1"/></fixed></tendon>'
    path = dog(tmp_path, '<position name="{n}" joint="{n}" kp="40" ctrlrange="-1 1"/>', rest=tendon)
    path.write_text(path.read_text().replace("</actuator>", '<motor name="puller" tendon="pull"/></actuator>'))
    robot = RobotSettings(name=str(path)).load()
    assert len(robot.actuated) == robot.model.nu == 8
    assert any("puller is left out: it drives a tendon" in note for note in robot.notes)


def test_of_several_actuators_the_position_servo_stays(tmp_path):
    modes = (
        '<motor name="t_{n}" joint="{n}"/><position name="p_{n}" joint="{n}" kp="30" kv="1" ctrlrange="-1 1"/>'
        '<velocity name="v_{n}" joint="{n}" kv="1"/>'
    )
    robot = RobotSettings(name=str(dog(tmp_path, modes))).load()
    assert robot.action_names[0] == "p_hip_fl" and robot.model.nu == 8


ARM = """
<body name="arm" pos=".1 0 .05" euler="0 0 30">
  <joint name="shoulder" axis="0 0 1" pos=".01 .02 0" range="-90 90"/>
  <joint name="tilt" axis="0 1 0" range="-90 90"/>
  <joint name="roll" axis="1 0 0" pos="0 0 .03" range="-90 90"/>
  <geom type="capsule" fromto="0 0 0 .1 0 .05" size=".02" mass=".2"/>
  <body name="hand" pos=".1 0 .05">
    <joint name="wrist" axis="0 1 0" range="-90 90"/><geom name="hand" size=".02" mass=".1"/>
  </body>
</body>"""


def test_held_joints_are_fixed_in_the_standing_pose(tmp_path):
    pose = f"0 0 {0.4 * np.cos(0.5) + 0.03} 1 0 0 0" + " .5 -1" * 4 + " .4 -.3 .6 .2"
    rest = (
        f'<keyframe><key name="home" qpos="{pose}"/></keyframe><sensor><jointpos joint="tilt"/></sensor>'
        '<equality><joint joint1="tilt" joint2="wrist" active="false"/></equality>'
    )
    drive = '<position name="{n}" joint="{n}" kp="40" kv="1" ctrlrange="-1.5 1.5"/>'
    path = dog(tmp_path, drive, rest=rest, inside=ARM)
    arm = "".join(drive.format(n=n) for n in ("shoulder", "tilt", "roll", "wrist"))
    path.write_text(path.read_text().replace("</actuator>", f"{arm}</actuator>"))
    robot = RobotSettings(name=str(path), hold=["tilt", "wri*"]).load()
    assert robot.held == {"tilt": pytest.approx(-0.3), "wrist": pytest.approx(0.2)}
    assert [j.name for j in robot.joints][-2:] == ["shoulder", "roll"] and robot.model.nu == 10
    # Every body is where the whole robot has it, whatever the angles of the joints that are left.
    before = mujoco.MjModel.from_xml_path(str(path))
    a, b = mujoco.MjData(before), mujoco.MjData(robot.model)
    for turned in (0.0, 0.5):
        a.qpos[:] = before.key("home").qpos
        b.qpos[:] = robot.standing_qpos
        for data, model in ((a, before), (b, robot.model)):
            for name in ("shoulder", "roll"):
                data.qpos[model.joint(name).qposadr[0]] += turned
            data.qpos[:3] = 0.0, 0.0, 1.0
            mujoco.mj_forward(model, data)
        for name in ("hand", "arm", "shank_hr"):
            np.testing.assert_allclose(a.body(name).xpos, b.body(name).xpos, atol=1e-9)
            np.testing.assert_allclose(a.body(name).xmat, b.body(name).xmat, atol=1e-9)
        np.testing.assert_allclose(a.subtree_com[1], b.subtree_com[1], atol=1e-9)
    with pytest.raises(RobotError, match=r"robot.hold names 'wrst', which fits no joint. Did you mean 'wrist'"):
        RobotSettings(name=str(path), hold=["wrst"]).load()


# Several robots.


def test_one_of_several_robots_is_chosen(tmp_path):
    path = dog(tmp_path, '<position joint="{n}" kp="40" kv="1" ctrlrange="-1 1"/>')
    other = """<body name="crane" pos="3 0 1"><joint name="turn"/><geom size=".1"/>
        <body><joint name="lift" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body></body></worldbody>"""
    text = path.read_text().replace("</worldbody>", other)
    path.write_text(text.replace("</actuator>", '<motor name="winch" joint="lift"/></actuator>'))
    with pytest.raises(RobotError, match=r"got 2: trunk, crane; choose one with robot.root=trunk"):
        RobotSettings(name=str(path)).load()
    robot = RobotSettings(name=str(path), root="trunk").load()
    assert robot.root == "trunk" and len(robot.joints) == 8
    assert any("winch is left out" in note for note in robot.notes)
    trains(robot)
    with pytest.raises(RobotError, match=r"no root body 'trunc' .*Did you mean 'trunk'"):
        RobotSettings(name=str(path), root="trunc").load()
