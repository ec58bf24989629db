"""Any directory can be named on a command line, and a line that a command prints works when it is pasted into bash."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import example, given
from hypothesis import strategies as st
from omegaconf import OmegaConf
from robots import TWO_LEGS, write
from running import command, process, tiny

from gctd3.config.paths import literal_paths, plain, quoted
from gctd3.training.saved_configuration import load_config, load_settings

NAMES = [
    "Läufe und mehr",
    "it's",
    "a,b=c",
    "algo=td3,seed=1",
    "$HOME $(echo no) `echo no`",
    "[x] {y} (z)",
    "${now:%Y} \\${x}",
    "'quoted'",
    '"quoted" \\ "',
    "~;&|<>#!*?",
    "42",
    "null,true",
]
ALL = 'Ü b\'c,d=e $HOME $(echo no) ${x} [y] {z} (w) "q" \\ ~#;&!'

names = st.text(st.sampled_from("aß'\"\\$${}=,()[] #:;&|~@!%\t-./0"), min_size=1)


def argv(line):
    """Return the arguments that bash makes of a printed line, without ``python -m gctd3.NAME``."""
    script = f'python() {{ printf "%s\\0" "$@"; }}\n{line}\n'
    out = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True).stdout
    option, module, *arguments = out.split("\0")[:-1]
    assert option == "-m"
    return [module.removeprefix("gctd3."), *arguments]


def printed(text, begin):
    (line,) = [line.partition(begin)[2] for line in text.splitlines() if line.startswith(begin)]
    return line.strip()


# What Hydra reads.


@given(names)
@example("\\${x}")
@example("a\\'")
@example("\\\\")
@example("\\\n")
def test_a_quoted_value_is_read_as_it_is(value):
    override = OverridesParser.create().parse_override(f"run={quoted(value)}")
    assert OmegaConf.create({"run": override.value()})["run"] == value
    assert plain(quoted(value, interpolated=True)) == value


@given(names)
def test_a_path_on_a_command_line_is_taken_as_it_is(value):
    (argument,) = literal_paths([f"run={value}"])
    # What is quoted already, or has Hydra's backslashes, may be meant for Hydra; such a directory has to exist.
    if value[0] != value[-1] and value != "null":
        override = OverridesParser.create().parse_override(argument)
        assert OmegaConf.create({"run": override.value()})["run"] == value


def test_sweeps_and_interpolations_stay():
    swept = ["init=a,b", "robot.name=x.xml,y.xml", "seed=range(5)", "-m"]
    assert literal_paths(swept) == swept
    assert literal_paths(["init=a,b"]) == ["init='a,b'"]
    assert literal_paths(["out=null", "run=", "seed=1", "resume='a,b'"]) == [
        "out=null",
        "run=",
        "seed=1",
        "resume='a,b'",
    ]
    assert literal_paths(["hydra.run.dir=runs/${algo}, now"]) == ["hydra.run.dir='runs/${algo}, now'"]
    assert literal_paths(["run=runs/${algo}"]) == ["run='runs/\\${algo}'"]


def test_in_a_sweep_a_name_that_exists_is_one_value(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a,b").mkdir()
    assert literal_paths(["init=a,b", "-m"]) == ["init='a,b'", "-m"]


# What the commands do.


@pytest.mark.nightly
@pytest.mark.parametrize("name", [ALL, *NAMES])
def test_commands_take_a_run_of_any_name(finished, tmp_path, monkeypatch, name, capsys):
    """As it is, and as it is printed."""
    run = finished.copy("gctd3", tmp_path / name / "run")
    monkeypatch.chdir(tmp_path / name)
    (tmp_path / name / "out").mkdir()
    assert command("evaluate", f"run={run}", f"out={run.parent / 'out'}", "episodes=1", "threads=1") == 0
    said = printed(capsys.readouterr().out, "Written to ")
    files = subprocess.run(["bash", "-c", f'printf "%s\\0" {said}'], capture_output=True, text=True).stdout.split("\0")
    assert [Path(file).name for file in files[:-1]] == ["evaluation.json", "and", "trace.csv"]
    assert all(Path(file).is_file() for file in files[:-1:2])
    assert json.loads((run.parent / "out" / "evaluation.json").read_text())["episodes"] == 1
    assert command("train", f"resume={run}", "total_frames=320") == 0
    advice = argv(printed(capsys.readouterr().out, "Evaluate it over 50 episodes:"))
    assert advice == ["evaluate", f"run={run}", "episodes=50"]
    # Of the same run: no other directory was made, and its configuration holds the name as a text.
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert load_config(run).total_frames == 320


@pytest.mark.nightly
def test_a_training_goes_where_it_is_told(tmp_path, monkeypatch, capsys):
    """The printed line runs: training, its advice, and a robot, a run to begin from and films of the same names."""
    # Hydra's directory may hold interpolations, and MuJoCo opens no file whose path has a backslash.
    place = tmp_path / ALL.replace("${x}", "$x").replace("\\", "")
    place.mkdir()
    robot = write(place, TWO_LEGS)
    monkeypatch.chdir(tmp_path)
    given = [f"robot={robot}", "total_frames=120", "algo=gctd3"]
    assert command("train", *tiny(place / "run", *given)) == 0
    said = capsys.readouterr().out
    assert printed(said, "Run directory: ") and argv(printed(said, "See what it does:")) == [
        "view",
        f"run={place / 'run'}",
    ]
    settings = load_settings(place / "run")
    assert settings.robot.name == str(robot)
    assert command(*argv(printed(said, "Evaluate it over 50 episodes:"))[:2], "episodes=1", "threads=1") == 0
    assert command("train", *tiny(place / "more", *given, f"init={place / 'run'}")) == 0
    assert load_settings(place / "more").init == str(place / "run")
    capsys.readouterr()
    assert command("train", *tiny(place / "run", *given)) == 2
    again = re.search(r"continue it with (.*)\.$", capsys.readouterr().err.strip())
    assert argv(f"python -m gctd3.train {again[1]} total_frames=200") == [
        "train",
        f"resume={place / 'run'}",
        "total_frames=200",
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == [place.name]


@pytest.mark.nightly
def test_a_robots_name_may_hold_commas(tmp_path, monkeypatch):
    """It is no sweep, and no other robot of a part of the name."""
    (tmp_path / "a,b").mkdir()
    robot = write(tmp_path / "a,b", TWO_LEGS)
    monkeypatch.chdir(tmp_path)
    assert command("train", *tiny(tmp_path / "run", "robot=a,b/robot.xml", "total_frames=80", "algo=td3")) == 0
    assert load_settings(tmp_path / "run").setup().robot.path == robot.relative_to(tmp_path)


@pytest.mark.nightly
def test_reports_and_exports_of_any_name(finished, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    run = finished.copy("gctd3", tmp_path / ALL / "run")
    out = tmp_path / ALL / "report, all"
    assert command("report", f"runs={run.parent}", f"out={out}", "episodes=1", "threads=1") == 0
    said = printed(capsys.readouterr().out, "Written to ")
    assert subprocess.run(["bash", "-c", f"test -f {said}"]).returncode == 0
    assert command("export", f"run={run}", f"out={run.parent / 'policy.onnx'}", "episodes=1", "threads=1") == 0
    assert (run.parent / "policy.json").is_file()


@pytest.mark.nightly
@pytest.mark.parametrize("name", [ALL.replace("${x}", "$x").replace("\\", ""), "algo=td3,seed=1", "it's Läufe [1]"])
def test_printed_lines_run_when_they_are_pasted(tmp_path, name):
    """In bash, in processes of their own, from another directory."""
    place = tmp_path / name
    place.mkdir()
    robot = write(place, TWO_LEGS)
    line = tiny(place / "run", f"robot={robot}", "algo=gctd3", "time_limit=0.0001")
    done = process("train", *line)
    assert done.returncode == 0, done.stderr
    python = f'python() {{ "{sys.executable}" "$@"; }}; '

    def paste(begin, more=""):
        shell = subprocess.run(
            ["bash", "-c", python + printed(done.stdout, begin) + more], capture_output=True, text=True
        )
        assert shell.returncode == 0, shell.stderr
        return shell

    done = paste("Continue it:", " time_limit=null total_frames=120")
    evaluated = paste("Evaluate it over 50 episodes:", " episodes=1").stdout
    assert (place / "run" / "evaluation.json").is_file() and "Written to" in evaluated
    assert not [path for path in Path.cwd().iterdir() if path.name.startswith(("Ü", "algo="))]
    shutil.rmtree(place)
