"""The options of robots that people own: settings alone, each of which is valid and in the pages' table."""

import re
from fnmatch import fnmatchcase
from pathlib import Path

import mujoco
import pytest
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from gctd3 import RobotSettings, TrainSettings
from gctd3.config.build import build
from gctd3.robots.load import read_spec
from gctd3.robots.sources import DESCRIPTION, MENAGERIE, find_place, is_installed, package_of, pip_name

ROOT = Path(__file__).parents[2]
OPTIONS = {file.stem: OmegaConf.load(file) for file in sorted((ROOT / "conf/robot").glob("*.yaml"))}
OWNED = {name: option for name, option in OPTIONS.items() if "sources" in option.get("robot", {})}
ON_TWO_LEGS = ("apollo", "berkeley_humanoid", "cassie", "g1", "h1", "n1", "op3", "t1", "talos")
ROWS = re.findall(
    r"^\| `(\w+)` \| ([^|]+) \| ([^|]+) \|$",
    (ROOT / "docs/your-robot.md").read_text(encoding="utf-8"),
    flags=re.MULTILINE,
)


def robot_of(name):
    robot: RobotSettings = build(OmegaConf.merge({"_target_": "gctd3.RobotSettings"}, OWNED[name].robot))
    return robot


def test_each_is_settings_of_a_robot_alone():
    assert len(OWNED) > 20
    for name, option in OWNED.items():
        # What a training of such a robot asks for is in one place, but for the price of feet that slide.
        assert set(option) - ({"reward"} if name in ("b2", "go1") else set()) == {"defaults", "robot"}
        robot = robot_of(name)
        assert option.defaults == ["free_biped" if name in ON_TWO_LEGS else "free", "_self_"]
        assert robot.name == name and robot.takes_a_source and all(map(package_of, robot.sources))


def test_the_table_names_each_and_its_packages():
    listed = {name: packages.split(", ") for name, _, packages in ROWS if name in OWNED}
    packages = {name: list(map(pip_name, map(package_of, robot_of(name).sources))) for name in OWNED}
    assert listed == packages


def test_an_option_composes():
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        settings: TrainSettings = build(OmegaConf.masked_copy(composed := compose("config", ["robot=g1"]), [*composed]))
    assert settings.robot == robot_of("g1")
    # With the settings of a free base.
    assert settings.task.features["angle"].from_home and "long_contact" not in settings.reward.terms
    assert settings.exploration.learning_starts == OPTIONS["free_biped"].exploration.learning_starts
    assert settings.exploration.warmup == OPTIONS["free"].exploration.warmup


def test_patterns_fit_the_files_that_are_installed():
    seen = 0
    for name in OWNED:
        robot, unused = robot_of(name), None
        for place in robot.sources:
            # What has to be downloaded is left alone.
            if place.startswith((f"{MENAGERIE}:", f"{DESCRIPTION}:")) or not is_installed(package_of(place)):
                continue
            spec, _, _ = read_spec(find_place(place), robot)
            joints = [joint.name for joint in spec.joints if int(joint.type) != mujoco.mjtJoint.mjJNT_FREE]
            fitting = {
                pattern: [j for j in joints if fnmatchcase(j, pattern)] for pattern in (*robot.hold, *robot.servos)
            }
            assert all(fitting[pattern] for pattern in robot.hold), f"{place}: {fitting}"
            # Two files of a robot may name its joints in two ways.
            empty = {pattern for pattern in robot.servos if not fitting[pattern]}
            unused = empty if unused is None else unused & empty
            if robot.servos:
                assert set(joints) == {joint for found in fitting.values() for joint in found}, place
            seen += 1
        assert not unused or len(robot.sources) > 1, f"{name}: {unused}"
    if not seen:
        pytest.skip("no robot is installed: pip install 'gctd3[robots]'")
