"""What is made of URDF files: their bodies, limits, meshes and faults, against MuJoCo's own reader and by hand."""

import struct

import mujoco
import numpy as np
import pytest
from urdf_files import INERTIAL, LEG, LEGS, joint, link, robot

from gctd3 import RobotSettings, ServoSettings
from gctd3.errors import RobotError
from gctd3.robots.urdf import is_urdf, read_urdf
from gctd3.robots.urdf_meshes import collision_meshes

CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)]) / 20.0
# The twelve triangles of a box, by its corners.
FACES = ["013", "032", "576", "465", "451", "410", "237", "276", "046", "062", "573", "531"]
FACES = [tuple(map(int, face)) for face in FACES]


def read(folder, text):
    file = folder / "robot.urdf"
    file.write_text(text)
    return read_urdf(file)


def stl(file):
    triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *CORNERS[list(face)].ravel(), 0) for face in FACES)
    file.write_bytes(b" " * 80 + struct.pack("<I", len(FACES)) + triangles)


def text_stl(file):
    facets = "".join(
        "facet normal 0 0 0 outer loop "
        + " ".join(f"vertex {x} {y} {z}" for x, y, z in CORNERS[list(face)])
        + " endloop endfacet\n"
        for face in FACES
    )
    file.write_text(f"solid box\n{facets}endsolid\n")


def obj(file):
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    file.write_text("\n".join(lines))


def dae(file):
    # In centimetres and with y up; a node brings them back.
    points = " ".join(str(100.0 * value) for x, y, z in CORNERS for value in (x, z, -y))
    file.write_text(
        f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
        <asset><unit meter="0.01"/><up_axis>Y_UP</up_axis></asset>
        <library_geometries><geometry id="g"><mesh><source id="p"><float_array>{points}</float_array></source>
        <vertices id="v"><input semantic="POSITION" source="#p"/></vertices></mesh></geometry></library_geometries>
        <library_visual_scenes><visual_scene><node><translate>5 0 0</translate><rotate>0 1 0 90</rotate>
        <node><rotate>0 1 0 -90</rotate><matrix>1 0 0 -5 0 1 0 0 0 0 1 0 0 0 0 1</matrix>
        <instance_geometry url="#g"/></node></node></visual_scene></library_visual_scenes></COLLADA>"""
    )


WRITERS = {"stl": stl, "obj": obj, "dae": dae, "text.stl": text_stl}


def corners(model, geom):
    """The corners of a mesh or box in the world."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        points = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * model.geom_size[geom]
    else:
        mesh = model.geom_dataid[geom]
        start = model.mesh_vertadr[mesh]
        points = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
    return np.unique((points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]).round(5), axis=0)


def test_two_legs(tmp_path):
    urdf = read(tmp_path, LEGS)
    model = urdf.spec.compile()
    assert [model.joint(i).name for i in range(model.njnt)] == ["root", "hip_l", "hip_r"]
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    assert [model.body(i).name for i in range(1, model.nbody)] == ["torso", "leg_l", "leg_r"]
    assert model.body_mass.sum() == pytest.approx(3.0)
    assert model.jnt_range[1].tolist() == [-1.0, 1.0]
    # The torque is limited by the servo; a limit of the joint would slow it.
    assert not model.jnt_actfrclimited.any()
    assert urdf.limits == {f"hip_{side}": {"effort": 7.0, "velocity_limit": 9.0} for side in "lr"}
    assert any("free joint" in note for note in urdf.notes)


def test_what_is_asked_of_a_servo_comes_before_the_files_limits(tmp_path):
    patterns = {"hip_r": ServoSettings(effort=5.0), "hip_*": ServoSettings(stiffness=20.0)}
    servos = RobotSettings(servos=patterns).within(read(tmp_path, LEGS).limits).servos
    assert servos["hip_r"] == ServoSettings(effort=5.0, velocity_limit=9.0)
    assert servos["hip_l"] == ServoSettings(stiffness=20.0, effort=7.0, velocity_limit=9.0)
    # In order: patterns come after the joints that they would cover.
    assert list(servos).index("hip_l") < list(servos).index("hip_*")


@pytest.mark.parametrize("kind", WRITERS)
def test_a_mesh_is_where_mujoco_puts_a_box_of_its_shape(tmp_path, kind):
    place = '<origin xyz="0.1 0.2 0.3" rpy="0.3 -0.4 0.5"/>'
    WRITERS[kind](tmp_path / f"box.{kind}")
    shapes = f'<mesh filename="box.{kind}" scale="2 1 1"/>', '<box size="0.2 0.2 0.3"/>'
    rest = link("leg") + joint("hip", "torso", "leg")
    models = [read(tmp_path, robot(link("torso", shape, origin=place), rest)).spec.compile() for shape in shapes]
    mesh, box = (corners(model, 0) for model in models)
    np.testing.assert_allclose(mesh, box, atol=1e-4)


@pytest.mark.parametrize("how", ["parent", "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "package.xml", "moved", "file"])
def test_meshes_are_found(tmp_path, monkeypatch, how):
    (tmp_path / "ws/two_description/urdf").mkdir(parents=True)
    where = {
        "parent": "ws/two_description/meshes",
        "ROS_PACKAGE_PATH": "ros/two_description/meshes",
        "AMENT_PREFIX_PATH": "ament/share/two_description/meshes",
        "package.xml": "ws/two_description/meshes",
        "moved": "ws/two_description/urdf/assets",
        "file": "far/meshes",
    }[how]
    (tmp_path / where).mkdir(parents=True)
    stl(tmp_path / where / "box.stl")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'nowhere'}:{tmp_path / 'ros'}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ament"))
    package = "renamed" if how == "package.xml" else "two_description"
    if how == "package.xml":
        (tmp_path / "ws/two_description/package.xml").touch()
    name = f"file://{tmp_path}/far/meshes/box.stl" if how == "file" else f"package://{package}/meshes/box.stl"
    text = robot(link("torso", f'<mesh filename="{name}"/>'), link("leg"), joint("hip", "torso", "leg"))
    urdf = read(tmp_path / "ws/two_description/urdf", text)
    assert urdf.spec.compile().nmesh == 1
    assert any("nearby" in note for note in urdf.notes) == (how == "moved")
    assert collision_meshes(tmp_path / "ws/two_description/urdf/robot.urdf") == [tmp_path / where / "box.stl"]


def test_visual_meshes_are_not_needed(tmp_path):
    seen = '<visual><geometry><mesh filename="package://x/none.dae"/></geometry></visual></link>'
    assert read(tmp_path, LEGS.replace("</link>", seen)).spec.compile().ngeom == 3


@pytest.mark.parametrize(
    "shape", ['<sphere radius="0.00"/>', '<cylinder radius="0.1" length="0"/>', '<box size="0.1 0 0.1"/>']
)
def test_shapes_of_no_size_touch_nothing(tmp_path, shape):
    model = read(
        tmp_path, LEGS.replace("</collision>", f"</collision><collision><geometry>{shape}</geometry></collision>", 1)
    )
    same = read(tmp_path, LEGS)
    assert model.spec.compile().ngeom == same.spec.compile().ngeom == 3


def test_masses_are_those_that_are_stated(tmp_path):
    # MuJoCo would make of a link that states none a solid of water.
    plain = link("cover", '<box size="1 1 1"/>', inertial="")
    urdf = read(
        tmp_path, LEGS.replace("</robot>", plain + joint("fix", "torso", "cover", kind="fixed", more="") + "</robot>")
    )
    assert urdf.spec.compile().body_mass.sum() == pytest.approx(3.0)


def test_what_has_no_mass_is_fixed_or_given_some(tmp_path):
    finger = link("finger", inertial="") + joint("grip", "leg_l", "finger")
    between = link("cross", inertial="") + joint("yaw", "torso", "cross") + link("head") + joint("nod", "cross", "head")
    urdf = read(tmp_path, LEGS.replace("</robot>", finger + between + "</robot>"))
    model = urdf.spec.compile()
    assert [model.joint(i).name for i in range(model.njnt)] == ["root", "hip_l", "hip_r", "yaw", "nod"]
    assert model.body("cross").mass[0] == pytest.approx(0.001) and "grip" not in urdf.limits
    assert any("grip move nothing" in note for note in urdf.notes) and any("cross move" in n for n in urdf.notes)


def test_impossible_inertias_are_mended_and_said(tmp_path):
    flat = 'ixx="0.001" iyy="0.001" izz="0.001" ixy="0.001" ixz="0.001" iyz="0.001"'
    text = LEGS.replace(INERTIAL, f'<inertial><mass value="1"/><inertia {flat}/></inertial>', 1)
    urdf = read(tmp_path, text)
    assert any("inertia of torso" in note for note in urdf.notes)
    assert (urdf.spec.compile().body_inertia[1] > 0).all()


def test_mimics_follow_and_are_said(tmp_path):
    follower = '<limit effort="1" velocity="1" lower="-1" upper="1"/><mimic joint="hip_l" multiplier="2"/>'
    text = LEGS.replace("</robot>", link("toe") + joint("toe_l", "leg_l", "toe", more=follower) + "</robot>")
    urdf = read(tmp_path, text)
    model = urdf.spec.compile()
    assert model.neq == 1 and model.eq_data[0, :2].tolist() == [0.0, 2.0]
    assert "toe_l" not in urdf.limits and any("toe_l follow" in note for note in urdf.notes)


def test_a_floating_joint_is_the_base(tmp_path):
    for carrier in ("world", "map"):
        top = link(carrier, inertial="") + joint("float", carrier, "torso", kind="floating", more="")
        model = read(tmp_path, LEGS.replace("</robot>", f"{top}</robot>")).spec.compile()
        assert (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).sum() == 1
        assert model.body_mass.sum() == pytest.approx(3.0)


def test_overlapping_links_do_not_collide(tmp_path):
    # Thigh and torso are neighbours of the hip, not of each other.
    wide = link("thigh", '<box size="0.3 0.3 0.3"/>') + joint("knee", "leg_l", "thigh")
    urdf = read(tmp_path, LEGS.replace("</robot>", f"{wide}</robot>"))
    model = urdf.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0 and any("torso and thigh" in note for note in urdf.notes)


def test_a_free_robot_is_loaded(tmp_path):
    (tmp_path / "robot.urdf").write_text(LEGS)
    loaded = RobotSettings(str(tmp_path / "robot.urdf")).load(["leg_l", "leg_r"])
    assert loaded.path == tmp_path / "robot.urdf" and loaded.base.kind == "free" and loaded.notes
    assert loaded.origin.splitlines()[0].startswith(f"Robot: {tmp_path}/robot.urdf (a file of your own")


def test_a_urdf_is_known_by_its_root(tmp_path):
    file = tmp_path / "robot.xml"
    for text, known in ((LEGS, True), ("<mujoco/>", False), ("<!-- <robot> --><mujoco/>", False), ("", False)):
        file.write_text(text)
        assert is_urdf(file) == known


WRONG = {
    "broken": (LEGS.replace("</robot>", ""), "is not a URDF"),
    "another file": ("<html><body/></html>", "has no <robot> with a <link>"),
    "a template": (
        LEGS.replace("<link", '<xacro:if xmlns:xacro="http://wiki.ros.org/xacro"/><link', 1),
        "is a template",
    ),
    "missing mesh": (
        LEGS.replace(LEG, '<mesh filename="package://two/leg.stl"/>'),
        "2 of its colliding meshes are missing",
    ),
    "a mesh of another format": (LEGS.replace(LEG, '<mesh filename="leg.ply"/>'), "leg.ply; meshes are .stl"),
    "a damaged mesh": (LEGS.replace(LEG, '<mesh filename="leg.dae"/>'), "leg.dae cannot be read as a mesh"),
    "an empty mesh": (LEGS.replace(LEG, '<mesh filename="empty.dae"/>'), "has no mesh of four corners"),
    "no mass": (LEGS.replace(INERTIAL, ""), "no link has a mass"),
    "two roots": (LEGS.replace("</robot>", '<link name="stray"/></robot>'), "torso, stray"),
    "no numbers": (
        LEGS.replace('xyz="0 0 -0.2"', 'xyz="0 0"').replace(LEG, '<mesh filename="box.stl"/>'),
        "three numbers",
    ),
    "no parent": (
        LEGS.replace('<parent link="torso"/>', '<parent link="trunk"/>'),
        "the parent of joint 'hip_l' must be a link",
    ),
    "a word for an inertia": (LEGS.replace('ixx="0.01"', 'ixx="much"'), "inertia of link 'torso'"),
    "a word for an effort": (LEGS.replace('effort="7"', 'effort="much"'), "effort"),
    "a word for a mass": (LEGS.replace('mass value="1"', 'mass value="much"'), "mass"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_answered(tmp_path, case):
    text, said = WRONG[case]
    (tmp_path / "leg.ply").touch()
    (tmp_path / "leg.dae").write_text("<COLLADA>")
    (tmp_path / "empty.dae").write_text("<COLLADA/>")
    stl(tmp_path / "box.stl")
    with pytest.raises(RobotError) as error:
        read(tmp_path, text)
    assert said in str(error.value) and "\n" not in str(error.value) and str(tmp_path) in str(error.value)
