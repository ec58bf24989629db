"""A custom robot trains with settings of its own, from a YAML outside the package."""

import pytest
from fuzzing import answered
from robots import TWO_LEGS, write
from running import command, rows, tiny

from gctd3.training.saved_configuration import load_settings

MINE = """# @package _global_
defaults:
  - biped_planar
  - _self_
robot:
  name: robot.xml
task:
  terminations:
    long_contact:
      steps: null
"""


@pytest.fixture(autouse=True)
def _place(tmp_path, monkeypatch):
    write(tmp_path, TWO_LEGS)
    (tmp_path / "own/robot").mkdir(parents=True)
    (tmp_path / "own/robot/mine.yaml").write_text(MINE)
    monkeypatch.chdir(tmp_path)


WAYS = ["--config-dir=own", "--config-dir own", "-cd own", "hydra.searchpath=[file://{}/own]"]


@pytest.mark.nightly
@pytest.mark.parametrize("way", WAYS)
def test_options_stand_anywhere_among_the_settings(tmp_path, way):
    words = way.format(tmp_path).split(" ")
    # Options on both sides of key=value, which has no prescribed order.
    assert command("train", "algo=td3", *words, *tiny(tmp_path / "run", "robot=mine", "total_frames=80")) == 0
    settings = load_settings(tmp_path / "run")
    ends = settings.task.terminations
    # A setting of its own, one of the planar biped's, and a default.
    tilt = settings.reward.terms["tilt"].weight
    assert (ends["long_contact"].steps, tilt, ends["finish"].distance) == (None, -0.5, 15.0)
    assert settings.robot.name == "robot.xml" and settings.setup().robot.feet == ("leg_r", "leg_l")
    # The run holds the YAML's content, so the YAML may be missing.
    resume = f"resume={tmp_path / 'run'}"
    assert command("train", resume, *words, "total_frames=120") == 0
    (tmp_path / "own").rename(tmp_path / "gone")
    assert command("train", resume, "total_frames=160") == 0
    assert rows(tmp_path / "run")[-1]["frames"] == "160"
    resumed = load_settings(tmp_path / "run")
    assert (resumed.task, resumed.env) == (settings.task, settings.env)


@pytest.mark.nightly
def test_another_robots_settings(tmp_path):
    assert answered("train", *tiny(tmp_path / "run", "robot=biped_planar", "robot.name=robot.xml")) == 0
    settings = load_settings(tmp_path / "run")
    assert settings.robot.name == "robot.xml" and settings.reward.terms["tilt"].weight == -0.5
    assert answered("train", *tiny(tmp_path / "plain", "robot=robot.xml")) == 0
    assert "tilt" not in load_settings(tmp_path / "plain").reward.terms


def test_what_is_no_setting_is_still_refused(tmp_path, capsys):
    assert command("train", "algo=td3", "--no-such-option", "robot=mine") == 2
    assert "--no-such-option" in capsys.readouterr().err
    assert command("train", *tiny(tmp_path / "run", "robot=mine")) == 2
    assert "Could not find 'robot/mine'" in capsys.readouterr().err


@pytest.mark.nightly
def test_a_run_keeps_the_file_that_it_read(tmp_path, monkeypatch):
    """Choose the package that is installed from a list, whatever comes later."""
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    places = ["early_walkers:robot.xml", "late_walkers:robot.xml"]

    def install(name, text):
        (tmp_path / "site" / name).mkdir(parents=True)
        write(tmp_path / "site" / name, text)
        (tmp_path / "site" / name / "__init__.py").touch()

    (tmp_path / "own/robot/walker.yaml").write_text(f"_target_: gctd3.RobotSettings\nname: walker\nsources: {places}\n")
    install("late_walkers", TWO_LEGS)
    assert answered("train", *tiny(tmp_path / "run", "robot=walker", "--config-dir=own")) == 0
    install("early_walkers", "<mujoco/>")
    robot = load_settings(tmp_path / "run").robot
    assert robot.source == places[1] and robot.load().source.file == tmp_path / "site/late_walkers/robot.xml"
    assert answered("train", f"resume={tmp_path / 'run'}", "--config-dir=own") == 0
