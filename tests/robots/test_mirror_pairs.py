"""Joints are paired with their mirror images, and robots without a valid reflection are refused."""

import mujoco
import pytest
from compositions import walking
from robots import FREE_LEGS, TWO_LEGS, write
from running import Recorded, command, tiny, train
from suite_robots import suite

from gctd3.errors import RobotError
from gctd3.robots.mirror_check import check_mirror
from gctd3.robots.mirror_pairs import pair_joints, swap_side
from gctd3.robots.robot import Robot
from gctd3.tasks.reflection import Reflection


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
        ("FL_foot", "FR_foot"),
        ("front_rl_calf", "front_rr_calf"),
        ("lowerback", "lowerback"),
        ("root", "root"),
    ],
)
def test_sides_in_names(name, other):
    known = ["hip_right", "hip_left", "L_knee", "R_knee", "thigh", "thigh_left", "lfemurrx", "rfemurrx"]
    known += ["RHipYaw", "LHipYaw", "FL_foot", "FR_foot", "front_rl_calf", "front_rr_calf", "lowerback", "root"]
    assert swap_side(name, known) == other and swap_side(other, known) == name


def test_a_side_glued_to_a_name_pairs_joints_of_one_kind_only(tmp_path):
    text = FREE_LEGS.replace("hip_r", "rear").replace("hip_l", "lear").replace('pos="0 0.1 0"', 'pos="0.2 0.3 0"')
    assert Robot.from_mjcf(write(tmp_path, text)).mirror == {"rear": "lear", "lear": "rear"}
    slide = text.replace('name="lear" axis', 'type="slide" name="lear" axis')
    assert Robot.from_mjcf(write(tmp_path, slide)).mirror == {"rear": "rear", "lear": "lear"}


@pytest.mark.dm_control
def test_every_limb_of_the_cmu_humanoid_has_its_other_side():
    robot = Robot.from_mjcf(suite("humanoid_CMU.xml"))
    trunk = ("lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head")
    for name, other in robot.mirror.items():
        side = {"l": "r", "r": "l"}.get(name[0])
        assert other == (name if name.startswith(trunk) else f"{side}{name[1:]}")


@pytest.mark.parametrize("name", ["biped", "biped_planar", "quadruped", "hexapod"])
def test_shipped_robots_are_symmetric(name):
    robot = Robot.from_mjcf(name)
    verdict = check_mirror(robot, 0.02)
    assert verdict.symmetric and verdict.residual < 1e-12
    assert str(verdict) == "mirror: on, the left and the right are equal"
    Reflection.from_robot(robot)


def pairs_of(text, forward="x", **known):
    robot = Robot.from_mjcf(mujoco.MjModel.from_xml_string(text), forward=forward, **known)
    return pair_joints(robot.model, robot.base.root, robot.joints, robot.standing_qpos, robot.base.frame[1])


def test_places_are_looked_at_before_names(tmp_path):
    # Whoever named these legs took one name for both sides of the front, the other for both of the back.
    leg = '<body name="leg_{0}" pos="{1}"><joint name="hip_{0}" axis="0 1 0"/><geom size="0.02" pos="0 0 -0.3"/></body>'
    four = "".join(leg.format(n, at) for n, at in zip(("a_l", "a_r", "b_l", "b_r"), CORNERS, strict=True))
    trunk = f'<body name="trunk" pos="0 0 0.4"><freejoint/><geom size="0.1"/>{four}</body>'
    text = f"<mujoco><worldbody>{trunk}</worldbody></mujoco>"
    found = pairs_of(text)
    assert found.images == {"hip_a_l": "hip_b_l", "hip_b_l": "hip_a_l", "hip_a_r": "hip_b_r", "hip_b_r": "hip_a_r"}
    assert len(found.placed) == 4 and found.plane.offset == 0.0
    assert Robot.from_mjcf(mujoco.MjModel.from_xml_string(text), forward="x").mirror_feet == (2, 3, 0, 1)
    # Where both directions are as good, the names' sides say which is meant.
    assert Robot.from_mjcf(mujoco.MjModel.from_xml_string(text)).forward_axis == "y"


CORNERS = ("0.2 0.1 0", "-0.2 0.1 0", "0.2 -0.1 0", "-0.2 -0.1 0")


def test_the_plane_is_the_roots_however_many_joints_are_beside_it():
    # A head 3 cm off the middle: forward stays x, the legs stay pairs, and the head has no image.
    head = '<body pos="0.1 0.03 0.2"><joint name="pan" axis="0 0 1"/><geom size="0.05"/></body></body></worldbody>'
    text = FREE_LEGS.replace("</body>\n  </worldbody>", head)
    assert text != FREE_LEGS
    robot = Robot.from_mjcf(mujoco.MjModel.from_xml_string(text), feet=["leg_r", "leg_l"])
    assert robot.forward_axis == "x" and robot.mirror_plane.offset == 0.0
    assert robot.mirror == {"hip_r": "hip_l", "hip_l": "hip_r", "pan": "pan"}
    reason = check_mirror(robot, 0.02).reason
    assert reason.startswith("joint 'pan': it is beside the middle")


def test_the_plane_is_the_joints_where_the_root_is_beside_it():
    # Everything of the trunk 5 cm to the left, as a frame in a corner of the trunk has it.
    aside = FREE_LEGS.replace('name="torso" size="0.1"', 'name="torso" size="0.1" pos="0 0.05 0"')
    aside = aside.replace("0 -0.1 0", "0 -0.05 0").replace('pos="0 0.1 0"', 'pos="0 0.15 0"')
    robot = Robot.from_mjcf(mujoco.MjModel.from_xml_string(aside))
    assert robot.mirror == {"hip_r": "hip_l", "hip_l": "hip_r"} and robot.mirror_plane.offset == pytest.approx(0.05)
    verdict = check_mirror(robot, 0.02)
    assert verdict.symmetric and verdict.residual < 0.003  # the frame of the base turns about a place beside it


ROLL_AND_YAW = '<joint name="yaw_{0}" axis="0 0 1"/><joint name="hip_{0}" axis="1 0 0"'


def test_a_root_a_little_beside_the_middle(tmp_path):
    # Near enough to be taken for the middle, and yet not the middle; lateral hinges could be anywhere along their axes.
    aside = FREE_LEGS.replace("0 -0.1 0", "0 -0.1015 0").replace('name="torso" size="0.1"', "{}")
    aside = aside.format('name="torso" size="0.1" pos="0 -0.00075 0"')
    for side in ("r", "l"):
        axis = "0 -1 0" if side == "r" else "0 1 0"
        aside = aside.replace(f'<joint name="hip_{side}" axis="{axis}"', ROLL_AND_YAW.format(side))
    robot = Robot.from_mjcf(write(tmp_path, aside))
    assert robot.mirror_plane.offset == pytest.approx(-0.00075) and robot.mirror_sign("hip_r") == -1.0
    verdict = check_mirror(robot, 0.02)
    assert verdict.symmetric and verdict.residual < 1e-3


def test_a_hinge_is_a_line(tmp_path):
    # One roll is anchored 5 cm farther along its own axis, which changes nothing.
    roll = '<joint name="roll_{}" axis="1 0 0" pos="{} 0 0"/><joint name="hip_{}"'
    text = FREE_LEGS.replace('<joint name="hip_r"', roll.format("r", 0.05, "r"))
    text = text.replace('<joint name="hip_l"', roll.format("l", 0, "l"))
    robot = Robot.from_mjcf(write(tmp_path, text))
    assert robot.mirror["roll_r"] == "roll_l" and robot.mirror_sign("roll_r") == -1.0
    assert check_mirror(robot, 0.02).symmetric
    across = Robot.from_mjcf(write(tmp_path, text.replace('pos="0.05 0 0"', 'pos="0 0.004 0"')))
    assert across.mirror["roll_r"] == "roll_l"
    assert "'roll_l': the reflected anchor is 4 mm off" in check_mirror(across, 0.02).reason


def test_feet_without_joints_are_pairs_by_their_places():
    def leg(name, y):
        foot = f'<body name="{name}_foot" pos="0 0 -0.2"><geom size="0.02"/></body>'
        return f'<body name="{name}" pos="0 {y} 0"><joint name="j{name}" axis="0 1 0"/><geom size="0.03"/>{foot}</body>'

    for names in (("FL", "FR"), ("one", "two"), ("left", "left_too")):
        legs = leg(names[0], 0.1) + leg(names[1], -0.1)
        body = f'<body name="trunk" pos="0 0 0.4"><freejoint/><geom size="0.1"/>{legs}</body>'
        robot = Robot.from_mjcf(mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>"))
        assert robot.feet == tuple(f"{name}_foot" for name in names) and robot.mirror_feet == (1, 0)
        assert robot.mirror_name(robot.feet[0]) == robot.feet[1] and robot.mirror_name("trunk") == "trunk"


def test_no_driven_joint_has_an_empty_reflection():
    start, end = FREE_LEGS.index("<actuator>"), FREE_LEGS.index("</actuator>") + len("</actuator>")
    robot = Robot.from_mjcf(mujoco.MjModel.from_xml_string(FREE_LEGS[:start] + FREE_LEGS[end:]))
    reflection = Reflection.from_robot(robot)
    assert len(reflection.action.source) == 0 and len(reflection.frame.source) == reflection.features * 8


def test_joints_off_the_plane_that_are_their_own_image_are_refused(tmp_path):
    robot = Robot.from_mjcf(write(tmp_path, crooked(FREE_LEGS)))
    robot.check_walking()
    assert robot.mirror == {"hip_a": "hip_a", "hip_b": "hip_b"}
    said = r"robot\.xml is not the same .*replay\.mirror=false.*: hip_a, hip_b\.$"
    for reflect in (lambda: Reflection.from_robot(robot), lambda: walking(robot).reflection()):
        with pytest.raises(RobotError, match=said):
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


EQUIVARIANT = ["replay=plain", "network=equivariant"]


@pytest.mark.parametrize("asked", [["replay.mirror=true"], EQUIVARIANT], ids=["mirrored", "equivariant"])
def test_training_says_so_before_it_begins(tmp_path, capsys, asked):
    file = write(tmp_path, crooked(FREE_LEGS))
    assert command("train", *tiny(tmp_path / "run", f"robot={file}", *asked)) == 2
    assert "replay.mirror=false, and network.equivariant=false if that is on" in capsys.readouterr().err
    assert not (tmp_path / "run" / "progress.csv").exists()


@pytest.mark.nightly
def test_it_trains_without_the_mirror_and_says_so_in_a_line(tmp_path, capsys):
    file = write(tmp_path, crooked(FREE_LEGS))
    assert (train(tmp_path / "off", f"robot={file}", "replay.mirror=false") / "progress.csv").is_file()
    assert "mirror: off" not in capsys.readouterr().out
    assert (train(tmp_path / "auto", f"robot={file}") / "progress.csv").is_file()
    assert Recorded.last.replay.mirror is None
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("mirror: o")]
    assert len(lines) == 1 and lines[0].startswith("mirror: off, for joint 'hip_a': it is beside")


@pytest.mark.nightly
def test_it_is_mirrored_where_the_sides_are_alike(tmp_path, capsys):
    train(tmp_path / "run", f"robot={write(tmp_path, FREE_LEGS)}")
    assert Recorded.last.replay.mirror is not None
    assert "\nmirror: on, the left and the right are equal\n" in capsys.readouterr().out


@pytest.mark.nightly
def test_one_actuator_without_an_image_refuses_no_training(tmp_path, capsys):
    text = FREE_LEGS.replace('<position name="hip_l" joint="hip_l" ctrlrange="-1 1"/>', "")
    for side in "rl":
        text = text.replace(
            f'<joint name="hip_{side}"', f'<joint name="roll_{side}" axis="1 0 0"/> <joint name="hip_{side}"'
        )
        text = text.replace(
            "</actuator>", f'<position name="roll_{side}" joint="roll_{side}" ctrlrange="-1 1"/> </actuator>'
        )
    file = write(tmp_path, text)
    assert (train(tmp_path / "run", f"robot={file}") / "progress.csv").is_file()
    # The joint that nothing drives is no node, and those above it have no image then.
    assert "mirror: off, for joint 'roll_r': it is beside the middle, and no joint is at" in capsys.readouterr().out
    assert command("train", *tiny(tmp_path / "no", f"robot={file}", "replay.mirror=true")) == 2
    assert "roll_r" in capsys.readouterr().err
    raw = check_mirror(Robot.from_mjcf(file), 0.02)
    assert str(raw) == "mirror: off, for joint 'hip_r': it has an actuator, its mirror image 'hip_l' has none"
