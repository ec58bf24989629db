"""A run's own copy of its robot moves as the robot does, to the last bit, without the robot's source."""

import json
import shutil

import mujoco
import numpy as np
import pytest
from robots import FREE_LEGS, TWO_LEGS, write

from gctd3.errors import RunError
from gctd3.files import checksum, read_manifest, write_manifest
from gctd3.robots.keep import keep_robot
from gctd3.robots.own_copy import OwnCopy
from gctd3.robots.settings import GivenRobot, RobotSettings

TETRAHEDRON = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
# Two legs with a body of meshes, of which one only shows the torso; numbers of more digits than MuJoCo writes.
MESHES = (
    FREE_LEGS.replace('<compiler angle="radian"/>', '<compiler angle="radian" meshdir="forms"/>')
    .replace(
        "<worldbody>",
        '<asset><mesh name="solid" file="so lid.obj" scale="0.123456789 0.1 0.1"/>'
        '<mesh name="shown" file="shown.obj"/>'
        '<texture name="skin" type="2d" file="skin.png"/> <material name="skin" texture="skin"/></asset><worldbody>',
        1,
    )
    .replace(
        '<geom name="torso" size="0.1"/>',
        '<frame euler="0.1 0.2 0.3"><geom type="mesh" mesh="solid" pos="0.012345678 0 0"/></frame>'
        '<geom type="mesh" mesh="shown" contype="0" conaffinity="0" mass="1.23456789" material="skin"/>',
    )
)


def moved(robot, steps=200):
    """Return what a robot does under random desired angles, shape ``[steps, nq + nv + nsensordata]``."""
    model, data, rng = robot.model, mujoco.MjData(robot.model), np.random.default_rng(3)
    data.qpos[:] = robot.start_qpos
    rows = []
    for step in range(steps):
        if step % 10 == 0:
            data.ctrl[:] = robot.desired_angles(rng.uniform(-1, 1, model.nu))
        mujoco.mj_step(model, data)
        rows.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
    return np.array(rows)


def kept(settings, run):
    """Load a robot, keep it, and return both it and its copy."""
    robot = settings.load()
    keep_robot(robot, run)
    return robot, OwnCopy.read(run)


def meshes(folder):
    (folder / "forms").mkdir(parents=True)
    (folder / "forms" / "so lid.obj").write_text(TETRAHEDRON.format(1))
    (folder / "forms" / "shown.obj").write_text(TETRAHEDRON.format(0.2))
    from PIL import Image

    Image.new("RGB", (4, 4)).save(folder / "skin.png")
    return write(folder, MESHES)


def assert_same(robot, copy):
    own = copy.robot
    assert np.array_equal(moved(own), moved(robot))
    assert (own.joints, own.feet, own.root, own.forward_axis) == (
        robot.joints,
        robot.feet,
        robot.root,
        robot.forward_axis,
    )
    assert np.array_equal(own.action_map, robot.action_map) and own.path.stem == robot.path.stem
    assert np.array_equal(own.standing_qpos, robot.standing_qpos) and own.mirror == robot.mirror
    assert (own.notes, own.held) == (robot.notes, robot.held)


@pytest.mark.parametrize("name", ["biped", "quadruped", "hexapod"])
def test_shipped_robots_move_alike(tmp_path, name):
    robot, copy = kept(RobotSettings(name), tmp_path)
    assert_same(robot, copy)
    assert sum(file.stat().st_size for file in copy.folder.iterdir()) < 60_000
    # Where the robot ships is known by its name, wherever the library is installed.
    assert str(robot.path.parent) not in (copy.folder / "manifest.json").read_text()


def test_a_completed_robot_moves_alike_without_its_files(tmp_path):
    """Frames, meshes, pictures, and all that was added to the file; the copy is read when they are gone."""
    file = meshes(tmp_path / "source")
    robot, copy = kept(RobotSettings(str(file), hold=()), tmp_path / "run")
    assert robot.notes and copy.content["left_out"]
    before, seal = moved(robot), checksum(tmp_path / "source" / "forms" / "so lid.obj")
    shutil.rmtree(tmp_path / "source")
    moved_on = shutil.move(tmp_path / "run", tmp_path / "elsewhere")
    copy = OwnCopy.read(type(tmp_path)(moved_on))
    assert np.array_equal(moved(copy.robot), before)
    # Of the meshes the one that collides is there, of the other the hash.
    assert sorted(file.name for file in copy.folder.iterdir()) == sorted(
        [
            f"{seal[:12]}_so lid.obj",
            "manifest.json",
            "numbers.npz",
            "robot.xml",
        ]
    )
    left = {row["file"].rpartition("/")[2]: row["sha256"] for row in copy.content["left_out"]}
    assert sorted(left) == ["shown.obj", "skin.png"] and all(len(seal) == 64 for seal in left.values())
    # The mass of the mesh that is shown counts.
    assert copy.robot.model.body_mass.sum() == robot.model.body_mass.sum()
    assert copy.robot.model.ngeom == robot.model.ngeom - 1


def test_what_only_shows_the_robot_comes_from_an_unchanged_source(tmp_path):
    file = meshes(tmp_path / "source")
    settings = RobotSettings(str(file))
    robot, copy = kept(settings, tmp_path / "run")
    assert copy.drawn(copy.robot, settings).model.ngeom == robot.model.ngeom
    (tmp_path / "source" / "forms" / "shown.obj").write_text(TETRAHEDRON.format(0.3))
    assert copy.drawn(copy.robot, settings) is copy.robot
    # Then the solid geoms are drawn.
    model = copy.robot.model
    assert (model.geom_group[model.geom_contype > 0] < 3).all()


def test_a_urdfs_meshes_are_written_whole(tmp_path):
    """They are read by the library, not by MuJoCo, and come into the MJCF as numbers."""
    (tmp_path / "form.obj").write_text(TETRAHEDRON.format(0.123456789))
    link = (
        '<link name="{0}"><inertial><mass value="1.5"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" '
        'iyz="0"/></inertial><collision><origin xyz="0 0 {2}"/><geometry>{1}</geometry></collision></link>'
    )
    leg = '<cylinder radius="0.02" length="0.3"/>'
    joint = (
        '<joint name="hip_{0}" type="revolute"><parent link="torso"/><child link="leg_{0}"/><origin xyz="0 {1} 0"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="30" velocity="10"/></joint>'
    )
    text = link.format("torso", '<mesh filename="form.obj"/>', 0)
    for side, y in (("left", 0.1), ("right", -0.1)):
        text += link.format(f"leg_{side}", leg, -0.15) + joint.format(side, y)
    file = tmp_path / "two.urdf"
    file.write_text(f'<robot name="two">{text}</robot>')
    robot, copy = kept(RobotSettings(str(file)), tmp_path / "run")
    assert robot.model.nmesh == 1
    file.unlink()
    assert np.array_equal(moved(copy.robot), moved(robot))


def test_two_runs_have_meshes_of_one_name(tmp_path):
    """One process reads both: each has its own."""
    robots = []
    for name, size in (("one", 1), ("two", 1.5)):
        file = meshes(tmp_path / name)
        (tmp_path / name / "forms" / "so lid.obj").write_text(TETRAHEDRON.format(size))
        robots.append(kept(RobotSettings(str(file)), tmp_path / f"run_{name}"))
    for robot, copy in robots:
        assert np.array_equal(moved(copy.robot), moved(robot))
    masses = [copy.robot.model.body_mass.sum() for _, copy in robots]
    assert masses[1] > masses[0]


# Changes of the source.

SAID = {
    'ctrlrange="-1 1"/> <position name="hip_l"': (
        'ctrlrange="-0.5 1"/> <position name="hip_l"',
        "actuator ranges, meaning of actions",
    ),
    'size="0.1"': ('size="0.11"', "masses, collision geometry"),
    'pos="0 0.1 0"': ('pos="0 0.15 0"', "bodies"),
}


@pytest.mark.parametrize("what", SAID)
def test_a_changed_source_is_named(tmp_path, what, monkeypatch):
    file, settings = write(tmp_path, TWO_LEGS), RobotSettings("robot.xml")
    monkeypatch.chdir(tmp_path)
    robot, copy = kept(settings, tmp_path / "run")
    assert copy.changes(settings) is None
    # Told otherwise it is the same robot.
    file.write_text(f"{TWO_LEGS}<!-- mine -->")
    assert copy.changes(settings) is None
    instead, parts = SAID[what]
    assert what in TWO_LEGS
    file.write_text(TWO_LEGS.replace(what, instead, 1))
    line = copy.changes(settings)
    assert line.count("\n") == 0
    assert line.startswith(f"{file} differs from the robot of the run in {parts} (hash {copy.hash[:12]} in the run, ")
    assert np.array_equal(moved(copy.robot), moved(robot))
    # What is no robot any more is said, too.
    file.write_text("<mujoco>")
    assert "cannot be used any more, the run's own copy is" in copy.changes(settings)
    file.unlink()
    assert copy.changes(settings) is None


def test_a_namesake_elsewhere_is_not_looked_at(tmp_path, monkeypatch):
    home, elsewhere = tmp_path / "home", tmp_path / "elsewhere"
    home.mkdir()
    elsewhere.mkdir()
    write(home, TWO_LEGS)
    settings = RobotSettings("robot.xml")
    monkeypatch.chdir(home)
    robot, copy = kept(settings, tmp_path / "run")
    write(elsewhere, TWO_LEGS.replace('size="0.1"', 'size="0.2"'))
    monkeypatch.chdir(elsewhere)
    assert copy.changes(settings) is None and copy.find_source().file == home / "robot.xml"
    (home / "robot.xml").unlink()
    assert copy.find_source() is None and np.array_equal(moved(copy.robot), moved(robot))


@pytest.mark.nightly
def test_a_package_that_is_gone_is_not_needed(tmp_path, monkeypatch):
    folder = tmp_path / "site" / "some_walkers"
    folder.mkdir(parents=True)
    write(folder, TWO_LEGS)
    (folder / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    settings = RobotSettings("some_walkers:robot.xml")
    robot, copy = kept(settings, tmp_path / "run")
    assert copy.find_source().package == "some-walkers"
    shutil.rmtree(folder)
    assert copy.find_source() is None and copy.changes(settings) is None
    assert np.array_equal(moved(copy.robot), moved(robot))


# Damage.


def test_a_damaged_copy_is_named(tmp_path):
    _, copy = kept(RobotSettings("biped"), tmp_path)
    for name in ("robot.xml", "numbers.npz"):
        file = copy.folder / name
        whole = file.read_bytes()
        file.write_bytes(whole[:-9])
        with pytest.raises(RunError, match=f"robot/{name} is damaged"):
            _ = OwnCopy.read(tmp_path).robot
        file.unlink()
        with pytest.raises(RunError, match=f"robot/{name} cannot be read"):
            _ = OwnCopy.read(tmp_path).robot
        file.write_bytes(whole)
    (copy.folder / "manifest.json").write_text("{")
    with pytest.raises(RunError, match=r"manifest\.json cannot be read"):
        OwnCopy.read(tmp_path)


@pytest.mark.parametrize("fact", ["root", "notes", "held", "path", "feet", "forward_axis", "action_scale"])
def test_a_fact_that_is_not_in_the_copy_is_named(tmp_path, fact):
    _, copy = kept(RobotSettings("biped"), tmp_path)
    content = read_manifest(copy.folder)
    del content["robot"][fact]
    write_manifest(copy.folder, content)
    with pytest.raises(RunError, match=rf"cannot be read: it lacks or misstates '{fact}' of its robot"):
        _ = OwnCopy.read(tmp_path).robot


def test_a_copy_that_is_another_robot_is_refused(tmp_path):
    """With checksums that fit, too: the model that comes of it is compared."""
    _, copy = kept(RobotSettings("biped"), tmp_path)
    content = read_manifest(copy.folder)
    content["parts"]["masses"] = "0" * 64
    write_manifest(copy.folder, content)
    with pytest.raises(RunError, match="is not the robot that was kept: it differs in masses"):
        _ = OwnCopy.read(tmp_path).robot


def test_a_later_format_is_refused(tmp_path):
    _, copy = kept(RobotSettings("biped"), tmp_path)
    write_manifest(copy.folder, {**read_manifest(copy.folder), "format": 2})
    with pytest.raises(RunError, match=r"has format 2; gctd3 .* reads format 1"):
        OwnCopy.read(tmp_path)


def test_what_is_not_a_copy_is_left_alone(tmp_path):
    (tmp_path / "robot").mkdir()
    mine = write(tmp_path / "robot", TWO_LEGS)
    with pytest.raises(RunError, match=r"is in the place of a run's own copy.*choose another hydra\.run\.dir"):
        keep_robot(RobotSettings("biped").load(), tmp_path)
    assert mine.read_text() == TWO_LEGS
    # One of a training that was broken off is replaced.
    shutil.rmtree(tmp_path / "robot")
    keep_robot(RobotSettings("biped").load(), tmp_path)
    keep_robot(RobotSettings("quadruped").load(), tmp_path)
    assert json.loads((tmp_path / "robot/manifest.json").read_text())["content"]["name"] == "quadruped"


def test_settings_of_a_given_robot_do_not_read_one(tmp_path, robot):
    given = GivenRobot.of(RobotSettings("no_such_robot", graph="complete"), robot)
    assert given.load() is robot and given.graph == "complete"
    assert given.load(["foot_left"]).feet == ("foot_left",)
