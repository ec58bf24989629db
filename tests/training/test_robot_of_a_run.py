"""A run contains its robot: all commands work on it from anywhere, whatever has become of the robot's file."""

import json
import os
import shutil

import pytest
from robots import TWO_LEGS, write
from running import command, process, rows, tiny

import gctd3
from gctd3.deploy.contract import robot_hash
from gctd3.robots.own_copy import OwnCopy
from gctd3.training.saved_configuration import load_settings

FINE = ("episodes=2", "threads=1")
OTHER = TWO_LEGS.replace('size="0.1"', 'size="0.2"').replace('ctrlrange="-1 1"', 'kp="9" ctrlrange="-0.7 1"')


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Train on a robot of a file that is given from its own directory."""
    home = tmp_path_factory.mktemp("home")
    write(home, TWO_LEGS)
    here = os.getcwd()
    os.chdir(home)
    try:
        assert command("train", *tiny("run", "robot=robot.xml", "total_frames=120", "algo=gctd3")) == 0
        assert command("evaluate", "run=run", *FINE) == 0
    finally:
        os.chdir(here)
    return home


@pytest.fixture
def run(trained, tmp_path, monkeypatch):
    """Copy the run to another place than its robot; the working directory is a third one."""
    copy = shutil.copytree(trained / "run", tmp_path / "copied" / "run")
    (copy / "evaluation.json").unlink()
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return copy


def evaluation(run):
    return json.loads((run / "evaluation.json").read_text())


def moved_away(trained):
    (trained / "robot.xml").unlink()


def changed(trained):
    write(trained, OTHER)


STATES = {"there": lambda trained: None, "gone": moved_away, "another": changed, "no robot": lambda t: write(t, "<no")}


@pytest.fixture(params=STATES)
def state(request, trained):
    """Do something to the robot's file, for one test."""
    STATES[request.param](trained)
    yield request.param
    write(trained, TWO_LEGS)


def test_evaluations_are_the_same(trained, run, state, capfd):
    # A file of the same name in the working directory plays no part.
    write(run.parents[1] / "work", OTHER)
    assert command("evaluate", f"run={run}", *FINE) == 0
    assert evaluation(run) == evaluation(trained / "run")
    said = capfd.readouterr().err
    about = [line for line in said.splitlines() if str(trained) in line]
    expected = {
        "there": [],
        "gone": [],
        "another": [
            f"{run}: {trained / 'robot.xml'} differs from the robot of the run in masses, collision geometry, "
            "actuator gains, actuator ranges, meaning of actions ("
        ],
        "no robot": [f"{run}: The robot's source cannot be used any more, the run's own copy is: "],
    }[state]
    assert len(about) == len(expected)
    assert all(line.startswith(begin) for line, begin in zip(about, expected, strict=True))


@pytest.mark.nightly
def test_the_contract_is_of_the_runs_own_robot(trained, run, tmp_path):
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    from gctd3.deploy import Policy
    from gctd3.errors import ContractError

    own = OwnCopy.read(run).hash
    assert own == robot_hash(run) == robot_hash(run / "robot") == robot_hash(run / "robot" / "robot.xml")
    write(trained, OTHER)
    try:
        assert command("export", f"run={run}", f"out={tmp_path / 'policy.onnx'}", *FINE) == 0
        policy = Policy(tmp_path / "policy.onnx", robot=run)
        assert policy.contract.robot.sha256 == own and policy.contract.robot.name == "robot"
        assert policy.contract.servos[0].low_rad == -1.0
        with pytest.raises(ContractError, match=rf"trained for 'robot', whose MJCF is not .*hash {own[:12]}, not "):
            Policy(tmp_path / "policy.onnx", robot=trained / "robot.xml")
    finally:
        write(trained, TWO_LEGS)
    assert Policy(tmp_path / "policy.onnx", robot=trained / "robot.xml").command
    # A damaged copy is no copy.
    (run / "robot" / "robot.xml").write_text("<mujoco/>")
    with pytest.raises(ContractError, match=r"robot\.xml is damaged"):
        Policy(tmp_path / "policy.onnx", robot=run)


@pytest.mark.nightly
def test_a_run_goes_on_with_its_robot(trained, run, tmp_path):
    """Resumed on its copy it makes the numbers of a run that was resumed where its robot is."""
    whole = shutil.copytree(trained / "run", tmp_path / "whole")
    assert command("train", f"resume={whole}", "total_frames=240") == 0
    write(trained, OTHER)
    try:
        assert command("train", f"resume={run}", "total_frames=240") == 0
    finally:
        write(trained, TWO_LEGS)
    assert rows(run, drop=("wall_s",)) == rows(whole, drop=("wall_s",)) and len(rows(run)) > 1
    assert OwnCopy.read(run).hash == OwnCopy.read(whole).hash


@pytest.mark.nightly
def test_networks_begin_as_another_runs_had_them(trained, run, tmp_path, monkeypatch):
    """Relative to the directory in which it is said, for good."""
    monkeypatch.chdir(run.parent)
    assert command("train", *tiny(tmp_path / "new", f"robot={trained / 'robot.xml'}", "init=run", "algo=gctd3")) == 0
    assert load_settings(tmp_path / "new").init == str(run)
    monkeypatch.chdir(tmp_path / "work")
    assert command("train", f"resume={tmp_path / 'new'}", "total_frames=320") == 0


@pytest.mark.nightly
def test_other_commands_find_the_robot(trained, run, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    (trained / "robot.xml").rename(trained / "other.xml")
    try:
        assert gctd3.load_policy(run) is not None
        assert command("report", f"runs={run.parent}", f"out={tmp_path / 'report'}", *FINE) == 0
        assert (tmp_path / "report" / "index.html").is_file() and (run / "evaluation.json").is_file()
        from gctd3.runs.settings import ViewSettings
        from gctd3.runs.show import open_walk

        walk = open_walk(str(run), ViewSettings())
        assert walk.step().time == pytest.approx(0.02)
    finally:
        (trained / "other.xml").rename(trained / "robot.xml")


@pytest.mark.nightly
def test_runs_of_two_robots_of_one_name_do_not_belong_together(trained, run, tmp_path, monkeypatch, capsys):
    other = tmp_path / "another"
    other.mkdir()
    write(other, OTHER)
    monkeypatch.chdir(other)
    assert command("train", *tiny(run.parent / "b", "robot=robot.xml", "total_frames=120", "algo=gctd3", "seed=1")) == 0
    assert command("report", f"runs={run.parent}", f"out={tmp_path / 'report'}", *FINE) == 2
    said = capsys.readouterr().err
    first, second = (OwnCopy.read(run.parent / name).hash[:12] for name in ("run", "b"))
    assert f"robot, hash of its physics: {second} in b; {first} in run" in said


@pytest.mark.nightly
def test_a_run_without_a_copy_reads_its_source(trained, run, monkeypatch, capfd):
    """As runs did before they kept one; it says so, and keeps one when it goes on."""
    shutil.rmtree(run / "robot")
    assert command("evaluate", f"run={run}", *FINE) == 2
    assert "No MJCF file at robot.xml" in capfd.readouterr().err
    monkeypatch.chdir(trained)
    assert command("evaluate", f"run={run}", *FINE) == 0
    assert f"{run}: It keeps no copy of its robot; what it is now is taken: robot.xml" in capfd.readouterr().err
    assert evaluation(run) == evaluation(trained / "run")
    assert command("train", f"resume={run}", "total_frames=240") == 0
    assert OwnCopy.read(run).hash == OwnCopy.read(trained / "run").hash


@pytest.mark.nightly
def test_a_sweeps_runs_keep_a_robot_each(tmp_path, trained):
    """So that each works where it is copied to."""
    line = [*tiny(tmp_path / "unused", "robot=robot.xml", "total_frames=80"), "-m", "algo=gctd3,td3"]
    line = [word for word in line if not word.startswith("hydra.run.dir")]
    here = os.getcwd()
    os.chdir(trained)
    try:
        done = process("train", *line, f"hydra.sweep.dir={tmp_path / 'sweep'}")
    finally:
        os.chdir(here)
    assert done.returncode == 0, done.stderr
    copies = [OwnCopy.read(tmp_path / "sweep" / name).hash for name in ("gctd3/0", "td3/1")]
    assert copies == [OwnCopy.read(trained / "run").hash] * 2


def test_a_librarys_robot_is_known_by_its_hash(finished, tmp_path, capfd):
    run = finished.copy("library", tmp_path / "run")
    copy = OwnCopy.read(run)
    assert not copy.whole and [file.name for file in copy.folder.iterdir()] == ["manifest.json"]
    assert command("evaluate", f"run={run}", "episodes=1", "threads=1") == 0
    assert "differs" not in capfd.readouterr().err
    from gctd3.files import read_manifest, write_manifest

    content = read_manifest(copy.folder)
    content["parts"]["masses"] = content["hash"] = "0" * 64
    write_manifest(copy.folder, content)
    assert command("evaluate", f"run={run}", "episodes=1", "threads=1") == 0
    said = capfd.readouterr().err
    assert "brings now differs from the robot of the run in masses (hash 000000000000 in the run, " in said
