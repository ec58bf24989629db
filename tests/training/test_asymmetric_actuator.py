"""A robot with an actuator that has no mirror partner trains without the mirror, on every backend."""

import json
import re

import numpy as np
import pytest
from running import command, rows, tiny, train
from thinned import parametrize

from gctd3.robots.mjcf import find_mjcf
from gctd3.robots.settings import RobotSettings

TAIL = '<body name="tail" pos="-0.05 0 0"><joint name="tail" axis="0 1 0" range="-1 1" armature="0.01" damping="0.1"/>'
TAIL += '<geom type="capsule" fromto="0 0 0 -0.1 0 0" size="0.01" mass="0.1" contype="0" conaffinity="0"/></body>'


def without_one(text):
    """Take the actuator off the left ankle."""
    less, count = re.subn(r'<position name="ankle_left"[^>]*/>', "", text)
    assert count == 1
    return less


def with_one_more(text):
    """Add a tail, whose joint is its own image, and its actuator."""
    more, count = re.subn(r'(<body name="thigh_right")', rf"{TAIL}\1", text)
    assert count == 1
    return more.replace("</actuator>", '<position name="tail" joint="tail" kp="5" ctrlrange="-1 1"/></actuator>')


CHANGES = {"one less": (without_one, 5), "one more": (with_one_more, 7)}


@pytest.fixture(scope="module", params=["one less", pytest.param("one more", marks=pytest.mark.nightly)])
def case(request, tmp_path_factory):
    change, actions = CHANGES[request.param]
    path = tmp_path_factory.mktemp("asymmetric") / "asymmetric.xml"
    path.write_text(change(find_mjcf("biped").read_text()))
    return path, actions


@parametrize(
    4,
    ("mirror", "backend"),
    [
        ("auto", "batched"),
        ("false", "dm_control"),
        ("false", "batched"),
        ("auto", "dm_control"),
    ],
)
def test_it_trains_and_is_evaluated(tmp_path, case, mirror, backend):
    path, actions = case
    run = tmp_path / "run"
    train(run, f"robot.name={path}", f"replay.mirror={mirror}", f"env.backend={backend}")
    assert [row["frames"] for row in rows(run)] == ["80", "160", "240"]
    assert len(RobotSettings(str(path)).load().actuated) == actions
    assert command("evaluate", f"run={run}", "episodes=2", "threads=1") == 0
    assert np.isfinite(json.loads((run / "evaluation.json").read_text())["return_mean"])


def test_the_mirror_is_refused_where_it_is_asked_for(tmp_path, capsys):
    """On a free base a leg without one of its actuators moves otherwise than its mirror image."""
    path = tmp_path / "less.xml"
    less, count = re.subn(r'<position name="hip_front_right"[^>]*/>', "", find_mjcf("quadruped").read_text())
    assert count == 1
    path.write_text(less)
    for asked in ("replay.mirror=true", "network=equivariant"):
        given = tiny(tmp_path / "run", "robot=quadruped", f"robot.name={path}", asked, without=["network.hidden"])
        assert command("train", *given) == 2
        error = capsys.readouterr().err
        assert "does not move alike" in error and "Traceback" not in error and "\n" not in error.strip()
    assert not (tmp_path / "run").exists()
