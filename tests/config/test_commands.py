"""Every command answers wrong input with one message that names it and exit code 2, and writes nothing."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from running import command, process, tiny
from thinned import parametrize

from gctd3.files import read_manifest, write_manifest


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def run(finished, tmp_path_factory):
    return finished.copy("gctd3", tmp_path_factory.mktemp("trained") / "run")


def answer(capsys, name, *arguments):
    """Return the one message on stderr of a command that refuses."""
    capsys.readouterr()
    assert command(name, *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("error: ") == 1 and "Traceback" not in error
    return error


def assert_untrained(directory):
    assert not [path for path in directory.rglob("*") if path.name in ("progress.csv", "checkpoints")]


WRONG = {
    "algo=gtcd3": ["'algo/gtcd3'", "Did you mean 'gctd3'?", "ddpg, gctd3, sac, td3"],
    "robot=bipd": ["'robot/bipd'", "Did you mean 'biped'?"],
    "reward@evaluation.reward=papr": ["'reward/papr'", "Did you mean 'paper'?"],
    "robot.name=hexapd": ["'hexapd'", "Did you mean 'hexapod'?"],
    "robot.feet=[foot_lef]": ["'foot_lef'", "Did you mean 'foot_left'?"],
    "robot.graph=author": ["robot.graph", "Did you mean 'authors'?"],
    "exploration.learning_starts=241": ["exploration.learning_starts must be at most total_frames = 240, got 241"],
    "exploration.frequency=[1,26]": ["exploration.frequency", "25 Hz", "[1, 26]"],
    "exploration.noise=[0.1,20]": ["exploration.noise", "<= 10", "[0.1, 20]"],
    "replay.batch_size=980": ["replay.buffer_size must hold a batch", "replay.batch_size is 980", "972"],
    "reward.terms.swing.least=0.5": ["reward.terms.swing.least", "at most most", "0.5 and 0.36"],
    "network.hidden=[16384,16384]": ["network.hidden", "100,000,000 weights", "268,435,456"],
    "network.hidden=[99999]": ["network.hidden", "16,384", "[99999]"],
    "task.history=100000": ["task.history must be at most 1,000, got 100000"],
    "algo.tau=1e400": ["algo.tau must be a number"],
    "algo=ppo": ["'algo/ppo'", "ddpg", "gctd3", "sac", "td3"],
    "experiment=papr": ["'experiment/papr'", "paper"],
    "algo.learning_rat=1": ["'algo.learning_rat'", "Did you mean 'algo.learning_rate'?", "algo.gamma"],
    "algo=sac algo.alph=0.1": ["'algo.alph'", "Did you mean 'algo.alpha'?"],
    "total_frame=9": ["'total_frame'", "Did you mean 'total_frames'?"],
    "+algo.momentum=0.9": ["'algo.momentum'", "Accepted: learning_rate"],
    "replay.batch_size=many": ["replay.batch_size", "a whole number", "'many'"],
    "replay.batch_size=": ["replay.batch_size", "a whole number", "''"],
    "algo.average_policy=often": ["algo.average_policy", "true or false", "'often'"],
    "env.num_envs=-3": ["env.num_envs", "at least 1", "-3"],
    "env.num_envs=0": ["env.num_envs", "at least 1", "0"],
    "replay.buffer_size=0": ["replay.buffer_size", "at least 1", "0"],
    "network.hidden=[64,0]": ["network.hidden", "at least 1", "[64, 0]"],
    "evaluation.episodes=0": ["evaluation.episodes", "at least 1", "0"],
    "total_frames=-1": ["total_frames", "at least", "-1"],
    "task.control_dt=0.013": ["task.control_dt", "0.005", "0.013"],
    "robot.graph=ring": ["robot.graph", "tree, authors, edgeless, complete, random", "'ring'"],
    "robot.name=centipede": ["'centipede'", "biped", ".xml"],
    "robot.name=nowhere.xml": ["nowhere.xml"],
    "seed=[": ["seed=["],
    "seed=99999999999": ["seed must be", "below 2^32", "99999999999"],
    "+=[]": ["cannot be combined"],
    "algo=null": ["algo cannot be left out. Options of algo: ddpg, gctd3, sac, td3"],
    "evaluation.episodes=100000000000": ["evaluation.episodes must be at most 100,000"],
}


@parametrize(2, "arguments", WRONG)
def test_a_wrong_command_line_is_answered(capsys, tmp_path, arguments):
    error = answer(capsys, "train", *tiny(tmp_path / "run", *arguments.split()))
    assert all(words in error for words in WRONG[arguments]), error
    assert not list(tmp_path.iterdir())


def test_too_little_memory_is_answered(capsys, tmp_path):
    assert command("train", *tiny(tmp_path / "run", "replay.buffer_size=1_000_000_000_000")) == 2
    error = capsys.readouterr().err
    assert "Traceback" not in error and "error: Not enough memory" in error and "replay.buffer_size" in error


@pytest.mark.parametrize("argument", [pytest.param("algo=ppo", marks=pytest.mark.nightly), "env.num_envs=0"])
def test_a_process_ends_with_2_and_one_message(tmp_path, argument):
    done = process("train", *tiny(tmp_path / "run", argument))
    assert done.returncode == 2
    assert done.stderr.startswith("error: ") and "Traceback" not in done.stderr + done.stdout
    assert_untrained(tmp_path)


def test_ctrl_c_ends_a_command_with_a_line(capsys, monkeypatch):
    def interrupted(*arguments, **named):
        raise KeyboardInterrupt

    monkeypatch.setattr("gctd3.robots.robot.Robot.from_model", interrupted)
    assert command("graph", "robot=biped") == 130
    assert capsys.readouterr().err == "\nInterrupted.\n"


@pytest.mark.nightly
@pytest.mark.parametrize("number, code", [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_an_evaluation_with_a_line_and_leaves_nothing(capsys, monkeypatch, tmp_path, number, code):
    before = signal.getsignal(number)
    for where in ("gctd3.runs.evaluate.evaluate", "gctd3.runs.evaluate.summarize"):
        with monkeypatch.context() as patch:
            patch.setattr(where, lambda *arguments, **named: signal.raise_signal(number))
            assert command("evaluate", f"out={tmp_path / 'evaluated'}", "episodes=1", "threads=1") == code
        # On a slow machine a line of progress comes before.
        assert capsys.readouterr().err.endswith("\nInterrupted.\n")
        assert not list(tmp_path.iterdir())
    assert signal.getsignal(number) is before


def test_an_import_that_a_signal_breaks_off_is_no_missing_package(capsys, monkeypatch):
    def broken(*arguments, **named):
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            raise ImportError("numpy is broken") from None

    monkeypatch.setattr("gctd3.robots.load.load_robot", broken)
    assert command("graph", "robot=biped") == 143
    error = capsys.readouterr().err
    assert error.endswith("\nInterrupted.\n") and "numpy" not in error


# Python holds output to a pipe back, unless this is set.
AT_ONCE = "PYTHONUNBUFFERED"
CALLS = ["gctd3.graph robot=biped", "gctd3", "gctd3 train --help", "gctd3.ros --help", "gctd3.config.reference"]


@pytest.mark.parametrize("call", [CALLS[0], *(pytest.param(call, marks=pytest.mark.nightly) for call in CALLS[1:])])
@pytest.mark.parametrize("at_once", ["", pytest.param("1", marks=pytest.mark.nightly)])
def test_output_that_nobody_reads_is_no_error(call, at_once):
    words, environment = [sys.executable, "-m", *call.split()], {**os.environ, AT_ONCE: at_once}
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as cut:
        cut.stdout.close()
        assert cut.stderr.read() == b""
    assert cut.returncode == 141


MJCF = {
    "unclosed": ("<mujoco><worldbody></mujoco>", "not an MJCF"),
    "no foot": ("", "no foot"),
}


@pytest.mark.parametrize("case", MJCF)
def test_an_unusable_mjcf_is_answered(capsys, tmp_path, robot, case):
    text, said = MJCF[case]
    file = tmp_path / "my_robot.xml"
    file.write_text(text or re.sub('con(type|affinity)="1"', 'con\\1="0"', robot.path.read_text()))
    error = answer(capsys, "train", *tiny(tmp_path / "run", f"robot.name={file}"))
    assert str(file) in error and said in error
    assert_untrained(tmp_path)


def test_an_output_that_cannot_be_written_is_answered(capsys, tmp_path):
    (tmp_path / "file").write_text("in the way")
    error = answer(capsys, "train", *tiny(tmp_path / "file" / "run"))
    assert str(tmp_path / "file") in error
    assert (tmp_path / "file").read_text() == "in the way"


def test_a_directory_holds_one_run(capsys, run):
    before = (run / "progress.csv").read_text(encoding="utf-8")
    assert f"{run} holds a run already" in answer(capsys, "train", *tiny(run))
    assert (run / "progress.csv").read_text(encoding="utf-8") == before


# Directories that are not usable runs.


@pytest.fixture
def broken(run, tmp_path):
    """Copy a run, to damage it."""
    return Path(shutil.copytree(run, tmp_path / "broken"))


def of_another_version(run):
    for manifest in run.glob("checkpoints/*/manifest.json"):
        write_manifest(manifest.parent, {**read_manifest(manifest.parent), "format": 99})


def flip(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def rewrite(file, old, new):
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))


CONFIG = Path(".hydra") / "config.yaml"
BREAK = {
    "no config": (lambda run: (run / CONFIG).unlink(), "config.yaml"),
    "not YAML": (lambda run: (run / CONFIG).write_text("a: [1"), "config.yaml"),
    "another key": (lambda run: rewrite(run / CONFIG, "keep_checkpoints:", "colour:"), "'colour'"),
    "another network": (lambda run: rewrite(run / CONFIG, "norm: layer", "norm: none"), "best-"),
    "no checkpoint": (lambda run: shutil.rmtree(run / "checkpoints"), "No policy"),
    "no tensors": (lambda run: [f.unlink() for f in run.glob("checkpoints/best-*/*.safetensors")], "best-"),
    "a flipped bit": (lambda run: [flip(f) for f in run.glob("checkpoints/best-*/*.safetensors")], "checksum"),
    "an old format": (lambda run: (run / "checkpoints" / "checkpoint-000000000240").mkdir(), "format 1"),
    "another version": (of_another_version, "format 99"),
}


@pytest.mark.parametrize("case", BREAK)
def test_a_run_that_cannot_be_used_is_answered(capsys, broken, case):
    damage, said = BREAK[case]
    damage(broken)
    error = answer(capsys, "evaluate", f"run={broken}", "episodes=1")
    assert str(broken) in error and said in error
    assert not (broken / "evaluation.json").exists()


@pytest.mark.parametrize("name", ["evaluate", "export", "render", "view"])
def test_a_run_that_is_not_there_is_answered(capsys, tmp_path, name):
    assert str(tmp_path / "nowhere") in answer(capsys, name, f"run={tmp_path / 'nowhere'}")
    assert "not a run" in answer(capsys, name, f"run={tmp_path}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name, argument, said",
    [
        ("evaluate", "episodes=0", "episodes must be at least 1, got 0."),
        ("evaluate", "threads=0", "threads must be at least 1"),
        ("evaluate", "seed=-1", "seed must be at least 0 and below 2^32, got -1."),
        ("evaluate", "episode=3", "Did you mean 'episodes'?"),
        ("export", "episodes=0", "episodes must be at least 1, got 0."),
        ("export", "max_rate=0", "max_rate must be above 0 rad/s, or null, got 0.0."),
        ("export", "hold=-1", "hold must be at least 0.0, got -1.0."),
        ("export", "home_rate=0", "home_rate must be above 0 and at most 100 rad/s, got 0.0."),
        ("export", "out=policy.pth", "out must end in .onnx, .pt2, .hpp, .urdf or .sdf, got 'policy.pth'."),
        ("export", "out=nowhere/policy.onnx", "nowhere"),
        ("render", "width=0", "width must be at least 1, got 0."),
        ("render", "height=100000", "height must be at most 16,384, got 100000."),
        ("render", "out=walk.bmp", "out must end in .png, .gif or .mp4, got 'walk.bmp'."),
        ("render", "seconds=0", "seconds must be above 0, or null, got 0"),
        ("render", "out=nowhere/walk.png", "nowhere"),
        ("render", "camera=behind", "side, three_quarter"),
        ("view", "port=-1", "port must be at least 0, got -1."),
        ("view", "port=65536", "port must be at most 65,535, got 65536."),
    ],
)
def test_a_wrong_setting_of_the_other_commands_is_answered(capsys, run, name, argument, said):
    assert said in answer(capsys, name, f"run={run}", argument)


class Faulty:
    def __init__(self, *arguments):
        raise LookupError("a fault of the program")


@pytest.mark.parametrize("sweep", [[], ["-m", "seed=1"]], ids=len)
def test_a_fault_of_the_program_keeps_its_traceback(sweep, tmp_path, capsys):
    with pytest.raises(LookupError, match="a fault of the program"):
        command("train", *sweep, *tiny(tmp_path / "run", f"hydra.sweep.dir={tmp_path}"), trainer=Faulty)
    assert "cannot be combined" not in capsys.readouterr().err
