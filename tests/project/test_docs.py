"""The commands that README and the pages of docs/ show run, and their Python too."""

import doctest
import importlib
import re
import shlex
import shutil
import subprocess
import sys
import uuid
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch
import yaml
from array_api_compat import array_namespace
from configs import composed
from fuzzing import answered
from omegaconf import DictConfig, OmegaConf
from robots import TWO_LEGS
from running import TINY, command, train

from gctd3.bridge.arguments import parse
from gctd3.bridge.settings import RosSettings
from gctd3.config.build import build
from gctd3.config.help import COMMANDS
from gctd3.errors import RobotError
from gctd3.robots.sources import find_source
from gctd3.training.saved_configuration import load_settings

ROOT = Path(__file__).parents[2]
PAGES = {
    page.name: page.read_text(encoding="utf-8") for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
}
# A directive's language stands in braces.
FENCED = re.compile(r"^```([^\n`]*)\n(.*?)^```", re.M | re.S)
BLOCKS = [block for text in PAGES.values() for block in FENCED.findall(text)]
SHELL = "".join(text for language, text in BLOCKS if not language)
EXTRAS = re.findall(r"^(\w+) = \[", (ROOT / "pyproject.toml").read_text(encoding="utf-8"), flags=re.M)
PARTS = sorted({part.strip() for line in SHELL.splitlines() for part in line.split("&&")})


PYTHON = [(page, text) for page in PAGES for language, text in FENCED.findall(PAGES[page]) if language == "python"]
RUNS = "# runs\n"


def test_python_compiles():
    assert len(PYTHON) >= 8
    for page, text in PYTHON:
        compile(text, page, "exec")


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(("page", "text"), [(page, text) for page, text in PYTHON if text.startswith(RUNS)])
def test_python_runs(page, text, exported, monkeypatch):
    monkeypatch.chdir(exported.parent)
    names: dict[str, object] = {}
    exec(text, names)
    # Each says in its comments what it makes.
    if "rollout" in names:
        assert names["rollout"].batch_size in ((64, 100), (2, 50))
    if "envs" in names:
        assert names["envs"].num_envs == 64
    if "command" in names:
        assert list(names["command"]) == list(names["policy"].command) and len(names["command"]) == 6
    assert {"rollout", "envs", "command", "step"} & set(names)


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["batched", "dm_control"])
def test_the_shown_reward_term_is_trained_with(backend, tmp_path, monkeypatch):
    text = next(text for language, text in BLOCKS if language == "python" and "class Hurry" in text)
    # Another test may have imported another module of this name.
    monkeypatch.setitem(sys.modules, "my_package", ModuleType("my_package"))
    exec(text, vars(sys.modules["my_package"]))
    keys = re.findall(r"`(\+reward[^`]*)`", PAGES["extend.md"])
    assert len(keys) == 2
    train(tmp_path / "run", f"env.backend={backend}", *keys)
    term = load_settings(tmp_path / "run").reward.terms["hurry"]
    assert (type(term).__name__, term.weight, term.above) == ("Hurry", 0.5, 0.8)
    for xp in (np, torch):
        step = SimpleNamespace(xp=array_namespace(xp.zeros(1)), now=SimpleNamespace(velocity=xp.linspace(0.0, 1.8, 3)))
        np.testing.assert_allclose(np.asarray(term(step)), [0.0, 0.05, 0.5], rtol=1e-6)


@pytest.mark.parametrize("module", ["gctd3.robots.graph", "gctd3.nn.factories", "gctd3.envs.factory"])
def test_docstring_examples(module):
    result = doctest.testmod(importlib.import_module(module))
    assert result.attempted > 0
    assert result.failed == 0


# Command lines, each where the files are that it names.

RUN, SWEEP = "runs/biped/gctd3/2026-01-31_12-00-00", "multirun/2026-01-31_12-00-00"
BUDGET = [f"{key}={value}" for key, value in TINY.items()]
# What is added to a command, so that it takes seconds; the last of two values counts.
SMALL = {
    "train": BUDGET,
    "evaluate": ["episodes=2", "threads=1", "grid.forward=2", "grid.side=1", "grid.turn=1", "grid.starts=1"],
    "report": ["episodes=2", "threads=1"],
    "render": ["width=64", "height=48", "columns=2", "rows=1", "seconds=0.1"],
    "export": ["episodes=2", "threads=1"],
    "benchmarks/walk.py": ["seeds=0", "jobs=1", *BUDGET],
    # Without the older commit, which only a git repository has.
    "benchmarks/whole_command.py": ["tuned=", "untuned=", "starts=0", "out=whole_command.json"],
    "benchmarks/yardsticks.py": [
        "tasks=halfcheetah",
        "algos=td3",
        "seeds=0",
        "steps=300",
        "random_steps=250",
        "every=300",
        "episodes=1",
    ],
}
# What is said in place of something long.
INSTEAD = {
    "algo=gctd3,td3,ddpg,sac": "algo=gctd3,td3",
    "seed=range(5)": "seed=1",
    "total_frames=1_000_000": "total_frames=320",
    # Of its twenty runs one, and of its kinds of perturbation the fewest.
    "experiment=table5": "experiment=table5 algo=gctd3 seed=0",
    "robustness=true": "robustness=true perturbations.impulses=[5] perturbations.phases=1 perturbations.starts=1",
}
NEEDS = {
    "view": ["mjviser"],
    "report": ["matplotlib"],
    "render": ["imageio_ffmpeg"],
    "export": ["onnxscript", "onnxruntime"],
    "benchmarks/yardsticks.py": ["stable_baselines3", "matplotlib"],
}
# Run by the continuous integration, in a fresh environment.
INSTALL = {
    'pip install -e ".[test]"',
    'pip install -e ".[docs]"',
    "pip install -e .",
    "pytest",
    "pip install uv",
    'uv pip install --torch-backend=cpu "torch<2.15"',
}
# Those of the site and its tables, which tests/project/test_site.py runs.
INSTALL |= {"python -m sphinx docs site"}


@pytest.fixture(scope="module")
def place(tmp_path_factory, finished):
    """Make a folder with a stopped run, one that follows commands, a sweep, and the MJCF and YAML of another robot."""
    root = tmp_path_factory.mktemp("pages")
    run = train(root / RUN, "total_frames=160")
    for seed in range(2):
        one = shutil.copytree(run, root / SWEEP / "gctd3" / str(seed))
        config = one / ".hydra" / "config.yaml"
        config.write_text(config.read_text(encoding="utf-8").replace("\nseed: 0\n", f"\nseed: {seed}\n"))
    for file in (".hydra/config.yaml", ".hydra/overrides.yaml"):
        text = (run / file).read_text(encoding="utf-8")
        (run / file).write_text(text.replace("total_frames: 160", "total_frames: 240").replace("=160", "=240"))
    shutil.copytree(run, root / "DIR")
    shutil.copytree(finished["velocity"], root / "RUN")
    (root / "my.xml").write_text(TWO_LEGS.replace("leg_r", "toe_right").replace("leg_l", "toe_left"))
    (mine,) = (text for language, text in BLOCKS if language == "yaml")
    (root / "robots/robot").mkdir(parents=True)
    (root / "robots/robot/mine.yaml").write_text(mine)
    return root


def test_every_line_is_accounted_for():
    known = [
        rf"python -m gctd3\.({'|'.join(COMMANDS)})( .+)?",
        r"python -m gctd3",
        r"python (benchmarks|examples)/\w+\.py .+",
    ]
    known += [rf"pip install ([\"'])gctd3\[({'|'.join(EXTRAS)})\]\1", r"(uv )?pip (un)?install (?!.*gctd3\[).+"]
    # Other programs' lines, and what is printed, are not ours to run.
    ours = [part for part in PARTS if re.match(r"(python|pip|uv|pytest|gctd3)\b", part)]
    strange = [part for part in ours if part not in INSTALL and not any(re.fullmatch(k, part) for k in known)]
    assert not strange and len(ours) >= 30
    assert {part for part in PARTS if part.startswith("pip install -e")} <= INSTALL
    assert {parsed(line)[0] for line in quick()} <= {*QUICK} and len(quick()) >= 3 and OTHERS
    written = (ROOT / ".ci/run").read_text(encoding="utf-8")
    assert 'pip install -q -e ".[test]"' in written and "\npytest\n" in written
    assert "\npytest -m nightly " in (ROOT / ".ci/nightly").read_text(encoding="utf-8")


LINES = [part for part in PARTS if part.startswith("python") and part not in INSTALL]


def parsed(line):
    """Split a command line into command and arguments, and shorten long trainings."""
    words = [part for word in shlex.split(line) for part in INSTEAD.get(word, word).split(" ")]
    called = 2 if words[1] == "-m" else 1
    return words[called].removeprefix("gctd3").lstrip("."), words[called + 1 :]


def small(name, arguments):
    """Return arguments that shorten a command line to seconds."""
    if any(word.startswith("resume=") for word in arguments):
        return []
    # Two trainings in one second would have one directory.
    directory = [f"hydra.run.dir=runs/{uuid.uuid4().hex}"] if name == "train" and "-m" not in arguments else []
    return [*SMALL.get(name, []), *directory]


# Those whose line takes long have quick tests in rooms of their own.
QUICK = ("", "train", "evaluate", "graph")


def begin_from(arguments, place):
    """Make the run of which a training takes the networks: of its robot and task, on a plane and without sight."""
    asked = next((word.partition("=")[2] for word in arguments if word.startswith("init=")), None)
    if asked is None:
        return
    same = [word for word in arguments if not word.startswith(("init=", "terrain=", "sight=", "hydra.run.dir="))]
    shutil.rmtree(place / asked, ignore_errors=True)
    assert command("train", *same, f"hydra.run.dir={asked}") == 0


def quick():
    """Return the first line of each quick command that is not a sweep."""
    found = {}
    for line in LINES:
        name, arguments = parsed(line)
        if name in QUICK and "-m" not in arguments:
            found.setdefault(name, line)
    return list(found.values())


@pytest.mark.nightly
@pytest.mark.parametrize("line", quick())
def test_a_line_of_each_quick_command_runs(line, place, monkeypatch, capfd):
    run_line(line, place, monkeypatch)


OTHERS = [line for line in LINES if parsed(line)[0] in COMMANDS and parsed(line)[0] != "train" and line not in quick()]


@pytest.mark.parametrize("line", OTHERS)
def test_the_settings_of_a_line_are_known(line, place, monkeypatch, capsys):
    """The nightly tests run them in full."""
    monkeypatch.chdir(place)
    name, arguments = parsed(line)
    if name == "ros":
        assert parse(RosSettings, arguments)  # it runs without Hydra
        return
    assert command(name, *arguments, "--cfg", "job") == 0
    shown = OmegaConf.create(capsys.readouterr().out)
    for argument in arguments:
        key, _, value = argument.partition("=")
        found = OmegaConf.select(shown, key.lstrip("+"))
        # An option of a group brings keys of its own.
        assert isinstance(found, DictConfig) or found == yaml.safe_load(value), argument


@pytest.mark.nightly
@pytest.mark.parametrize("line", LINES)
def test_a_command_runs(line, place, monkeypatch, capfd):
    run_line(line, place, monkeypatch)


TRAININGS = [line for line in LINES if parsed(line)[0] == "train" and "-m" not in parsed(line)[1]]


@pytest.mark.parametrize("line", [line for line in TRAININGS if line not in quick()][::5])
def test_a_training_can_begin(line, place, monkeypatch):
    """Begin every fifth one; the nightly tests run all."""
    monkeypatch.chdir(place)
    _, arguments = parsed(line)
    skip_what_is_not_here(arguments)
    arguments += small("train", arguments)
    begin_from(arguments, place)
    assert answered("train", *arguments) == 0


def skip_what_is_not_here(arguments):
    """Skip a line whose robot cannot be had without its package or a network."""
    if "robot=go2" in arguments:
        try:
            find_source(build(composed("robot=go2")).robot)
        except RobotError as error:
            if "pip install" not in str(error) and "cannot be downloaded" not in str(error):
                raise
            pytest.skip(str(error))


def run_line(line, place, monkeypatch):
    monkeypatch.chdir(place)
    name, arguments = parsed(line)
    for package in NEEDS.get(name, []):
        pytest.importorskip(package)
    if name == "ros":
        pytest.skip("tests/bridge/test_ros.py runs it")
    skip_what_is_not_here(arguments)
    launcher = next((word.partition("=")[2] for word in arguments if word.startswith("hydra/launcher=")), "")
    if launcher in ("ray", "submitit"):
        pytest.skip("tests/training/test_launchers.py runs it")
    arguments += small(name, arguments)
    if name == "view":
        call = [sys.executable, "-m", "gctd3.view", *arguments, "port=0", "browser=false"]
        with subprocess.Popen(call, stdout=subprocess.PIPE, text=True) as shown:
            said = shown.stdout.readline()
            shown.kill()
        assert "http://localhost:" in said
    elif name in COMMANDS:
        begin_from(arguments, place)
        before = set(place.rglob("*"))
        # The tiny run does not walk, which a check in another engine says by its exit code.
        assert command(name, *arguments) in ((1,) if name == "crosscheck" else (0,))
        out = [word.partition("=")[2] for word in arguments if word.startswith("out=")]
        assert all((place / file).exists() for file in out)
        # These print.
        assert out or name in ("evaluate", "crosscheck") or set(place.rglob("*")) - before
    else:
        script = [str(ROOT / name)] if name else ["-m", "gctd3"]
        subprocess.run([sys.executable, *script, *arguments], check=True)
