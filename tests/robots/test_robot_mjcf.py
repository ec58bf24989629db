"""`Robot` reads hand-written MJCFs, and refuses those that it cannot use."""

import re

import mujoco
import pytest
from robots import TWO_LEGS, write

from gctd3 import Robot
from gctd3.errors import RobotError


@pytest.mark.parametrize("one, two, sign", [("0 -1 0", "0 1 0", -1), ("1 0 0", "1 0 0", -1), ("0 0 1", "0 0 -1", 1)])
def test_mirror_sign_of_a_pair_of_axes(tmp_path, one, two, sign):
    # Mirrored, a turn about y stays the same turn, one about x or z becomes the opposite one.
    text = TWO_LEGS.replace('r" axis="0 -1 0"', f'r" axis="{one}"').replace('l" axis="0 1 0"', f'l" axis="{two}"')
    order, signs = Robot.from_mjcf(write(tmp_path, text)).action_mirror
    assert order.tolist() == [1, 0] and signs.tolist() == [sign, sign]


def test_feet_are_the_legs_ends_unless_chosen(tmp_path):
    path = write(tmp_path, TWO_LEGS)
    assert Robot.from_mjcf(path).feet == ("leg_r", "leg_l")
    assert Robot.from_mjcf(path, feet=["leg_l"]).feet == Robot.from_mjcf(path, feet="leg_l").feet == ("leg_l",)
    with pytest.raises(RobotError, match=r"has no body 'leg'\. Did you mean"):
        Robot.from_mjcf(path, feet="leg")


def test_a_foot_is_the_end_of_a_leg(tmp_path):
    robot = Robot.from_mjcf(write(tmp_path, TWO_LEGS), feet=["torso", "leg_l"])
    with pytest.raises(RobotError, match=r"robot\.xml: foot 'torso' hangs on no joint, so it is no leg's end"):
        robot.check_walking()


# Errors name the file and the element.

SECOND_ROOT = '<body name="extra" pos="2 0 1"><joint name="extra" type="slide"/><geom size="0.1"/></body></worldbody>'
MISSING_MESH = '<asset><mesh name="paw" file="paw.stl"/></asset><worldbody>'
BAD = {
    "unparsable": (lambda text: text.replace("</actuator>", ""), "not an MJCF"),
    "no actuator": (lambda text: re.sub("<actuator>.*</actuator>", "", text, flags=re.DOTALL), "no actuator"),
    "no sensor": (lambda text: re.sub(r'<contact body1="leg_l".*?/>', "", text), "contact sensor for leg_l"),
    "two roots": (lambda text: text.replace("</worldbody>", SECOND_ROOT), "torso, extra"),
    "no ctrlrange": (lambda text: text.replace('joint="hip_l" ctrlrange="-1 1"', 'joint="hip_l"'), "'hip_l' needs"),
    "duplicate name": (lambda text: text.replace('name="hip_l" axis', 'name="hip_r" axis'), "'hip_r'"),
    "missing mesh": (lambda text: text.replace("<worldbody>", MISSING_MESH, 1), "paw.stl"),
    "slide in a leg": (lambda text: text.replace('name="hip_l" axis', 'type="slide" name="hip_l" axis'), "'hip_l'"),
    "two servos on a joint": (
        lambda text: text.replace("</actuator>", '<position name="extra" joint="hip_l" ctrlrange="-1 1"/></actuator>'),
        "actuators 'hip_l' and 'extra' both drive joint 'hip_l'",
    ),
    "slide across the axes": (
        lambda text: text.replace('axis="1 0 0"', 'axis="1 0 1"'),
        "joint 'x' of the root body 'torso', a slide along 0.707 0 0.707, is not understood: a base is a free joint",
    ),
    "second slide along z": (
        lambda text: text.replace('axis="0 0 1"/>', 'axis="0 0 1"/> <joint name="lift" type="slide" axis="0 0 1"/>'),
        "joint 'lift' of the root body 'torso', a slide along 0 0 1, is not understood",
    ),
    "ball in the base": (
        lambda text: text.replace('axis="0 0 1"/>', 'axis="0 0 1"/> <joint name="turn" type="ball"/>'),
        "joint 'turn' of the root body 'torso', a ball, is not understood",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_unusable_mjcf(tmp_path, case):
    spoil, element = BAD[case]
    text = spoil(TWO_LEGS)
    assert text != TWO_LEGS
    path = write(tmp_path, text)
    with pytest.raises(RobotError, match=re.escape(element)) as error:
        Robot.from_mjcf(path).check_walking()
    assert str(path) in str(error.value)


def test_missing_files_and_unknown_names(tmp_path, robot):
    with pytest.raises(RobotError, match=re.escape(str(tmp_path / "none.xml"))):
        Robot.from_mjcf(tmp_path / "none.xml")
    with pytest.raises(RobotError, match=r"'centipede'.*biped"):
        Robot.from_mjcf("centipede")
    with pytest.raises(RobotError, match=r"biped\.xml has no body 'toe'.*ts bodies are .*foot_left"):
        Robot.from_mjcf("biped", feet=["toe"])
    with pytest.raises(RobotError, match=r"biped\.xml has no joint 'toe'; it has hip_right"):
        robot.joint("toe")


def test_sources_that_are_none(robot):
    for source in (None, mujoco.MjData(robot.model), 7):
        with pytest.raises(
            RobotError, match=rf"path of an MJCF file.*MjModel or a mujoco\.MjSpec, got .*{type(source).__name__}"
        ):
            Robot.from_mjcf(source)


def test_base_without_a_slide_along_z(tmp_path):
    path = write(tmp_path, TWO_LEGS.replace('<joint name="z" type="slide" axis="0 0 1"/>', ""))
    with pytest.raises(RobotError, match=r"robot\.xml: the root body 'torso' has no slide joint along z"):
        Robot.from_mjcf(path).check_walking()


def test_actuators_must_be_servos(tmp_path):
    text = TWO_LEGS.replace("<position", "<motor").replace("</position", "</motor").replace('ctrlrange="-1 1"', "")
    robot = Robot.from_mjcf(write(tmp_path, text))  # has a graph, but cannot walk
    with pytest.raises(RobotError, match="must be a <position> servo"):
        robot.check_walking()
