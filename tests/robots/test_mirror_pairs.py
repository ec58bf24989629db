"""Joints are paired with their mirror images, and robots without a valid reflection are refused."""

from pathlib import Path

import dm_control.suite
import numpy as np
import pytest
from compositions import walking
from robots import FREE_LEGS, TWO_LEGS, write
from running import command, tiny, train

from gctd3.errors import RobotError
from gctd3.robots.mirror_pairs import swap_side, unreflected
from gctd3.robots.robot import Robot
from gctd3.tasks.reflection import Reflection

CMU = Path(dm_control.suite.__file__).parent / "humanoid_CMU.xml"


def crooked(text):
    """Make two legs without sides, one of which stands farther forward and out."""
    return text.replace("_r", "_a").replace("_l", "_b").replace('pos="0 0.1 0"', 'pos="0.2 0.3 0"')


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("hip_right", "hip_left"),
        ("L_knee", "R_knee"),
        ("thigh", "thigh_left"),
        ("lfemurrx", "rfemurrx"),  # the last r is not a side
        ("RHipYaw", "LHipYaw"),
        ("lowerback", "lowerback"),
        ("root", "root"),
    ],
)
def test_sides_in_names(name, other):
    known = ["hip_right", "hip_left", "L_knee", "R_knee", "thigh", "thigh_left", "lfemurrx", "rfemurrx"]
    known += ["RHipYaw", "LHipYaw", "lowerback", "root"]
    assert swap_side(name, known) == other and swap_side(other, known) == name


def test_a_side_glued_to_a_name_pairs_joints_of_one_kind_only(tmp_path):
    text = FREE_LEGS.replace("hip_r", "rear").replace("hip_l", "lear").replace('pos="0 0.1 0"', 'pos="0.2 0.3 0"')
    assert Robot.from_mjcf(write(tmp_path, text)).mirror == {"rear": "lear", "lear": "rear"}
    slide = text.replace('name="lear" axis', 'type="slide" name="lear" axis')
    assert Robot.from_mjcf(write(tmp_path, slide)).mirror == {"rear": "rear", "lear": "lear"}


def test_every_limb_of_the_cmu_humanoid_has_its_other_side():
    robot = Robot.from_mjcf(CMU)
    trunk = ("lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head")
    for name, other in robot.mirror.items():
        side = {"l": "r", "r": "l"}.get(name[0])
        assert other == (name if name.startswith(trunk) else f"{side}{name[1:]}")
    assert not unreflected(robot.model, robot.joints, robot.mirror, robot.base.frame[1])


@pytest.mark.parametrize("name", ["biped", "biped_planar", "quadruped", "hexapod"])
def test_shipped_robots_are_symmetric(name):
    robot = Robot.from_mjcf(name)
    assert not unreflected(robot.model, robot.joints, robot.mirror, np.array([0.0, 1.0, 0.0]))
    Reflection.from_robot(robot)


def test_joints_off_the_plane_that_are_their_own_image_are_refused(tmp_path):
    robot = Robot.from_mjcf(write(tmp_path, crooked(FREE_LEGS)))
    robot.check_walking()
    assert robot.mirror == {"hip_a": "hip_a", "hip_b": "hip_b"}
    for reflect in (lambda: Reflection.from_robot(robot), lambda: walking(robot).reflection()):
        with pytest.raises(RobotError, match=r"robot\.xml is not the same .*replay\.mirror=false.*: hip_a, hip_b\.$"):
            reflect()


def test_an_axis_that_no_reflection_keeps_is_refused(tmp_path):
    tail = '<body pos="-0.1 0 0"><joint name="tail" axis="0 1 1"/><geom size="0.02"/></body></body></worldbody>'
    text = FREE_LEGS.replace("</body>\n  </worldbody>", tail)
    assert text != FREE_LEGS
    with pytest.raises(RobotError, match=r"the joint of the other side: tail\.$"):
        Reflection.from_robot(Robot.from_mjcf(write(tmp_path, text), feet=["leg_r", "leg_l"]))
    straight = text.replace('axis="0 1 1"', 'axis="1 0 1"')
    Reflection.from_robot(Robot.from_mjcf(write(tmp_path, straight), feet=["leg_r", "leg_l"]))


def test_in_a_plane_it_does_not_matter_where_legs_are_sideways(tmp_path):
    # On a boom two legs move alike wherever they are; each is its own mirror image.
    reflection = Reflection.from_robot(Robot.from_mjcf(write(tmp_path, crooked(TWO_LEGS))))
    assert reflection.action.source.tolist() == [0, 1] and reflection.action.sign.tolist() == [1.0, 1.0]


@pytest.mark.parametrize("asked", [[], ["replay=plain", "network=equivariant"]], ids=["mirrored", "equivariant"])
def test_training_says_so_before_it_begins(tmp_path, capsys, asked):
    file = write(tmp_path, crooked(FREE_LEGS))
    assert command("train", *tiny(tmp_path / "run", f"robot={file}", *asked)) == 2
    assert "replay.mirror=false, and network.equivariant=false if that is on" in capsys.readouterr().err
    assert not (tmp_path / "run" / "progress.csv").exists()


def test_it_trains_without_the_mirror(tmp_path):
    file = write(tmp_path, crooked(FREE_LEGS))
    assert (train(tmp_path / "run", f"robot={file}", "replay.mirror=false") / "progress.csv").is_file()
