"""Topics of a policy, and the arguments of the command."""

import json
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gctd3.bridge.arguments import parse
from gctd3.bridge.messages import TYPES, JointSample, Topic
from gctd3.bridge.names import layout_of, topic_name
from gctd3.bridge.settings import RosSettings
from gctd3.deploy.contract import read_contract
from gctd3.errors import ConfigError


@pytest.fixture(scope="module")
def contract(exported):
    return read_contract(exported.with_suffix(".json"))


def test_every_reading_of_the_contract_has_its_place(contract):
    """What is packed is unpacked again to the bit, and each topic carries what the contract names."""
    layout = layout_of(contract, "contract")
    assert [topic.name for topic in layout.sensors] == [
        "/height_m",
        "/velocity_m_s",
        "/down_foot_right",
        "/down_foot_left",
        "/joint_states",
    ]
    assert {topic.kind for topic in layout.sensors[2:4]} == {"switch"}
    readings = {name: 0.1 * i + 1 / 3 for i, name in enumerate(contract.readings)}
    readings |= {"down_foot_right": 1.0, "down_foot_left": 0.0}
    found = {}
    for topic, message in layout.pack_readings(7, "", {**readings, "distance_m": 1.0}):
        found |= layout.unpack_reading(topic, message)
    assert found == readings
    angles = {servo.actuator: 0.1 * i + 1 / 3 for i, servo in enumerate(contract.servos)}
    ((topic, message),) = layout.pack_command(7, "", angles)
    assert message.stamp == 7 and layout.unpack_command(topic, message) == angles


def test_joints_may_come_in_any_order_and_be_more(contract):
    layout = layout_of(contract, "contract")
    names = tuple(row.name for row in layout.rows)
    message = JointSample(0, "", ("tail", *names[::-1]), tuple(map(float, range(7))), (0.0,) * 7)
    found = layout.unpack_reading(Topic("/joint_states", "joints"), message)
    assert [found[f"angle_{name}_rad"] for name in names] == [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]


@pytest.mark.parametrize("names", ["paper", "authors"])
def test_the_papers_names(contract, names):
    layout = layout_of(contract, names)
    readings = {name: 0.01 * i + 1 / 3 for i, name in enumerate(contract.readings)}
    readings |= {"down_foot_right": 1.0, "down_foot_left": 0.0}
    found = {}
    for topic, message in layout.pack_readings(7, "", {**readings, "distance_m": 1.0}):
        found |= layout.unpack_reading(topic, message)
    assert found == pytest.approx(readings, abs=1e-15)
    assert [topic.name for topic in layout.commands] == [
        f"/{joint}_position_controller/command"
        for joint in ("waist_thighR", "thighR_shankR", "shankR_footR", "waist_thighL", "thighL_shankL", "shankL_footL")
    ]
    assert layout.simulator == "gazebo"
    other = replace(contract, servos=contract.servos[:-1])
    with pytest.raises(
        ConfigError, match=rf"names={names} are the biped's; this policy is for 'biped': names=contract"
    ):
        layout_of(other, names)


@settings(max_examples=30)
@given(st.text(min_size=1, max_size=20))
def test_topics_have_names_that_ros_accepts(name):
    """ROS 1: a letter, then letters, digits and underscores; ROS 2 forbids double underscores besides."""
    made = topic_name(name)
    assert made[0] == "/" and made[1].isascii() and made[1].isalpha() and "__" not in made
    assert all(c.isascii() and (c.isalnum() or c == "_") for c in made[1:])


def test_two_readings_of_one_topic_are_refused(contract):
    nodes = list(contract.nodes)
    root = nodes[0]
    features = (replace(root.features[0], reading="height-m"), replace(root.features[1], reading="height.m"))
    with pytest.raises(ConfigError, match="two readings would be published as /height_m"):
        layout_of(replace(contract, nodes=(replace(root, features=features), *nodes[1:])), "contract")


def test_types_are_those_of_ros():
    assert all(text.count("/") == 1 for text in TYPES.values()) and json.dumps(TYPES)


@pytest.mark.parametrize(
    "arguments, key, value",
    [
        (["node=policy"], "node", "policy"),
        (["run=null"], "run", None),
        (["run='a b'"], "run", "a b"),
        (["seed=3", "seed=5"], "seed", 5),
        (["seconds=2"], "seconds", 2.0),
        (["home_first=true"], "home_first", True),
        (["wait=1_0"], "wait", 10.0),
    ],
)
def test_arguments_become_settings(arguments, key, value):
    made = getattr(parse(RosSettings, arguments), key)
    assert made == value and type(made) is type(value)


@pytest.mark.parametrize(
    "argument, said",
    [
        ("node", "Arguments have the form key=value, got 'node'"),
        ("polici=x.onnx", r"Unknown key 'polici'. Did you mean 'policy'\? Accepted: node, middleware"),
        ("clock=walk", r"clock must be one of lockstep, wall, got 'walk'. Did you mean 'wall'\?"),
        ("seed=1.5", "seed must be a whole number or null, got '1.5'"),
        ("seed=-1", "seed must be at least 0"),
        ("wait=inf", "wait must be a number, got 'inf'"),
        ("wait=0", "wait must be at least 0.1, got 0.0"),
        ("home_first=1", "home_first must be true or false, got '1'"),
        ("policy=policy.pt", "policy must be the .onnx file that gctd3.export writes, got 'policy.pt'"),
        ("seconds=0", "seconds must be above 0, or null, got 0.0"),
    ],
)
def test_wrong_arguments_are_named(argument, said):
    with pytest.raises(ConfigError, match=said):
        parse(RosSettings, [argument])
