"""Where robots' files come from: paths, installed packages, downloads; what is taken, and what is said if none is."""

import hashlib
import re
import sys
import zlib
from pathlib import Path

import pytest
from robots import FREE_LEGS, TWO_LEGS
from running import command
from urdf_files import LEGS

from gctd3 import RobotSettings
from gctd3.errors import RobotError
from gctd3.robots import sources
from gctd3.robots.load import floats, load_robot
from gctd3.robots.sources import files_of, find_place, find_source

APACHE = "Apache License\nVersion 2.0\n"


def package(folder, name, files, about="Version: 1.2\nLicense: Zlib", listed=()):
    """Put a made-up package into a folder as pip would, without files that could be run."""
    for path, text in files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    metadata = folder / f"{name.replace('-', '_')}-1.2.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\n{about}\n")
    (metadata / "RECORD").write_text("".join(f"{path},,\n" for path in listed or files))


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A folder of packages that Python sees."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    return folder


def refused(settings):
    with pytest.raises(RobotError) as error:
        find_source(settings)
    assert "\n" not in str(error.value)
    return str(error.value)


# Paths.


def test_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    for name, text in {"a.xml": FREE_LEGS, "b.urdf": LEGS, "c.xml": LEGS, "plain": LEGS}.items():
        Path(name).write_text(text)
        for place in (name, f"./{name}", f"~/{name}", str(tmp_path / name)):
            found = find_place(place)
            assert found.file.samefile(name) and found.package is None
            assert load_robot(RobotSettings(place, feet=["leg_l", "leg_r"])).base.kind == "free"


def test_shipped_robots_come_first_and_say_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("biped").write_text("not a robot")
    robot = RobotSettings("biped").load()
    assert robot.source.ships and robot.path.name == "biped.xml" and robot.origin == ""
    assert (robot.notes, dict(robot.held)) == ((), {})


@pytest.mark.parametrize(
    "name, said",
    [
        ("none.xml", "No MJCF file at none.xml."),
        ("none.mjcf", "No MJCF file at none.mjcf."),
        ("none.urdf", "No URDF file at none.urdf."),
        ("folder/none", "No MJCF file at folder/none."),
        (".", ". is a folder; a robot is an MJCF or a URDF file. It has some.mjcf."),
        ("centipede", "No robot 'centipede'. Give a path"),
        ("go2", "No robot 'go2'. robot=go2 is for the commands, with settings and without a file. Give a path"),
        ("some.xacro", "xacro some.xacro > some.urdf"),
        ("some.usd", "got a .usd"),
        ("some.mjcf", "rename it to some.xml"),
        ("some", "rename it to some.xml"),
    ],
)
def test_a_wrong_path_is_answered(tmp_path, monkeypatch, name, said):
    monkeypatch.chdir(tmp_path)
    for file in ("some.xacro", "some.usd", "some.mjcf", "some"):
        Path(file).write_text(FREE_LEGS)
    assert said in refused(RobotSettings(name))


# Packages.


def test_a_file_of_a_package_is_found_without_importing_it(installed):
    code = {"walkers/__init__.py": "raise SystemExit('imported')", "walkers/two/LICENSE": APACHE}
    package(installed, "walkers", code | {"walkers/two/two.xml": FREE_LEGS, "walkers/three.xml": FREE_LEGS})
    found = find_place("walkers:two/two.xml")
    assert found.file == installed / "walkers/two/two.xml"
    # The folder's licence, else the package's.
    assert (found.package, found.version, found.licence) == ("walkers", "1.2", "Apache-2.0")
    assert find_place("walkers:three.xml").licence == "Zlib"
    assert "walkers" not in sys.modules


def test_a_package_may_keep_its_files_elsewhere(installed, tmp_path):
    package(tmp_path, "other", {"share/robots/two.urdf": LEGS})
    about = "Version: 3\nClassifier: License :: OSI Approved :: BSD License"
    package(installed, "robot-data", {}, about, listed=["../share/robots/two.urdf"])
    found = find_place("robot-data:robots/two.urdf")
    assert found.file == tmp_path / "share/robots/two.urdf"
    assert (found.package, found.version, found.licence) == ("robot-data", "3", "BSD License")


@pytest.mark.parametrize(
    "place, said",
    [
        ("no_such_package:a.xml", "no package 'no_such_package' is installed: pip install no-such-package."),
        ("walkers:twoo.xml", "walkers 1.2 has no file 'twoo.xml'. Did you mean 'two.xml'?"),
        ("walkers:", "robot=walkers: names no file of the package walkers 1.2: walkers:PATH does."),
        ("https://somewhere.org/two.xml", "is an address: download the file and name its path."),
    ],
)
def test_a_wrong_package_is_answered(installed, place, said):
    package(installed, "walkers", {"walkers/two.xml": FREE_LEGS})
    assert said in refused(RobotSettings(place))


# Lists of places.

PLACES = ("absent_package:two.xml", "walkers:two.xml", "strollers:two.xml")


def test_the_first_that_is_installed_is_read(installed):
    assert "pip install absent-package (or walkers, strollers); pip install 'gctd3[robots]'" in refused(
        RobotSettings("two", sources=PLACES)
    )
    for name in ("strollers", "walkers"):  # the later one is in front of the earlier
        package(installed, name, {f"{name}/two.xml": FREE_LEGS})
        assert find_source(RobotSettings("two", sources=PLACES)).package == name
    assert find_source(RobotSettings("two", sources=PLACES, source="strollers")).package == "strollers"
    assert find_source(RobotSettings("two", sources=PLACES, source=PLACES[2])).package == "strollers"
    assert "pip install absent-package; " in refused(RobotSettings("two", sources=PLACES, source="absent-package"))
    said = refused(RobotSettings("two", sources=PLACES, source="stroller"))
    assert said.endswith("got 'stroller'. Did you mean 'strollers'?") and all(place in said for place in PLACES)


def test_a_shipped_robots_name_does_not_choose_among_them(installed):
    """Nobody who names the biped gets another robot."""
    package(installed, "walkers", {"walkers/two.xml": FREE_LEGS})
    said = refused(RobotSettings("biped", sources=PLACES))
    assert said == "robot.name=biped does not choose a robot where robot.sources name files: robot=biped does."


def test_another_that_is_installed_is_named_if_the_first_cannot_be_read(installed):
    package(installed, "walkers", {"walkers/three.xml": FREE_LEGS})
    package(installed, "strollers", {"strollers/two.xml": FREE_LEGS})
    said = refused(RobotSettings("two", sources=PLACES))
    assert "has no file 'two.xml'" in said
    assert said.endswith(" robot.source=strollers:two.xml takes another that is installed.")
    assert RobotSettings("two", sources=PLACES, source="strollers:two.xml").load().source.package == "strollers"


def test_a_name_that_is_a_place_is_read_itself(tmp_path):
    file = tmp_path / "mine.xml"
    file.write_text(FREE_LEGS)
    assert find_source(RobotSettings(str(file), sources=PLACES)).file == file
    assert "chooses among robot.sources" in refused(RobotSettings(str(file), source="walkers"))


# Downloads: made-up packages with the interface of the real ones.

MENAGERIE = """
import pathlib
__version__ = "2026.1"
class MenagerieError(Exception): pass
class Robot:
    license, default_model, default_scene, entry_names = "MIT", "two", "scene", ("scene", "two")
    def xml(self, entry):
        file = pathlib.Path(__file__).parent / f"{entry}.xml"
        if not file.is_file(): raise MenagerieError("no network\\nat all")
        return file
def names(): return ["maker_two"]
def get(name): return Robot()
"""


def test_menagerie(installed):
    place = RobotSettings("menagerie:maker_two")
    assert "menagerie:maker_two needs its package: pip install mujoco-menagerie" in refused(place)
    package(installed, "mujoco_menagerie", {"mujoco_menagerie/__init__.py": MENAGERIE})
    try:
        said = refused(place)
        assert "not in the cache and cannot be downloaded: no network" in said and "prefetch maker_two" in said
        assert "Did you mean 'maker_two'?" in refused(RobotSettings("menagerie:maker_to"))
        assert "has scene, two, not 'three'" in refused(RobotSettings("menagerie:maker_two/three"))
        for name in ("two", "scene"):
            (installed / f"mujoco_menagerie/{name}.xml").write_text(FREE_LEGS)
        # The robot alone, unless another file is named.
        found = find_source(place)
        assert found.file.name == "two.xml" and (found.version, found.licence) == ("2026.1", "MIT")
        assert find_place("menagerie:maker_two/scene").file.name == "scene.xml"
    finally:
        sys.modules.pop("mujoco_menagerie", None)


def test_robot_descriptions(installed, tmp_path):
    place = RobotSettings("description:two_mj_description")
    assert "needs its package: pip install robot-descriptions" in refused(place)
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots/two.urdf").write_text(LEGS)
    (tmp_path / "LICENSE").write_text("Permission is hereby granted, free of charge, to any person")
    files = {
        "__init__": "",
        "two_mj_description": f"MJCF_PATH = {str(tmp_path / 'gone.xml')!r}",
        "two_description": f"REPOSITORY_PATH, URDF_PATH = {str(tmp_path)!r}, {str(tmp_path / 'robots/two.urdf')!r}",
        "lost_description": "raise OSError('no network')",
    }
    package(installed, "robot_descriptions", {f"robot_descriptions/{name}.py": text for name, text in files.items()})
    try:
        assert "no file at" in refused(place)
        assert "cannot be downloaded: no network" in refused(RobotSettings("description:lost_description"))
        assert "Did you mean 'two_description'?" in refused(RobotSettings("description:to_description"))
        found = find_place("description:two_description")
        assert (found.file.name, found.version, found.licence) == ("two.urdf", "1.2", "MIT")
    finally:
        for name in [name for name in sys.modules if name.startswith("robot_descriptions")]:
            del sys.modules[name]


# The hash.

PARTS = """
<mujoco>
  <compiler meshdir="meshes" texturedir="pictures"/>
  <include file="legs.xml"/>
  <asset> <mesh name="foot" file="foot.stl"/> <texture name="skin" type="2d" file="skin.png"/>
    <hfield name="hills" file="hills.png" size="1 1 1 1"/> <mesh name="none" file="gone.stl"/> </asset>
</mujoco>
"""


def test_the_hash_covers_what_the_file_brings(tmp_path):
    parts = ["legs.xml", "meshes/foot.stl", "meshes/hills.png", "pictures/skin.png"]
    (tmp_path / "robot.xml").write_text(PARTS)
    for part in parts:
        (tmp_path / part).parent.mkdir(exist_ok=True)
        (tmp_path / part).write_bytes(b"<mujoco/>\r\n")
    files = files_of(tmp_path / "robot.xml")
    assert {str(file.relative_to(tmp_path)) for file in files} == {"robot.xml", *parts}
    first = find_place(str(tmp_path / "robot.xml")).sha256
    # One file after the other; line endings of texts do not count.
    whole = b"".join(f.read_bytes().replace(b"\r\n", b"\n" if f.suffix == ".xml" else b"\r\n") for f in files)
    assert first == hashlib.sha256(whole).hexdigest()
    for part in ["robot.xml", *parts]:
        before = (tmp_path / part).read_bytes()
        (tmp_path / part).write_bytes(before + b" ")
        assert find_place(str(tmp_path / "robot.xml")).sha256 != first, part
        (tmp_path / part).write_bytes(before)
    (tmp_path / "legs.xml").write_bytes(b"<mujoco/>\n")
    assert find_place(str(tmp_path / "robot.xml")).sha256 == first


# The command line.


def test_the_option_fits_the_base(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in {"free.xml": FREE_LEGS, "planar.xml": TWO_LEGS, "legs.urdf": LEGS, "it's.xml": FREE_LEGS}.items():
        Path(name).write_text(text)
    assert [floats(Path(name)) for name in ("free.xml", "planar.xml", "legs.urdf")] == [True, False, True]
    for name, free in (("free.xml", True), ("planar.xml", False), ("legs.urdf", True), ("it's.xml", True)):
        assert command("train", f"robot={name}", "--cfg", "job") == 0
        composed = capsys.readouterr().out
        assert ("Heading" in composed) == free and re.search(
            rf"^  name: '?{name.replace(chr(39), '.*')}", composed, re.M
        )
    for names, said in {
        "free.xml,planar.xml": "free.xml has a free base and planar.xml has not",
        "biped,free.xml": "biped is an option and others are files",
        "none.urdf": "No URDF file at none.urdf.",
        "./": "./ is a folder; a robot is an MJCF or a URDF file. It has free.xml, it's.xml, legs.urdf, planar.xml.",
        "/none/here": "No MJCF file at /none/here.",
        "no_package:a.xml": "no package 'no_package' is installed",
    }.items():
        assert command("train", "-m", f"robot={names}") == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1


def test_a_task_that_brings_its_robot_takes_no_other(capsys):
    assert command("train", "task=halfcheetah", "robot=go2") == 2
    error = capsys.readouterr().err
    assert error == "error: robot=go2: a library's task brings its own robot; leave robot=go2 out.\n"
    assert command("train", "task=halfcheetah", "robot=biped", "--cfg", "job") == 0


def test_what_is_taken_is_printed(tmp_path, capsys, installed):
    package(installed, "walkers", {"walkers/two.xml": FREE_LEGS})
    assert command("graph", "robot=walkers:two.xml", "out=null") == 0
    printed = capsys.readouterr().out
    digest = hashlib.sha256(FREE_LEGS.encode()).hexdigest()[:12]
    assert f"Robot: {installed}/walkers/two.xml (walkers 1.2, Zlib, SHA-256 {digest})\n" in printed


def test_a_scene_with_a_ball_is_no_free_robot(tmp_path):
    ball = '<body pos="2 0 1"><freejoint/><geom size="0.1"/></body></worldbody>'
    (tmp_path / "ball.xml").write_text(TWO_LEGS.replace("</worldbody>", ball))
    assert not floats(tmp_path / "ball.xml")


def test_zlib_is_a_package_without_a_folder():
    # A module of C has neither files nor a folder.
    assert zlib and sources.pip_name("zlib") == "zlib"
    assert "no package 'zlib'" in refused(RobotSettings("zlib:a.xml"))
