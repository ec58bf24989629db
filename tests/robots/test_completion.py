"""Files of robots as people own them train: what they lack is added and said, and what they have stays."""

import mujoco
import numpy as np
import pytest
from incomplete_files import CASES, LEGS, SHIPPED, bits, case, dog, trains

from gctd3.errors import RobotError
from gctd3.robots.completion import complete
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings

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
