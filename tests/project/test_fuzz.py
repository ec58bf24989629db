"""Any command line or file ends in success or one clean error, without hang, crash or files elsewhere.

A fast part by default; the long form with ``pytest -m nightly tests/project/test_fuzz.py``.
"""

import re
import selectors
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from configs import composed, items
from fuzzing import answered, clean, damages, fresh, tree
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from running import tiny

from gctd3.files import load_tree, read_manifest
from gctd3.runs.load import load_policy
from gctd3.training.checkpoint import Checkpoints
from gctd3.training.saved_configuration import CONFIG, OVERRIDES, load_settings

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def run(finished):
    return finished["gctd3"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


KEYS = sorted(key for key, _ in items(composed()) if key != "resume")
VALUES = st.one_of(
    st.integers(-3, 3),
    st.sampled_from([10**6, 2**31, 2**32, 2**63, 2**64, 10**30, -(10**30), 10**400]),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from(["null", "true", "[]", "{}", "[1,2]", "[[1]]", "{a:1}", "{a:{b:{c:[1,{d:2}]}}}", "''", "???"]),
    st.sampled_from(["${seed}", "${nowhere}", "${oc.env:HOME}", "${", "}{", "[", "a,b", "range(3)", "1e999", "0x10"]),
    st.sampled_from(["{" * 40 + "}" * 40, "[" * 40 + "]" * 40, "ü", "机器人", "\\", "a b", "=", "a=b", "~", "@", "-"]),
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=8),
)
WORDS = st.text("abcdefgh._+~@/=", min_size=1, max_size=10)
OVERRIDE = st.one_of(
    st.tuples(st.sampled_from(KEYS), VALUES).map(lambda pair: f"{pair[0]}={pair[1]}"),
    st.tuples(st.sampled_from(KEYS), VALUES).map(lambda pair: f"+{pair[0]}.x={pair[1]}"),
    st.sampled_from(KEYS).map(lambda key: f"~{key}"),
    st.tuples(WORDS, VALUES).map(lambda pair: f"{pair[0]}={pair[1]}"),
    st.tuples(st.sampled_from(["algo", "robot", "network", "replay", "reward", "task"]), VALUES).map(
        lambda pair: f"{pair[0]}={pair[1]}"
    ),
).filter(lambda text: not text.startswith("-"))


def check_overrides(here, overrides):
    shutil.rmtree(here / "run", ignore_errors=True)
    before = tree(here)
    answered("train", *tiny(here / "run"), *overrides)
    new = [path for path in tree(here) - before if not path.startswith(str(here / "run"))]
    assert not new


CONFIG_DAMAGE = st.one_of(damages(), st.integers(0, 10**6), st.tuples(st.integers(0, 10**6), VALUES))


def check_config(run, here, change, which):
    broken = fresh(run, here / "broken")
    file = broken / (OVERRIDES if which == 0 else CONFIG)
    if callable(change):
        file.write_bytes(change(file.read_bytes()))
    elif which:
        content = yaml.safe_load(file.read_text())
        number, value = change if isinstance(change, tuple) else (change, None)
        names = [name for name, _ in items(content)]
        *path, last = names[number % len(names)].split(".")
        node = content
        for part in path:
            node = node[part]
        if isinstance(change, tuple):
            node[last] = value
        else:
            del node[last]
        file.write_text(yaml.safe_dump(content))
    before = tree(here)
    clean(lambda: load_settings(broken))
    # A changed one is composed anew from the command line that the run began with.
    answered("train", f"resume={broken}", *(["total_frames=400"] if which == 0 else []))
    assert all(path.startswith(str(broken)) for path in tree(here) - before)


def check_files(run, here, number, damage, number_too, kind):
    broken = fresh(run, here / "broken")
    files = sorted(path for path in broken.rglob("*") if path.is_file() and "hydra" not in str(path))
    file, other = files[number % len(files)], files[number_too % len(files)]
    if kind == "damage":
        file.write_bytes(damage(file.read_bytes()))
    elif kind == "missing":
        file.unlink()
    elif kind == "swapped" and file != other:
        first, second = file.read_bytes(), other.read_bytes()
        file.write_bytes(second)
        other.write_bytes(first)
    elif kind == "a directory":
        file.unlink()
        file.mkdir()
    if file.suffix == ".safetensors":
        clean(lambda: load_tree(file))
    if file.name == "manifest.json":
        clean(lambda: read_manifest(file.parent))
    clean(lambda: load_policy(broken))
    clean(lambda: Checkpoints(broken).newest())
    answered("train", f"resume={broken}")


def delete_some(text, numbers):
    """Delete some elements and attributes."""
    for number in numbers:
        pieces = list(re.finditer(r'<\w[^<>]*/>|\s\w+="[^"]*"|</?\w+[^<>]*>', text))
        piece = pieces[number % len(pieces)] if pieces else None
        if piece is not None:
            text = text[: piece.start()] + text[piece.end() :]
    return text


class Worker:
    """Read robots in a process that is started anew when MuJoCo ends it."""

    def __init__(self):
        self.process, self.crashes = None, 0

    def ask(self, file):
        if self.process is None:
            self.process = subprocess.Popen(
                [sys.executable, str(Path(__file__).parents[1] / "mjcf_worker.py")],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                cwd=file.parent,
            )
        self.process.stdin.write(f"{file}\n")
        self.process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(self.process.stdout, selectors.EVENT_READ)
            if not selector.select(60):
                self.close()
                pytest.fail(f"no answer about {file.read_bytes()!r}")
        line = self.process.stdout.readline().strip()
        if not line:
            self.close()
            self.crashes += 1
            return "crash"
        return line

    def close(self):
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None


@pytest.fixture(scope="module")
def worker():
    worker = Worker()
    yield worker
    worker.close()
    # MuJoCo's own; a number, so that it does not go unseen.
    print(f"MuJoCo's compiler ended its process {worker.crashes} times")


def check_mjcf(worker, here, robot, change):
    file = here / "fuzzed.xml"
    if callable(change):
        file.write_bytes(change(robot.path.read_bytes()))
    else:
        file.write_text(delete_some(robot.path.read_text(), change))
    answer = worker.ask(file)
    assert answer in ("ok", "error RobotError", "error ConfigError", "crash"), answer


MJCF_CHANGE = st.one_of(damages(), st.lists(st.integers(0, 10**6), min_size=1, max_size=4))
KIND = st.sampled_from(["damage", "damage", "damage", "missing", "swapped", "a directory"])
NUMBER = st.integers(0, 10**6)


def cases(count):
    return settings(max_examples=count, suppress_health_check=list(HealthCheck), database=None)


def both(fast, long):
    """Return marks of the fast and the long form."""
    return pytest.mark.parametrize("count", [fast, pytest.param(long, marks=pytest.mark.nightly)])


@both(6, 350)
def test_command_lines(here, count):
    cases(count)(
        given(st.lists(OVERRIDE, min_size=1, max_size=3))(lambda overrides: check_overrides(here, overrides))
    )()


@pytest.mark.nightly
@both(3, 120)
def test_configurations_of_runs(run, here, count):
    cases(count)(
        given(CONFIG_DAMAGE, st.integers(0, 3))(lambda change, which: check_config(run, here, change, which))
    )()


@pytest.mark.nightly
@both(3, 150)
def test_files_of_runs(run, here, count):
    cases(count)(
        given(NUMBER, damages(), NUMBER, KIND)(
            lambda number, damage, other, kind: check_files(run, here, number, damage, other, kind)
        )
    )()


@both(60, 700)
def test_mjcf_files(worker, here, robot, count):
    cases(count)(given(MJCF_CHANGE)(lambda change: check_mjcf(worker, here, robot, change)))()
