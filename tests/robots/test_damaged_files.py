"""Faults of robots' files that generated damage has found: each is refused by the name of the part."""

import pytest
from robots import TWO_LEGS

from gctd3.errors import RobotError
from gctd3.robots.settings import RobotSettings

LIMIT = '<limit lower="-0.8" upper="0.8" effort="20" velocity="9"/>'


def link(name):
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    shape = '<collision><geometry><cylinder radius="0.02" length="0.4"/></geometry></collision>'
    return f'<link name="{name}"><inertial><mass value="1"/>{inertia}</inertial>{shape}</link>'


def joint(name, parent, child, limit=LIMIT):
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="revolute">{ends}<origin xyz="0 0 -0.4"/><axis xyz="0 1 0"/>{limit}</joint>'


TRUNK, LEG, OTHER = link("trunk"), link("leg"), link("other")
URDF = {
    "child": (
        [TRUNK, LEG, joint("hip", "trunk", "lag")],
        "the child of joint 'hip' must be a link, got 'lag'. Did you",
    ),
    "parent": ([TRUNK, LEG, joint("hip", "", "leg")], "the parent of joint 'hip' must be a link, got ''"),
    "two above": (
        [TRUNK, LEG, OTHER, joint("hip", "trunk", "leg"), joint("hop", "other", "leg")],
        "link 'leg' must be the child of one joint, got 'hip' and 'hop'",
    ),
    "ring": (
        [TRUNK, LEG, OTHER, joint("hip", "other", "leg"), joint("knee", "leg", "other")],
        "links must form a tree; from",
    ),
    "link twice": (
        [TRUNK, LEG, LEG, joint("hip", "trunk", "leg")],
        "every link must have a name of its own, got 'leg'",
    ),
    "joint twice": (
        [TRUNK, LEG, OTHER, joint("hip", "trunk", "leg"), joint("hip", "trunk", "other")],
        "every joint must have a name of its own, got 'hip' twice",
    ),
    "no name": ([TRUNK, link("")], "every link must have a name of its own, got ''"),
    "effort": (
        [TRUNK, LEG, joint("hip", "trunk", "leg", LIMIT.replace("20", "much"))],
        "effort of joint 'hip' must be a number, got 'much'",
    ),
    "limits": (
        [TRUNK, LEG, joint("hip", "trunk", "leg", LIMIT.replace("-0.8", "1"))],
        "the limits of joint 'hip' must rise, got lower=1 and upper=0.8",
    ),
    "quotes": ([link("it&apos;s"), LEG, joint("hip", "it&apos;s", "lag")], "must be a link, got 'lag'"),
}


@pytest.mark.parametrize("case", URDF)
def test_a_urdf_that_is_no_tree(tmp_path, case):
    parts, said = URDF[case]
    file = tmp_path / "damaged.urdf"
    file.write_text(f'<robot name="damaged">{"".join(parts)}</robot>')
    with pytest.raises(RobotError) as refused:
        RobotSettings(str(file)).load()
    assert said in str(refused.value) and str(file) in str(refused.value)


def test_a_floating_joint_under_a_name_with_quotes(tmp_path):
    """A name is compared as a text, not put into a path of XML."""
    floating = '<joint name="free" type="floating"><parent link="it&apos;s"/><child link="trunk"/></joint>'
    file = tmp_path / "quotes.urdf"
    legs = "".join(link(f"leg_{side}") + joint(f"hip_{side}", "trunk", f"leg_{side}") for side in "lr")
    file.write_text(f'<robot name="quotes"><link name="it&apos;s"/>{floating}{TRUNK}{legs}</robot>')
    assert RobotSettings(str(file)).load().root == "trunk"


@pytest.mark.parametrize("place", ["0 0.1 -1e308", "0 1e11 0"])
def test_a_part_that_is_too_far_away(tmp_path, place):
    file = tmp_path / "far.xml"
    assert TWO_LEGS.count('<body name="leg_l" pos="0 0.1 0">') == 1
    file.write_text(TWO_LEGS.replace('<body name="leg_l" pos="0 0.1 0">', f'<body name="leg_l" pos="{place}">'))
    with pytest.raises(RobotError, match="body leg_l is at"):
        RobotSettings(str(file)).load()


PHYSICS = {
    '<option><flag contact="disable"/></option>': '<flag contact="disable"/> in its <option> must go',
    '<option><flag constraint="disable"/></option>': '<flag constraint="disable"/> in its <option> must go',
    '<option><flag actuation="disable"/></option>': '<flag actuation="disable"/> in its <option> must go',
    '<option><flag gravity="disable"/></option>': '<flag gravity="disable"/> in its <option> must go',
    '<option gravity="0 0 0"/>': "gravity must point down, with z of -0.1 m/s^2 or less, got [0.0, 0.0, 0.0]",
    '<option gravity="0 0 9.81"/>': "got [0.0, 0.0, 9.81]",
}


@pytest.mark.parametrize("option", PHYSICS)
def test_a_simulation_in_which_nothing_walks(tmp_path, option):
    file = tmp_path / "floating.xml"
    file.write_text(TWO_LEGS.replace("<worldbody>", f"{option}<worldbody>", 1))
    with pytest.raises(RobotError) as refused:
        RobotSettings(str(file)).load()
    assert PHYSICS[option] in str(refused.value) and str(file) in str(refused.value)


def test_the_moon_is_no_fault(tmp_path):
    file = tmp_path / "moon.xml"
    file.write_text(TWO_LEGS.replace("<worldbody>", '<option gravity="0 0 -1.62"/><worldbody>', 1))
    assert RobotSettings(str(file)).load().model.opt.gravity[2] == -1.62


def test_a_urdf_without_collision(tmp_path):
    file = tmp_path / "seen.urdf"
    legs = "".join(link(f"leg_{side}") + joint(f"hip_{side}", "trunk", f"leg_{side}") for side in "lr")
    file.write_text(f'<robot name="seen">{TRUNK}{legs}</robot>'.replace("collision>", "visual>"))
    with pytest.raises(RobotError, match="none of its links has a <collision>"):
        RobotSettings(str(file)).load()


def test_equal_limits_are_named(tmp_path):
    file = tmp_path / "equal.urdf"
    none = LIMIT.replace("-0.8", "0").replace("0.8", "0")
    legs = link("leg_l") + joint("hip_l", "trunk", "leg_l", none) + link("leg_r") + joint("hip_r", "trunk", "leg_r")
    file.write_text(f'<robot name="equal">{TRUNK}{legs}</robot>')
    robot = RobotSettings(str(file)).load()
    assert "The limits of hip_l, lower and upper, are equal: MuJoCo takes them for none." in robot.notes


def test_keys_that_are_reserved_are_no_fault(tmp_path):
    """dm_control's dog has <size nkey="1"/> and no key: MuJoCo adds an empty one."""
    file = tmp_path / "reserved.xml"
    file.write_text(TWO_LEGS.replace("<worldbody>", '<size nkey="2"/><worldbody>', 1))
    assert RobotSettings(str(file)).load().feet == ("leg_r", "leg_l")
