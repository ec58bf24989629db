"""The defaults of dataclasses complete every YAML: for every choice, in every process and for other projects."""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml
from configs import composed
from hydra import compose, initialize_config_module
from hydra.errors import ConfigCompositionException
from omegaconf import OmegaConf
from running import command, tiny

from gctd3.config.build import build
from gctd3.config.completion import complete
from gctd3.config.fields import defaults_of, in_plain_text, in_yaml, meanings, name_of, settings_of
from gctd3.config.help import COMMANDS
from gctd3.errors import ConfigError, RunError
from gctd3.training.saved_configuration import changed, load_settings
from gctd3.training.settings import TrainSettings


@dataclass(frozen=True)
class Inner:
    """Hold settings that are a field of other settings.

    Attributes:
        size: How many (1).
        other: Not said in YAML.
    """

    size: int = 1
    other: float = 2.0


@dataclass(frozen=True)
class Mine:
    """Hold settings that are not gctd3's.

    Attributes:
        must: Has no default,
            on two lines.
        inner: Settings, of which the default is not that of their class; ``None`` for
            none (:class:`.Inner`).
        items: A list.

    Other:
        nothing: no attribute.
    """

    must: str
    inner: Inner | None = field(default_factory=lambda: Inner(size=5))
    items: tuple[int, ...] = (1, 2)


MINE = f"{__name__}.Mine"
CONF = Path(__file__).parents[2] / "conf"


def completed(plain):
    config = OmegaConf.create(plain)
    complete(config, ours=True)
    return OmegaConf.to_container(config)


# Reading a dataclass.


def test_defaults_and_meanings_of_a_dataclass():
    inner = {"_target_": f"{__name__}.Inner", "size": 5, "other": 2.0}
    assert defaults_of(Mine) == {"must": "???", "inner": inner, "items": [1, 2]}
    assert [setting.name for setting in settings_of(Mine)] == ["must", "inner", "items"]
    assert list(meanings(Mine)) == ["must", "inner", "items"]
    assert meanings(Mine)["must"] == "Has no default, on two lines."
    assert in_plain_text(meanings(Mine)["inner"]).endswith("not that of their class; null for none (Inner).")


def test_a_base_says_what_its_fields_mean_unless_its_heir_does():
    settings = {setting.name: setting for setting in settings_of(type(build(composed("collector=ray")).collector))}
    assert settings["workers"].meaning.startswith("Workers") and settings["timeout"].meaning.startswith("Time")
    assert (settings["chunk"].default, settings["address"].default) == (8, None)


def test_names_are_those_of_the_front_door():
    assert in_yaml(build(composed()).robot)["_target_"] == "gctd3.RobotSettings"
    assert name_of(Mine) == MINE


@dataclass(frozen=True)
class Terms:
    """Hold terms by name, and other settings in a mapping that is no list of terms.

    Attributes:
        terms: Terms.
        plain: A mapping.
    """

    BY_NAME: ClassVar[tuple[str, ...]] = ("terms",)

    terms: Mapping[str, Any] = field(default_factory=lambda: {"a": Inner(3), "b": Inner(4, 5.0), "c": Mine("x")})
    plain: Mapping[str, Any] = field(default_factory=lambda: {"a": Inner(3)})


@dataclass(frozen=True)
class Outer:
    """Hold a term that has terms of its own.

    Attributes:
        terms: Terms.
    """

    BY_NAME: ClassVar[tuple[str, ...]] = ("terms",)

    terms: Mapping[str, Any] = field(default_factory=lambda: {"t": Terms()})


# Completing a configuration.


def test_what_is_missing_is_added_and_what_is_said_is_kept():
    said = {"_target_": MINE, "must": "x", "inner": {"size": 7}, "items": []}
    full = completed(said)
    assert full == {**said, "inner": {"_target_": f"{__name__}.Inner", "size": 7, "other": 2.0}}
    assert build(full) == Mine("x", Inner(7), ())
    assert completed({"_target_": MINE})["must"] == "???"
    assert completed({"_target_": MINE, "must": "???", "inner": None})["inner"] is None
    assert completed({"list": [{"_target_": MINE, "must": "x"}]})["list"][0]["items"] == [1, 2]


def test_terms_by_name_are_completed_name_by_name():
    """Numbers of a term are the default's unless the YAML gives them or another class; its own names stand last."""
    inner, mine = f"{__name__}.Inner", defaults_of(Mine)
    b = {"size": "${n}"}
    said = {"_target_": f"{__name__}.Terms", "terms": {"d": {"_target_": inner}, "b": b, "a": None}, "plain": {}}
    config = OmegaConf.create({"n": 7, "settings": said})
    complete(config, ours=True)
    full = OmegaConf.to_container(config.settings, resolve=True)
    assert list(full["terms"]) == ["a", "b", "c", "d"] and full["plain"] == {}
    assert full["terms"] == {
        "a": None,
        "b": {"_target_": inner, "size": 7, "other": 5.0},
        "c": {**mine, "_target_": MINE, "must": "x"},
        "d": {"_target_": inner, "size": 1, "other": 2.0},
    }
    other = completed({**said, "terms": {"c": {"_target_": inner}, "b": {"_target_": inner, "size": 6}}})["terms"]
    assert other["c"] == {"_target_": inner, "size": 1, "other": 2.0}
    assert other["b"] == {"_target_": inner, "size": 6, "other": 5.0}
    assert completed({**said, "terms": None})["terms"] is None
    # A mapping that is a term's number is the YAML's as it stands.
    listed = {"_target_": f"{__name__}.Terms", "terms": {"e": {"plain": {"b": {"_target_": inner}}}}}
    outer = completed({"_target_": f"{__name__}.Outer", "terms": {"t": listed}})["terms"]["t"]
    assert list(outer["terms"]) == ["a", "b", "c", "e"]
    nested = completed({"_target_": f"{__name__}.Outer", "terms": {"t": {"plain": {"b": {"_target_": inner}}}}})
    assert list(nested["terms"]["t"]["plain"]) == ["b"] and list(nested["terms"]["t"]["terms"]) == ["a", "b", "c"]


def test_what_is_to_be_resolved_later_is_left_alone():
    said = {"a": "${b}", "b": {"_target_": MINE, "must": "${nowhere}", "inner": "${c}"}, "c": {"_target_": "${d}"}}
    config = OmegaConf.create(said)
    complete(config, ours=True)
    full = OmegaConf.to_container(config, resolve=False)
    assert full == {**said, "b": {**said["b"], "items": [1, 2]}}


def test_only_what_is_gctd3s_and_below_is_completed():
    plain = {"theirs": {"_target_": MINE}, "train": {"_target_": "gctd3.TrainSettings", "algo": {"_target_": MINE}}}
    config = OmegaConf.create({**plain, "hydra": {"_target_": "gctd3.Network"}})
    complete(config)
    full = OmegaConf.to_container(config)
    assert full["theirs"] == plain["theirs"] and full["hydra"] == {"_target_": "gctd3.Network"}
    assert full["train"]["algo"]["items"] == [1, 2] and full["train"]["rollout_steps"] == 1


@pytest.mark.parametrize("target", ["gctd3.Networks", "gctd3.nowhere.X", "nowhere.X"])
def test_a_target_that_is_none_is_named(target):
    with pytest.raises(ConfigError, match=f"^algo: _target_ '{target}' cannot be imported: "):
        completed({"algo": {"_target_": target}})


# The command line.


@pytest.mark.nightly
def test_keys_that_no_yaml_holds_are_known():
    settings = build(composed("algo.tau=0.01", "task.randomisations.joint_noise.angle=0", "gradient_steps=7"))
    noise = settings.task.randomisations["joint_noise"]
    assert (settings.algo.tau, noise.angle, settings.gradient_steps) == (0.01, 0, 7)
    assert composed("algo=sac", "algo.alpha=0.5")["algo"]["alpha"] == 0.5
    assert composed("collector=process", "collector.workers=3")["collector"]["workers"] == 3
    assert composed("network=mlp", "network.norm=none")["network"]["graph_layers"] == []
    assert composed("++algo.tau=0.01")["algo"]["tau"] == 0.01
    assert build(composed("~algo.tau")).algo.tau == 0.005
    assert composed("gradient_steps=${rollout_steps}", "rollout_steps=3")["gradient_steps"] == 3


@pytest.mark.parametrize(
    "argument", ["algo.tua=0.01", "algo.alpha=0.5", "task.randomisations.joint_noise.angel=0", "update=7"]
)
def test_keys_that_no_settings_hold_are_refused(argument):
    with pytest.raises(ConfigCompositionException, match="Could not override"):
        composed(argument)
    with pytest.raises(ConfigCompositionException, match="An item is already at"):
        composed("+algo.tau=0.01")


def test_a_choice_brings_the_keys_of_its_own_settings_alone():
    td3, sac = composed()["algo"], composed("algo=sac")["algo"]
    assert {*td3} - {*sac} == {"policy_delay", "policy_noise", "noise_clip"}
    assert {*sac} - {*td3} == {"alpha", "scale"}


def test_cfg_job_shows_every_key(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command("train", "algo=sac", "--cfg", "job") == 0
    shown = yaml.safe_load(capsys.readouterr().out)
    assert shown == composed("algo=sac")
    assert not list(tmp_path.iterdir())


# Other ways to compose.

PROJECT = """
import sys
import hydra
from omegaconf import OmegaConf

@hydra.main(version_base="1.3", config_path="conf", config_name="main")
def main(config):
    network, start = config.network, config.task.randomisations.joint_noise
    print(f"{network.norm} {network.hidden} {config.algo.alpha} {start.angle} {config.other.norm}\\n", end="")
    print(OmegaConf.to_yaml(config.own), "torch" in sys.modules)

main()
"""
MAIN = """
defaults:
  - exploration: rhythmic
  - task: walk
  - network: gcn
  - network@other: mlp
  - algo: sac
  - _self_
own:
  _target_: torch.nn.Linear
  in_features: 3
hydra:
  searchpath: [pkg://gctd3.conf]
  run:
    dir: .
  sweep:
    dir: .
  output_subdir: null
"""


@pytest.fixture
def project(tmp_path):
    """Make another project, which finds gctd3's YAMLs by Hydra's search path and imports nothing of gctd3."""
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "main.yaml").write_text(MAIN)
    (tmp_path / "main.py").write_text(PROJECT)

    def run(*arguments):
        call = [sys.executable, "main.py", *arguments, "hydra/job_logging=none", "hydra/hydra_logging=none"]
        return subprocess.run(call, cwd=tmp_path, capture_output=True, text=True)

    return run


@pytest.mark.nightly
def test_another_project_composes_the_same(project):
    done = project("network.norm=none", "task.randomisations.joint_noise.angle=0.5", "other.norm=none")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "none [256, 256] 0.2 0.5 none\n_target_: torch.nn.Linear\nin_features: 3\n False\n"
    assert "network.nrom" in project("network.nrom=none").stderr


@pytest.mark.nightly
@pytest.mark.parametrize("launcher", ["basic", "joblib"])
def test_another_projects_sweep_composes_the_same(project, launcher):
    if launcher == "joblib":
        pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    done = project("-m", f"hydra/launcher={launcher}", "network.norm=none,layer", "algo.alpha=1")
    assert done.returncode == 0, done.stderr
    assert sorted(line for line in done.stdout.splitlines() if "256" in line) == [
        f"{norm} [256, 256] 1 0.05 layer" for norm in ("layer", "none")
    ]


OWN = '''
from dataclasses import dataclass
from gctd3.algorithms.settings import TD3Settings

@dataclass(frozen=True)
class MySettings(TD3Settings):
    """Set an outsider's algorithm.

    Attributes:
        beta: Its own.
    """

    policy_delay: int = 3
    beta: float = 0.25
'''


@pytest.mark.nightly
def test_settings_from_outside_the_package(tmp_path, monkeypatch, capsys):
    (tmp_path / "own" / "algo").mkdir(parents=True)
    (tmp_path / "own" / "algo" / "mine.yaml").write_text("_target_: my_package.MySettings\ngamma: 0.9\n")
    (tmp_path / "my_package.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    own = ["--config-dir=own", "algo=mine"]
    assert command("train", *own, "algo.betta=1") == 2
    assert "Unknown key 'algo.betta'. Did you mean 'algo.beta'?" in capsys.readouterr().err
    assert command("train", *own, "algo.beta=high") == 2
    assert "algo.beta must be a number, got 'high'." in capsys.readouterr().err
    assert command("train", *tiny(tmp_path / "run", *own, "algo.tau=0.5")) == 0
    algo = load_settings(tmp_path / "run").algo
    assert (type(algo).__name__, algo.beta, algo.policy_delay, algo.gamma, algo.tau) == (
        "MySettings",
        0.25,
        3,
        0.9,
        0.5,
    )
    monkeypatch.delitem(sys.modules, "my_package")
    (tmp_path / "my_package.py").unlink()
    assert command("train", *own) == 2
    assert "algo: _target_ 'my_package.MySettings' cannot be imported: No module named" in capsys.readouterr().err


# Runs.


def test_a_run_keeps_every_key_and_goes_on_with_keys_that_no_yaml_holds(finished):
    run = finished["gctd3"]
    # A key of its command line that no YAML of it holds.
    assert "gradient_steps" not in (CONF / "config.yaml").read_text(encoding="utf-8")
    assert load_settings(run).gradient_steps == 2
    saved = yaml.safe_load((run / ".hydra" / "config.yaml").read_text(encoding="utf-8"))
    assert saved == {**saved, **{key: saved[key] for key in composed()}} and saved["algo"]["gamma"] == 0.99
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        assert changed(run, "config", ["keep_checkpoints=3"])[0].keep_checkpoints == 3
        with pytest.raises(RunError, match=r"gradient_steps: 2 -> 3"):
            changed(run, "config", ["gradient_steps=3"])


def test_a_run_does_not_say_where_yamls_are(finished, tmp_path):
    """A run's own search path is ignored: modules would be imported from it, and the run may be somebody else's."""
    run = finished.copy("gctd3", tmp_path / "run")
    (tmp_path / "theirs" / "network").mkdir(parents=True)
    (tmp_path / "theirs" / "network" / "trap.yaml").write_text("_target_: sprung.Trap\n")
    overrides = run / ".hydra" / "overrides.yaml"
    traps = [f"hydra.searchpath=[file://{tmp_path / 'theirs'}]", "network=trap"]
    overrides.write_text(overrides.read_text(encoding="utf-8") + "".join(f"- {trap}\n" for trap in traps))
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        assert changed(run, "config", ["keep_checkpoints=3"])[0].keep_checkpoints == 3


# Cost of the imports.


def test_settings_import_no_torch():
    code = (
        "import sys, gctd3.training.settings\n"
        "from hydra import compose, initialize_config_module\n"
        "from gctd3.config.build import build\n"
        "with initialize_config_module('gctd3.conf', version_base='1.3'):\n"
        "    for algo in ('gctd3', 'sac', 'ddpg'):\n"
        "        assert isinstance(build(compose('config', [f'algo={algo}'])), gctd3.training.settings.TrainSettings)\n"
        "print([name for name in ('torch', 'torchrl', 'tensordict', 'dm_control') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("[]\n", "")


@pytest.mark.nightly
def test_a_misspelt_key_is_answered_without_torch(tmp_path):
    """Import the commands one after the other and name the first that imports it."""
    code = (
        "import sys, importlib\n"
        f"for name in {[*COMMANDS]}:\n"
        "    sys.argv = [f'gctd3.{name}', 'sead=1']\n"
        "    try: importlib.import_module(f'gctd3.{name}').main()\n"
        "    except SystemExit as end: print(name, end.code, 'torch' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.splitlines() == [f"{name} 2 False" for name in COMMANDS], done.stderr
    assert done.stderr.count("Unknown key 'sead'.") == len(COMMANDS)
    assert not list(tmp_path.iterdir())


def test_default_settings_are_those_that_hydra_composes():
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        settings = build(compose("config"))
    assert isinstance(settings, TrainSettings)
    assert build(in_yaml(settings)) == settings


ROBOT = """# @package _global_
defaults:
  - {beginning}
  - _self_
robot:
  name: quadruped
task:
  terminations:
    long_contact: null
"""


def test_a_robots_yaml_begins_from_another_by_its_place(tmp_path, monkeypatch, capsys):
    (tmp_path / "own" / "robot").mkdir(parents=True)
    for name, beginning in {"mine": "/robot/biped@robot", "wrong": "biped"}.items():
        (tmp_path / "own" / "robot" / f"{name}.yaml").write_text(ROBOT.format(beginning=beginning))
    monkeypatch.chdir(tmp_path)
    own = ["--config-dir=own", "--cfg", "job"]
    assert command("train", *own, "robot=mine") == 0
    shown = yaml.safe_load(capsys.readouterr().out)
    assert (shown["robot"]["name"], shown["task"]["terminations"]["long_contact"]) == ("quadruped", None)
    assert command("train", *own, "robot=wrong") == 2
    assert "begins from another one by its place, as in '- /robot/biped@robot'" in capsys.readouterr().err
    # What a command completes without a class of its own is no mistake.
    assert command("export", "robot=quadruped", "out=quadruped.sdf", "--cfg", "job") == 0


@pytest.mark.parametrize("terrain", ["rough", "stairs", "boxes", "gaps", "mixed"])
def test_a_training_on_terrain_ends_when_nearly_all_of_it_is_crossed(terrain):
    """Ask for no more than that: the ground changes the periods and heights of steps."""
    settings = build(composed("robot=quadruped", f"terrain={terrain}"))
    crossed = {"success_rate": 0.95, "velocity_mean": 0.5, "stride_hz": 1.5, "flight_fraction": 0.1}
    crossed |= {"torque_saturation": 2.0}
    assert settings.stop_when.all_reached(crossed)
    assert not settings.stop_when.all_reached(crossed | {"success_rate": 0.925})
    assert settings.stop_when.ends_after(1) and settings.stop_when.confirm == 100
    assert settings.evaluation.episodes == 40
