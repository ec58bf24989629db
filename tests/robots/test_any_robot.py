"""The graph of other people's robots: expected nodes read from their files, and properties of every robot's graph."""

import sys
from pathlib import Path

import gymnasium
import mujoco
import networkx
import numpy as np
import pytest
import torch
from suite_robots import suite, why_not
from torch_geometric.nn import GCNConv
from torch_geometric.utils import is_undirected, to_dense_adj

from gctd3.errors import RobotError
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot

GYM = Path(gymnasium.__file__).parent / "envs/mujoco/assets"
TOES = ("toe_front_left", "toe_front_right", "toe_back_right", "toe_back_left")
# File; joints outside the base; kind of base, whose free joint adds pitch, roll, yaw and side; feet; pairs of joints.
ROBOTS = {
    "walker": (suite("walker.xml"), 6, "planar", ("right_foot", "left_foot"), 3),
    "cheetah": (suite("cheetah.xml"), 6, "planar", ("bfoot", "ffoot"), 0),
    "hopper": (suite("hopper.xml"), 4, "planar", ("foot",), 0),
    "humanoid": (suite("humanoid.xml"), 21, "free", ("right_foot", "left_foot"), 9),
    "quadruped": (suite("quadruped.xml"), 16, "free", TOES, 8),
    "dog": (suite("dog.xml"), 73, "free", ("toe_L", "toe_R", "finger_L", "finger_R"), 14),
    "Walker2d": (GYM / "walker2d.xml", 6, "planar", ("foot", "foot_left"), 3),
    "Ant": (GYM / "ant.xml", 8, "free", ("body_4", "body_7", "body_10", "body_13"), 4),
    "Humanoid": (GYM / "humanoid.xml", 17, "free", ("right_foot", "left_foot"), 7),
}
EXTRA = {"planar": ["pitch"], "free": ["pitch", "roll", "yaw", "side"]}


@pytest.fixture(scope="module", params=ROBOTS)
def case(request):
    file, *expected = ROBOTS[request.param]
    if not file.is_file():
        pytest.skip(why_not())
    robot = Robot.from_mjcf(file)
    return robot, KinematicGraph.from_robot(robot), *expected


def test_nodes(case):
    robot, graph, joints, base, feet, _ = case
    assert (robot.base.kind, robot.forward_axis, robot.feet) == (base, "x", feet)
    grounds = ["ground"] if len(feet) <= 2 else ["ground_1", "ground_2"]
    added = [f"torso_{name}" for name in EXTRA[base]]
    assert graph.nodes[: 1 + len(added)] == ("torso", *added)
    assert list(graph.nodes[-len(grounds) :]) == grounds
    assert graph.kinds.count("hinge") == joints == graph.num_nodes - 1 - len(added) - len(grounds)


def test_edges_are_the_models_tree(case):
    """Edges equal the compiled model's tree, found by walking up from every joint's body to the next joint."""
    robot, graph, joints, base, feet, _ = case
    model, edges = robot.model, {frozenset(edge) for edge in graph.edges}
    for i in range(model.njnt):
        name, body = model.joint(i).name, int(model.jnt_bodyid[i])
        if name not in graph.nodes:
            continue
        above = i - 1 if i > model.body_jntadr[body] else None
        while above is None:
            body = int(model.body_parentid[body])
            if model.body_jntnum[body]:
                above = int(model.body_jntadr[body] + model.body_jntnum[body]) - 1
        parent = model.joint(above).name if model.joint(above).name in graph.nodes else "torso"
        assert frozenset((name, parent)) in edges
    # A tree over root, base nodes and joints; an edge for each foot; the ground nodes joined.
    grounds = len(robot.foot_pairs)
    assert len(edges) == joints + len(EXTRA[base]) + len(feet) + grounds * (grounds - 1) // 2
    assert all(any("ground" in str(edge) and leg[-1].name in edge for edge in edges) for leg in robot.legs)
    assert not graph.directed
    assert networkx.is_connected(graph.to_networkx())


def test_mirror_is_an_involution_that_keeps_the_graph(case):
    _, graph, *_, pairs = case
    mirror = list(graph.mirror)
    assert [mirror[i] for i in mirror] == list(range(graph.num_nodes))
    np.testing.assert_array_equal(graph.adjacency[np.ix_(mirror, mirror)], graph.adjacency)
    assert sum(i < other for i, other in enumerate(mirror)) == pairs
    for i, other in enumerate(mirror):
        swapped = {"left": "right", "right": "left"}
        words = [swapped.get(word, word) for word in graph.nodes[i].split("_")]
        if words != graph.nodes[i].split("_") and "_".join(words) in graph.nodes:
            assert graph.nodes[other] == "_".join(words)


def test_mirrored_pose_is_the_reflected_pose(case):
    """With angles exchanged and signed by the mirror, every joint lies at its partner's reflected place."""
    robot, _, *_, pairs = case
    if robot.path.name == "dog.xml" or not pairs:
        pytest.skip("the dog's bones are only nearly symmetric; without pairs there is nothing to exchange")
    model, rng = robot.model, np.random.default_rng(0)
    one, two = mujoco.MjData(model), mujoco.MjData(model)
    for joint in robot.joints:
        change = rng.uniform(-0.3, 0.3)
        one.qpos[joint.qpos] += change
        two.qpos[robot.joint(robot.mirror[joint.name]).qpos] += change * robot.mirror_sign(joint.name)
    for data in (one, two):
        mujoco.mj_kinematics(model, data)
    for joint in robot.joints:
        other = robot.joint(robot.mirror[joint.name])
        expected = one.xanchor[joint.id] * (1, -1, 1)
        if "alker" in robot.path.name:  # both legs lie in the plane
            expected[1] = two.xanchor[other.id][1]
        np.testing.assert_allclose(two.xanchor[other.id], expected, atol=2e-3)


def test_graph_for_torch_geometric(case):
    _, graph, *_ = case
    edges = graph.edge_index()
    assert edges.dtype == torch.int64 and edges.shape == (2, int(graph.adjacency.sum())) and edges.is_contiguous()
    assert is_undirected(edges)
    np.testing.assert_array_equal(to_dense_adj(edges, max_num_nodes=graph.num_nodes)[0], graph.adjacency.T)
    layer, features = GCNConv(3, 5), torch.randn(graph.num_nodes, 3)
    mixed = torch.from_numpy(graph.normalized_adjacency).float() @ features
    torch.testing.assert_close(layer(features, edges), mixed @ layer.lin.weight.T + layer.bias)


def test_directed_edges_run_from_source_to_target():
    graph = KinematicGraph.from_mjcf("biped", "authors")
    source, target = graph.nodes.index("body"), graph.nodes.index("hip_right")
    assert [source, target] in graph.edge_index().T.tolist() and [target, source] not in graph.edge_index().T.tolist()
    assert list(graph.to_networkx().successors("body")) == ["hip_right", "hip_left"]


def test_networkx_is_optional(graph, monkeypatch):
    monkeypatch.setitem(sys.modules, "networkx", None)
    with pytest.raises(ImportError, match=r"pip install 'gctd3\[networkx\]'"):
        graph.to_networkx()


def test_networkx_knows_kinds_and_mirrors(graph):
    exported = graph.to_networkx()
    assert exported.nodes["hip_right"] == {"kind": "hinge", "mirror": "hip_left"}
    assert exported.nodes["ground"]["kind"] == "ground" and exported.number_of_edges() == len(graph.edges)


def test_table_and_short_form(graph):
    table = str(graph)
    assert "1  hip_right    hinge   body                     hip_left" in table
    assert "7  ground       ground  ankle_right, ankle_left" in table
    assert repr(graph) == f"KinematicGraph(8 nodes, 8 edges: {', '.join(graph.nodes)})"


# Detected feet, forward axes and mirror pairs.

CROSS = """
<mujoco>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body name="trunk" pos="0 0 0.5"> <freejoint/> <geom size="0.1"/>
      <body name="a" pos="-0.3 0.2 0"> <joint axis="1 0 0"/> <joint type="slide" axis="0 0 1" name="lift"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" name="toe_a"/></body>
      <body pos="0.3 0.2 0"> <joint axis="1 0 0" name="b"/> <joint type="slide" axis="0 0 -1" name="c"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02"/></body>
      <body name="arm" pos="0 -0.2 0"> <joint type="ball" name="wrist"/> <geom size="0.05"/></body>
    </body>
    <body name="ball" pos="2 0 0"> <freejoint name="roll"/> <geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


def test_unnamed_parts_joints_of_every_kind_and_no_actuator():
    robot = Robot.from_mjcf(mujoco.MjSpec.from_string(CROSS))
    graph = KinematicGraph.from_robot(robot)
    # Two legs at x = -0.3 and 0.3 and one arm between them: the sides are equal about the y axis.
    assert (robot.forward_axis, robot.feet) == ("y", ("a", "body_3"))
    joints = ("joint_1", "b", "wrist", "lift", "c")
    assert graph.nodes == ("trunk", *(f"trunk_{name}" for name in EXTRA["free"]), *joints, "ground")
    assert [graph.kinds[graph.nodes.index(name)] for name in joints] == ["hinge", "hinge", "ball", "slide", "slide"]
    assert graph.mirror == (0, 1, 2, 3, 4, 6, 5, 7, 9, 8, 10)
    # An axis along the lateral x is its own mirror image; slides along z and -z move opposite ways.
    assert (robot.mirror_sign("b"), robot.mirror_sign("lift")) == (1.0, -1.0)
    assert robot.mirror_feet == (1, 0)


def test_feet_by_name_of_a_geom_or_body():
    model = mujoco.MjModel.from_xml_string(CROSS)
    assert Robot.from_mjcf(model, feet=["toe_a"]).feet == ("a",)
    graph = KinematicGraph.from_mjcf(model, feet=["a", "arm"])
    assert {edge for edge in graph.edges if "ground" in edge} == {("lift", "ground"), ("wrist", "ground")}
    with pytest.raises(RobotError, match=r"no body 'ball'\. Its bodies are trunk, a, body_3, arm"):
        Robot.from_mjcf(model, feet=["ball"])


def test_an_asymmetric_robot_is_its_own_mirror():
    text = CROSS.replace('<joint type="slide" axis="0 0 -1" name="c"/>', "")
    graph = KinematicGraph.from_mjcf(mujoco.MjModel.from_xml_string(text))
    # One leg has a slide that the other lacks: exchanging their hinges would not keep the graph.
    assert graph.mirror == tuple(range(graph.num_nodes))


def test_a_turntable_is_a_joint_not_a_base():
    text = CROSS.replace("<freejoint/>", '<joint name="turn" axis="0 0 1"/>')
    robot = Robot.from_mjcf(mujoco.MjModel.from_xml_string(text))
    assert robot.base.kind == "fixed" and robot.joints[0].name == "turn"
    assert ("trunk", "turn") in KinematicGraph.from_robot(robot).edges


def test_walking_needs_more_than_a_graph():
    with pytest.raises(RobotError, match=r"ant\.xml: actuator '0' must be a <position> servo"):
        Robot.from_mjcf(GYM / "ant.xml").check_walking()
