"""Requirements: they resolve on every Python, and what is missing or broken is named with its cure."""

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from running import command

import gctd3.config.requirements
from gctd3.config.requirements import check_dm_control, requirement, why_no_mujoco
from gctd3.errors import PackageError

ROOT = Path(__file__).parents[2]
PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
# How mujoco 4 looks after pip put it over mujoco 3: its front door, and nothing behind it.
HALF = """
try:
    import mujoco._specs
except ModuleNotFoundError as error:
    raise ImportError("The 'mujoco' package is installed, but its core bindings are missing. Repair it.") from error
"""


def test_pythons_are_those_of_the_classifiers():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert tuple(re.findall(r"Programming Language :: Python :: (3\.\d+)", text)) == PYTHONS
    assert f'requires-python = ">={PYTHONS[0]}"' in text


def test_the_version_is_one():
    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", cited, flags=re.M)[1] == gctd3.__version__
    changes = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.M)
    assert changes[:2] == ["Unreleased", gctd3.__version__]


def test_a_requirement_is_that_of_this_python(monkeypatch):
    declared = [
        "mujoco<4,>=3.17; python_version < '3'",
        "mujoco!=4.0.0,>=3.17; python_version >= '3'",
        "x; extra == 'x'",
    ]
    monkeypatch.setattr(gctd3.config.requirements, "requires", lambda _: declared)
    assert set(requirement("mujoco").removeprefix("mujoco").split(",")) == {"!=4.0.0", ">=3.17"}
    assert requirement("x") == "x" and requirement("unheard_of") == "unheard_of"


@pytest.fixture
def without_dm_control(monkeypatch):
    """Let no import find dm_control, and forget the module that needs it."""
    monkeypatch.setitem(sys.modules, "dm_control", None)
    monkeypatch.delitem(sys.modules, "gctd3.envs.dmc", raising=False)


@pytest.mark.parametrize(
    "python, cure", [((3, 13), "available up to Python 3.12, and this is 3.13."), ((3, 12), "pip ")]
)
def test_a_missing_dm_control_is_named_with_its_cure(without_dm_control, monkeypatch, python, cure):
    monkeypatch.setattr(gctd3.config.requirements.sys, "version_info", (*python, 0))
    with pytest.raises(PackageError, match="it needs dm_control, which is not installed: ") as error:
        check_dm_control("it")
    assert cure in str(error.value) and "\n" not in str(error.value)


def test_what_needs_dm_control_says_so(without_dm_control, tmp_path, capsys):
    with pytest.raises(ImportError, match="needs dm_control, which is not installed"):
        importlib.import_module("gctd3.envs.dmc")
    for asked in ("env.backend=dm_control", "task=walker_walk"):
        run = tmp_path / "run"
        assert command("train", asked, f"hydra.run.dir={run}") == 2
        error = capsys.readouterr().err
        assert "needs dm_control, which is not installed" in error and error.count("\n") == 1
        assert not run.exists()


@pytest.mark.dm_control
def test_a_dm_control_that_does_not_fit_is_named(monkeypatch):
    def broken(name):
        raise AttributeError("flex_vertedge")

    monkeypatch.setattr(gctd3.config.requirements, "import_module", broken)
    with pytest.raises(
        PackageError, match=r"dm_control [\d.]+ cannot be imported with mujoco [\d.]+ \(flex_vertedge\)"
    ):
        check_dm_control("it")


def test_an_upgrade_of_mujoco_in_place_is_recognised(tmp_path):
    (tmp_path / "mujoco").mkdir()
    (tmp_path / "mujoco" / "__init__.py").write_text(HALF)
    place = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    seen = {**os.environ, "PYTHONPATH": place}
    for line in (["-m", "gctd3.graph", f"out={tmp_path / 'graph.svg'}"], ["-c", "import gctd3; gctd3.Robot"]):
        result = subprocess.run([sys.executable, *line], capture_output=True, text=True, env=seen, cwd=tmp_path)
        last = result.stderr.strip().splitlines()[-1]
        assert result.returncode != 0
        assert "pip uninstall -y mujoco mujoco-core mujoco-studio, then pip install 'mujoco" in last
        assert last.endswith("(No module named 'mujoco._specs').")
    help_ = subprocess.run([sys.executable, "-m", "gctd3.graph", "--help"], capture_output=True, text=True, env=seen)
    assert help_.returncode == 0 and "Keys" in help_.stdout
    assert why_no_mujoco(ImportError("of something else")) is None


@pytest.mark.nightly
@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("platform", ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu", "macos", "windows"])
def test_requirements_resolve(python, platform, tmp_path):
    """A resolver that honours markers finds wheels of everything that is not pure Python; see docs/install.md."""
    if shutil.which("uv") is None:
        pytest.skip("pip install uv")
    found = subprocess.run(
        # Hydra's parser is the one package without a wheel.
        ["uv", "pip", "compile", "-q", "--no-annotate", "--no-header", f"--python-version={python}",
         f"--python-platform={platform}", "--only-binary=:all:", "--no-binary=antlr4-python3-runtime",
         str(ROOT / "pyproject.toml")],
        capture_output=True, text=True, cwd=tmp_path, env={**os.environ, "MACOSX_DEPLOYMENT_TARGET": "14.0"},
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    pins = dict(line.split("==") for line in found.stdout.splitlines())
    old = tuple(map(int, python.split("."))) < (3, 13)
    assert ("dm-control" in pins) == old == ("labmaze" in pins)
    assert not old or pins["mujoco"].startswith("3.")
    assert pins["mujoco"] != "4.0.0" and "rliable" not in pins and "pandas" not in pins
