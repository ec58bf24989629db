"""Robots as URDF and SDF, read back by MuJoCo's own URDF compiler, by DART, by yourdfpy and by hand."""

from importlib import resources
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from read_back import by_mujoco, configured, inertia
from running import command

from gctd3.config.build import build
from gctd3.errors import RobotError
from gctd3.robots.description import angles, describe_robot
from gctd3.robots.links import LIGHT
from gctd3.robots.mjcf import bodies_below, body_name, joint_kind, joint_name
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings

# Two joints on a body with anchors of their own, a reference angle, a turned inertia, a turned body and a static part.
ODD = """
<mujoco model="odd">
  <compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="torso" pos="0.1 0.2 1" quat="0.7 0.1 0.5 0.2"> BASE
      <inertial pos="0.01 0.02 0.03" mass="3" fullinertia="0.03 0.04 0.05 0.001 0.002 -0.003"/>
      <geom name="trunk" type="box" size="0.1 0.05 0.07" pos="0.02 0 0" euler="0.1 1.5707963267948966 0.3"/>
      <body name="thigh" pos="0 -0.1 0.05" euler="0.3 -1.5707963267948966 0.2">
        <joint name="abduct" axis="1 0.2 0" pos="0.01 0 0.02" range="-0.5 0.7" ref="0.2" damping="0.3"/>
        <joint name="swing" axis="0 1 0.1" pos="-0.02 0.01 0" armature="0.02" frictionloss="0.4"/>
        <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.012 0.004" quat="0.9 0.1 0.3 0"/>
        <geom name="thigh" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03"/>
        <body name="shin" pos="0 0 -0.3">
          <inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.004 0.004 0.001"/>
          <body name="foot" pos="0 0.01 -0.2" euler="0 0.2 0">
            <joint name="slide" type="slide" axis="0 0 1" range="-0.02 0.03" ref="0.01" pos="0.01 0 0"/>
            <inertial pos="0 0 0" mass="0.2" diaginertia="0.0001 0.0001 0.0001"/>
            <geom name="sole" type="cylinder" size="0.04 0.01"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><position name="swing" joint="swing" kp="20" ctrlrange="-1 1" forcerange="-12 12"/></actuator>
</mujoco>
"""
BASES = {"free": "<freejoint name='base'/>", "boom": '<joint name="x" type="slide" axis="1 0 0" ref="0.3"/>'}


def odd(base):
    return Robot.from_mjcf(mujoco.MjSpec.from_string(ODD.replace("BASE", BASES[base])))


def compare(robot, folder):
    """Compare a robot with its URDF, as MuJoCo's own compiler reads it: masses, inertias, axes, limits, kinematics."""
    description = describe_robot(robot, "urdf", "robot")
    folder.mkdir(exist_ok=True)
    description.write(folder / "robot.urdf")
    free, old = robot.base.free is not None, robot.model
    new = by_mujoco(description.text, folder, free)
    bodies = bodies_below(old, robot.base.root)
    pairs = [(body, new.body(body_name(old, body)).id) for body in bodies]
    # The rest is light.
    known = {twin for _, twin in pairs}
    assert all(new.body_mass[body] == LIGHT for body in range(1, new.nbody) if body not in known)
    joints = [j for b in bodies for j in range(old.body_jntadr[b], old.body_jntadr[b] + old.body_jntnum[b])]
    plain = [j for j in joints if joint_kind(old, j) != "free"]
    for joint in plain:
        twin = new.joint(joint_name(old, joint))
        assert joint_kind(new, twin.id) == joint_kind(old, joint)
        if old.jnt_limited[joint]:
            np.testing.assert_allclose(twin.range, old.jnt_range[joint], rtol=0, atol=1e-9)
        assert abs(twin.damping[0] - old.dof_damping[old.jnt_dofadr[joint]]) < 1e-9
        assert abs(twin.frictionloss[0] - old.dof_frictionloss[old.jnt_dofadr[joint]]) < 1e-9
    for i, name in enumerate(robot.actuated):
        effort = new.jnt_actfrcrange[new.joint(name).id, 1]
        if old.actuator_forcelimited[robot.actuators[i]]:
            assert abs(effort - old.actuator_forcerange[robot.actuators[i], 1]) < 1e-9
    for body, twin in pairs:
        assert abs(new.body_mass[twin] - old.body_mass[body]) <= 1e-9
        np.testing.assert_allclose(inertia(new, twin), inertia(old, body), rtol=0, atol=1e-9)
    rng = np.random.default_rng(0)
    for _ in range(5):
        qpos = {joint_name(old, j): rng.uniform(-2, 2) for j in plain}
        base = {}
        if free:
            pose = np.concatenate([rng.uniform(-1, 1, 3), rng.standard_normal(4)])
            pose[3:] /= np.linalg.norm(pose[3:])
            own = next(j for j in joints if joint_kind(old, j) == "free")
            base = {"free_base": pose}
            qpos[joint_name(old, own)] = pose
        before = mujoco.MjData(old)
        for name, values in qpos.items():
            start = next(int(old.jnt_qposadr[j]) for j in joints if joint_name(old, j) == name)
            before.qpos[start : start + np.size(values)] = values
        mujoco.mj_forward(old, before)
        after = configured(new, {joint_name(old, j): qpos[joint_name(old, j)] for j in plain} | base)
        for body, twin in pairs:
            # Of a link the origin is the joint's, so places of the centre of mass and orientations are compared.
            np.testing.assert_allclose(after.xipos[twin], before.xipos[body], rtol=0, atol=1e-9)
            np.testing.assert_allclose(after.xmat[twin], before.xmat[body], rtol=0, atol=1e-9)
        for joint in plain:
            twin = new.joint(joint_name(old, joint)).id
            np.testing.assert_allclose(after.xaxis[twin], before.xaxis[joint], rtol=0, atol=1e-9)
            if joint_kind(old, joint) == "hinge":
                np.testing.assert_allclose(after.xanchor[twin], before.xanchor[joint], rtol=0, atol=1e-9)
    return description


@pytest.mark.parametrize("base", BASES)
def test_an_odd_robot_comes_back_equal(base, tmp_path):
    robot = odd(base)
    description = compare(robot, tmp_path)
    text = "\n".join(description.unsaid)
    assert "0.02 of swing" in text and "thigh_abduct" in text and "cylinder and two spheres" in text


@pytest.mark.parametrize("name", ["biped", "biped_planar", "quadruped", "hexapod"])
def test_shipped_robots_come_back_equal(name, tmp_path):
    compare(RobotSettings(name).load(), tmp_path)


@pytest.mark.nightly
def test_robots_that_people_own_come_back_equal(tmp_path):
    """Every robot of conf/robot that can be had here; mesh after mesh."""
    read, folder = [], Path(str(resources.files("gctd3.conf"))) / "robot"
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        for file in sorted(folder.glob("*.yaml")):
            chosen = compose("graph", overrides=[f"robot={file.stem}"]).robot
            # What others begin from names no robot.
            if OmegaConf.is_missing(chosen, "name"):
                continue
            settings = build(chosen)
            try:
                robot = settings.load()
            except RobotError as error:
                # Without its package, or without a network.
                assert "is installed: pip install" in str(error) or "cannot be downloaded" in str(error)
                continue
            compare(robot, tmp_path / file.stem)
            read.append(file.stem)
    shipped = {"biped", "biped_planar", "quadruped", "hexapod"}
    assert shipped <= set(read)
    if set(read) == shipped:
        pytest.skip("no robot that people own is installed: pip install 'gctd3[robots]'")


def test_angles_give_rotations_back_also_at_right_angles():
    rng = np.random.default_rng(0)
    for pitch in (*rng.uniform(-1.5, 1.5, 20), np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, np.pi / 2 - 1e-5):
        roll, yaw = rng.uniform(-3, 3, 2)
        turn = rotation(roll, pitch, yaw)
        np.testing.assert_allclose(rotation(*angles(turn)), turn, rtol=0, atol=1e-12)


def rotation(roll, pitch, yaw):
    """Compute ``Rz(yaw) Ry(pitch) Rx(roll)``, factor by factor."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


# SDF.


def numbers(element, path):
    return np.array([float(word) for word in element.findtext(path).split()])


@pytest.mark.parametrize("base", BASES)
def test_sdf_has_every_link_where_mujoco_has_it_at_angles_of_zero(base):
    robot = odd(base)
    model = ElementTree.fromstring(describe_robot(robot, "sdf").text).find("model")
    old, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = 0.0
    if base == "free":
        data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(old, data)
    mujoco.mj_comPos(old, data)
    for body in bodies_below(old, robot.base.root):
        link = model.find(f"link[@name='{body_name(old, body)}']")
        pose = numbers(link, "pose")
        turn, inner = rotation(*pose[3:]), numbers(link, "inertial/pose")
        np.testing.assert_allclose(turn, data.xmat[body].reshape(3, 3), rtol=0, atol=1e-9)
        np.testing.assert_allclose(pose[:3] + turn @ inner[:3], data.xipos[body], rtol=0, atol=1e-9)
        assert abs(float(link.findtext("inertial/mass")) - old.body_mass[body]) < 1e-9
        keys = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
        for key, place in keys.items():
            assert abs(float(link.findtext(f"inertial/inertia/{key}")) - inertia(old, body)[place]) < 1e-9
    for name in ("abduct", "swing", "slide"):
        joint, own = model.find(f"joint[@name='{name}']"), old.joint(name)
        np.testing.assert_allclose(numbers(joint, "axis/xyz"), old.jnt_axis[own.id], rtol=0, atol=1e-9)
        limit = [float(joint.findtext(f"axis/limit/{end}")) for end in ("lower", "upper")]
        expected = own.range if old.jnt_limited[own.id] else [-1e16, 1e16]
        np.testing.assert_allclose(limit, expected, rtol=0, atol=1e-9)
    assert float(model.findtext("joint[@name='swing']/axis/limit/effort")) == 12.0
    assert float(model.findtext("joint[@name='abduct']/axis/limit/effort")) == -1.0  # SDF's word for no limit


@pytest.mark.parametrize("form", ["urdf", "sdf"])
@pytest.mark.parametrize("name", ["biped", "biped_planar"])
def test_dart_reads_the_same_masses_axes_and_places(name, form, tmp_path):
    dartpy = pytest.importorskip("dartpy", reason="needs dartpy: pip install 'gctd3[engines]'")
    robot = RobotSettings(name).load()
    file = tmp_path / f"robot.{form}"
    describe_robot(robot, form, "robot").write(file)
    reader = dartpy.utils.DartLoader().parseSkeleton if form == "urdf" else dartpy.utils.SdfParser.readSkeleton
    skeleton, old, data = reader(str(file)), robot.model, mujoco.MjData(robot.model)
    rng = np.random.default_rng(1)
    for joint in range(old.njnt):
        angle = rng.uniform(-1, 1)
        data.qpos[old.jnt_qposadr[joint]] = angle
        skeleton.getJoint(joint_name(old, joint)).setPosition(0, angle)
    mujoco.mj_kinematics(old, data)
    mujoco.mj_comPos(old, data)
    for body in bodies_below(old, robot.base.root):
        node = skeleton.getBodyNode(body_name(old, body))
        assert abs(node.getMass() - old.body_mass[body]) < 1e-9
        np.testing.assert_allclose(np.ravel(node.getCOM()), data.xipos[body], rtol=0, atol=1e-9)
    for joint in robot.joints:
        found = skeleton.getJoint(joint.name)
        np.testing.assert_allclose(
            [found.getPositionLowerLimit(0), found.getPositionUpperLimit(0)], joint.range, rtol=0, atol=1e-9
        )


# The command, and what cannot be written.


def test_the_command_writes_the_packaged_robot_and_says_what_is_lost(tmp_path, capfd):
    file = tmp_path / "robot.urdf"
    assert command("export", f"out={file}") == 0
    printed = capfd.readouterr().out
    assert "Armature (rotor inertia, kg m^2) is left out: 0.01 of hip_right" in printed
    assert ElementTree.parse(file).getroot().get("name") == "robot"
    # The same stands in the file.
    assert "Armature (rotor inertia, kg m^2) is left out" in file.read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("robot=quadruped", "out=policy.onnx"), "robot=NAME writes a robot without a run"),
        (("robot=quadruped", "run=somewhere", "out=robot.sdf"), "got out=robot.sdf and run=somewhere"),
        (("robot=quadruped", "out=nowhere/robot.sdf"), "there is no folder"),
    ],
)
def test_wrong_settings_are_refused(arguments, message, capfd):
    assert command("export", *arguments) == 2
    assert message in capfd.readouterr().err


def test_a_ball_joint_is_refused_by_name():
    text = ODD.replace("BASE", BASES["free"]).replace('<joint name="slide" type="slide" axis="0 0 1"', "<joint")
    text = text.replace('range="-0.02 0.03" ref="0.01" pos="0.01 0 0"', 'name="ankle" type="ball"')
    with pytest.raises(RobotError, match="joint 'ankle' is a ball, which URDF has not"):
        describe_robot(Robot.from_mjcf(mujoco.MjSpec.from_string(text)), "urdf")
