"""Gazebo's physics library: what is missing, the compiled program and its cache, its world, and how it ends."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from other_engines import engine_of, free_robot, servos_of
from robots import FREE_LEGS
from running import wait_for

from gctd3.engines import gazebo, gazebo_program
from gctd3.engines.settings import CrossCheckSettings
from gctd3.errors import ConfigError, EngineError, RobotError
from gctd3.robots.robot import Robot

APT = "apt-get install g++ pkg-config libignition-physics-dev"
# A box that slides, with a ball on it that turns about the vertical; the box's friction is the ground's, too.
SLED = """<mujoco><compiler angle="radian"/><worldbody><geom name="floor" type="plane" size="0 0 1" friction="0.3"/>
<body name="ball" pos="0 0 0.3"><freejoint/>
<geom name="ball" size="0.1" mass="2" contype="0" conaffinity="0"/>
<body name="sled" pos="0 0 -0.25">
<joint name="axle" axis="0 0 1" range="-1 1" limited="true" damping="0.5" armature="0.01"/>
<geom name="sled" type="box" size="0.2 0.2 0.05" mass="2" friction="0.3"/></body></body></worldbody>
<actuator><position name="axle" joint="axle" ctrlrange="-1 1" forcerange="-1 1"/></actuator>
<sensor><contact body1="sled" geom2="floor" data="found"/></sensor></mujoco>"""


def opened(contract, folder):
    """Open the library with the sled, on which no servo acts."""
    folder.mkdir(exist_ok=True)
    robot = Robot.from_mjcf(mujoco.MjSpec.from_string(SLED))
    return engine_of("gazebo")(robot, servos_of(contract, robot), 0.001, True, folder)


# What is missing.


@pytest.mark.parametrize(
    ("there", "message"),
    [
        ((), "engine=gazebo needs g++, pkg-config; "),
        (("pkg-config",), "engine=gazebo needs g++, Gazebo's physics library (ignition-physics5); "),
        (("g++", "pkg-config"), "engine=gazebo needs Gazebo's physics library (ignition-physics5); "),
    ],
)
def test_what_is_missing_is_named_with_the_line_that_brings_it(there, message, tmp_path, monkeypatch):
    for name in there:
        # One that knows no package.
        (tmp_path / name).write_text("#!/bin/sh\nexit 1\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigError) as error:
        CrossCheckSettings(engine="gazebo")
    assert str(error.value).startswith(message) and APT in str(error.value) and "\n" not in str(error.value)


# The program and its cache.


@pytest.fixture
def compiler(tmp_path, monkeypatch):
    """Return the calls of a compiler that writes its number into the program; pkg-config says what it is given."""
    calls = []

    def compile_to(path):
        calls.append(path)
        path.write_text(str(len(calls)))
        path.chmod(0o700)

    monkeypatch.setattr(gazebo_program, "_compile", compile_to)
    monkeypatch.setattr(gazebo_program, "_ask", lambda *asked: "5.1.0")
    monkeypatch.setattr(gazebo_program, "_version", lambda command: "12.2")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return calls


def test_the_program_is_compiled_once_for_each_version(compiler, tmp_path, monkeypatch):
    made = gazebo_program.program(tmp_path)
    assert gazebo_program.program(tmp_path) == made and len(compiler) == 1
    assert made.parent == tmp_path / "cache" / "gctd3" and made.parent.stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr(gazebo_program, "_version", lambda command: "13.1")
    other = gazebo_program.program(tmp_path)
    assert other != made and other.read_text() == "2" and made.read_text() == "1"
    # Written under another name first, so that nobody runs a part of it.
    assert made not in compiler and sorted(made.parent.iterdir()) == sorted([made, other])


@pytest.mark.skipif(os.name != "posix", reason="Permissions are those of POSIX.")
def test_nobody_elses_program_is_run(compiler, tmp_path, monkeypatch):
    made = gazebo_program.program(tmp_path)
    made.chmod(0o777)
    assert gazebo_program.program(tmp_path) == made and made.read_text() == "2" and not made.stat().st_mode & 0o022
    made.unlink()
    made.symlink_to(sys.executable)
    assert not gazebo_program.program(tmp_path).is_symlink()
    # A folder in which others write is no cache, nor is one below the working directory.
    made.parent.chmod(0o777)
    assert gazebo_program.program(tmp_path).parent == tmp_path
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "below")
    assert gazebo_program.program(tmp_path).parent == tmp_path and not (tmp_path / "below").exists()


@pytest.mark.nightly
def test_what_cannot_be_compiled_is_said_in_a_line_and_leaves_nothing(tmp_path, monkeypatch):
    engine_of("gazebo")
    source = tmp_path / "gazebo.cpp"
    source.write_text(gazebo_program.SOURCE.read_text().replace("int main", "it main"))
    monkeypatch.setattr(gazebo_program, "SOURCE", source)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(
        EngineError, match=r"^g\+\+ cannot compile gazebo.cpp with ignition-physics5 5.*: error: [^\n]*$"
    ):
        gazebo_program.program(tmp_path)
    assert list((tmp_path / "cache" / "gctd3").iterdir()) == []


# Robots that it cannot have.


MESH = """<asset><mesh name="wedge" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/></asset>"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            FREE_LEGS.replace("<worldbody>", f"{MESH}<worldbody>").replace(
                '<geom name="leg_r" type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02"/>',
                '<geom name="leg_r" type="mesh" mesh="wedge"/>',
            ),
            "the shapes of leg_r that collide are meshes, which Gazebo's library does not read",
        ),
        (FREE_LEGS.replace('"hip_r"', '"hip::r"'), "an SDF cannot have the names hip::r"),
    ],
)
def test_a_robot_that_an_sdf_cannot_have_is_refused_before_anything_is_compiled(
    text, message, compiler, contract, tmp_path
):
    robot = free_robot(text)
    with pytest.raises(RobotError, match=message):
        gazebo.Gazebo(robot, servos_of(contract, robot), 0.001, True, tmp_path)
    assert compiler == []


# The world.


@pytest.mark.nightly
def test_the_world_has_the_robots_friction_no_damping_and_no_limits_of_effort(contract, tmp_path):
    opened(contract, tmp_path)
    root = ElementTree.parse(tmp_path / "world.sdf").getroot()
    assert [model.get("name") for model in root.iter("model")] == ["ground", "robot"]
    robot = root.findall(".//model")[1]
    assert {float(mu.text) for mu in robot.iter("mu")} == {0.3}
    (axis,) = robot.iter("axis")
    assert axis.findtext("limit/effort") == "-1" and axis.find("dynamics/damping") is None
    assert float(axis.findtext("dynamics/friction")) == 0.0


@pytest.mark.nightly
def test_a_sled_slows_down_by_its_friction(contract, tmp_path):
    engine = opened(contract, tmp_path)
    engine.reset(np.array([0, 0, 0.2999, 1, 0, 0, 0, 0]), np.array([3.0, 0, 0, 0, 0, 0, 0]))
    for _ in range(200):
        engine.step(np.zeros(1))
    assert engine.touching() == {"sled"}
    # Coulomb: 3 m/s - 0.3 * 9.81 m/s^2 * 0.2 s.
    np.testing.assert_allclose(engine.state()[1][0], 3 - 0.3 * 9.81 * 0.2, atol=0.02)


@pytest.mark.nightly
def test_a_torque_beyond_a_servos_effort_is_not_clipped_and_a_joint_stops_at_its_limit(contract, tmp_path):
    engine = opened(contract, tmp_path)
    engine.reset(np.array([0, 0, 3.0, 1, 0, 0, 0, 0]), np.zeros(7))
    engine.step(np.array([5.0]))
    # A box m (a^2 + b^2) / 12 with the joint's armature, and a ball 2/5 m r^2, turn against each other.
    box, ball = 2 * (0.4**2 + 0.4**2) / 12 + 0.01, 0.4 * 2 * 0.1**2
    np.testing.assert_allclose(engine.state()[1][6], 0.001 * 5.0 * (1 / box + 1 / ball), rtol=1e-6)
    for _ in range(300):
        engine.step(np.array([5.0]))
    np.testing.assert_allclose(engine.state()[0][7], 1.0, atol=1e-6)


@pytest.mark.nightly
def test_a_second_start_is_the_first_to_the_bit_whatever_was_between(contract, robot, tmp_path):
    engine = engine_of("gazebo")(robot, contract, 0.001, True, tmp_path)
    home = np.array([servo.home_rad for servo in contract.servos])

    def walked():
        engine.reset(robot.start_qpos, np.full(robot.model.nv, 0.1))
        states = [engine.state()]
        for _ in range(20):
            engine.advance(home)
            states.append(engine.state())
        return states

    first = walked()
    engine.reset(robot.start_qpos, np.zeros(robot.model.nv))
    for _ in range(7):
        engine.advance(home + 0.3)
    for one, other in zip(first, walked(), strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


# How it ends.


@pytest.mark.nightly
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV])
def test_a_program_that_ends_is_an_error_with_its_reason(number, contract, tmp_path):
    engine = opened(contract, tmp_path / "with a space")
    os.kill(engine._process.pid, number)
    with pytest.raises(EngineError, match=f"^Gazebo's physics library has ended by {number.name}"):
        for _ in range(3):
            engine.advance(np.zeros(1))
    with pytest.raises(EngineError, match=f"by {number.name}"):
        engine.advance(np.zeros(1))


@pytest.mark.nightly
def test_a_program_that_does_not_answer_is_not_waited_for(contract, tmp_path, monkeypatch):
    engine = opened(contract, tmp_path)
    monkeypatch.setattr(gazebo, "_PATIENCE", 0.2)
    os.kill(engine._process.pid, signal.SIGSTOP)
    with pytest.raises(EngineError, match=r"has not answered for 0.2 s"):
        engine.advance(np.zeros(1))
    assert engine._process.wait(10) == -signal.SIGKILL


@pytest.mark.nightly
@pytest.mark.parametrize("text", ["", "<sdf", '<sdf version="1.6"><world name="flat"/></sdf>'])
def test_a_world_that_cannot_be_read_is_an_error_with_the_librarys_reason(text, contract, tmp_path, monkeypatch):
    monkeypatch.setattr(gazebo.Gazebo, "_world", lambda self, robot: text)
    with pytest.raises(EngineError, match=r"^Gazebo's physics library has ended with exit code 1: [^\n]+\.$"):
        opened(contract, tmp_path)


@pytest.mark.nightly
def test_no_port_is_opened_and_no_log_is_kept_at_home(contract, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    engine = opened(contract, tmp_path / "run")
    sockets = {os.readlink(file) for file in Path(f"/proc/{engine._process.pid}/fd").iterdir()}
    listening = {
        f"socket:[{words[9]}]"
        for table in ("tcp", "tcp6")
        for words in map(str.split, Path(f"/proc/net/{table}").read_text().splitlines()[1:])
        if words[3] == "0A"
    }
    assert not sockets & listening
    assert list((tmp_path / "home").iterdir()) == []


@pytest.mark.nightly
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_the_program_ends_with_the_command(number, exported, tmp_path):
    engine_of("gazebo")
    arguments = ["-m", "gctd3.crosscheck", f"policy={exported}", "engine=gazebo", "threads=1"]
    with (tmp_path / "said").open("w") as said:
        command = subprocess.Popen([sys.executable, *arguments], stdout=said, stderr=said, start_new_session=True)

    def programs():
        every = (file.parent for file in Path("/proc").glob("[0-9]*/stat"))
        return [one.name for one in every if status(one)[1:2] == [str(command.pid)] and "gazebo-" in line(one)]

    wait_for(programs)
    (program,) = programs()
    # Ctrl-C reaches every process of a terminal, SIGKILL the one that is named.
    os.killpg(command.pid, number) if number == signal.SIGINT else command.send_signal(number)
    assert command.wait(60) == (130 if number == signal.SIGINT else -signal.SIGKILL)
    wait_for(lambda: status(Path("/proc", program))[:1] in ([], ["Z"]), 20)
    text = (tmp_path / "said").read_text()
    assert "Traceback" not in text and ("Interrupted" in text) == (number == signal.SIGINT)


def status(process):
    """Return a process's state and the number of its parent, or nothing if it is gone."""
    try:
        return (process / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def line(process):
    try:
        return (process / "cmdline").read_text(errors="replace").split("\0")[0]
    except OSError:
        return ""
