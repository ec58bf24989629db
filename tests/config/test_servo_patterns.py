"""Servos are set by patterns of joints on the command line, as the messages about them say."""

import re

import pytest
from running import command

YAML = """# @package _global_
# The quadruped with other knees and hips.
defaults:
  - quadruped
  - _self_

robot:
  servos:
    "knee*": {_target_: gctd3.ServoSettings, stiffness: 40.0, damping: 3.0}
    "hip*": {_target_: gctd3.ServoSettings, stiffness: 60.0, damping: 9.0}
"""


@pytest.fixture
def graph(tmp_path, monkeypatch, capsys):
    """Return a function that asks for the graph of that robot, and returns exit code, output and error."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "own.yaml").write_text(YAML)

    def ask(*arguments, robot="own"):
        code = command("graph", "--config-dir", str(tmp_path), f"robot={robot}", "out=null", *arguments)
        return code, *capsys.readouterr()

    return ask


def gains(said):
    """Return the joints and the stiffnesses of each note on servos."""
    return re.findall(r"servos? of ([\w, ]+) (?:are|is) .*?stiffness ([\d.]+(?: to [\d.]+)?)", said)


def test_gains_of_a_pattern_need_no_target(graph):
    code, said, _ = graph("+robot.servos={hip*:{stiffness:55,damping:9}}", robot="quadruped")
    ((joints, stiffness),) = gains(said)
    assert code == 0 and stiffness == "55" and joints.startswith("hip_") and "knee" not in joints


def test_a_pattern_is_changed_left_out_and_added(graph):
    assert gains(graph()[1])[0][1] == "40 to 60"
    assert gains(graph("robot.servos={knee*:{stiffness:45}}")[1])[0][1] == "45 to 60"
    ((joints, stiffness),) = gains(graph("robot.servos={knee*:null}")[1])
    assert stiffness == "60" and "knee" not in joints
    added = graph("+robot.servos={ankle*:{stiffness:70,damping:1}}")
    assert gains(added[1])[0][1] == "40 to 70"


def test_what_a_message_proposes_is_accepted(graph):
    code, _, error = graph("robot.servos={}")
    proposed = re.findall(r"'(robot\.servos=[^']+)'", error)
    assert code == 2 and len(proposed) == 2
    assert graph(*proposed)[0] == 0
    code, _, error = graph("robot.servos={elbow*:{stiffness:70}}")
    assert code == 2 and error.rstrip().endswith("A new one is added by +robot.servos=...")


def test_a_wrong_key_of_a_pattern_is_named(graph):
    code, _, error = graph("+robot.servos={ankle*:{stiff:70}}")
    assert code == 2 and "Unknown key 'robot.servos.ankle*.stiff'. Did you mean" in error
    code, _, error = graph("+robot.servos={ankle*:7}")
    assert code == 2 and "robot.servos must be a mapping to a ServoSettings" in error and error.count("\n") == 1
