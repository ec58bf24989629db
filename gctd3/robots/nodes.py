"""The nodes of a robot's graph and the edges between them, by preset. Stage two of the data flow begins here.

Every node senses two numbers a frame, so that the paper's robot gets the paper's graph:

* the root: height and forward velocity;
* a base node for each other coordinate in which the root body can move (``<root>_pitch``, ``_roll``, ``_yaw``,
  ``_side``): the coordinate and its rate. A boom has none;
* a joint: its angle and velocity;
* the ground: the contacts of at most two feet. A robot with more has one ground node for each foot and its mirror
  image, ``ground_1`` to ``ground_n``, joined to one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.robot import Robot

GROUND = "ground"
PRESETS = ("tree", "authors", "edgeless", "complete", "random")


@dataclass(frozen=True)
class Node:
    """Represent a node of a robot's graph.

    Attributes:
        name: Name of the joint or root body; ``<root>_<coordinate>`` of a base node, ``ground`` or ``ground_<i>``.
        kind: ``root``, ``base``, ``hinge``, ``slide``, ``ball`` or ``ground``.
        parents: Names of the nodes above it in the tree; for a ground node, the last joints of its feet's legs.
        mirror: Name of its mirror image, often its own.
    """

    name: str
    kind: str
    parents: tuple[str, ...]
    mirror: str


def read_nodes(robot: Robot) -> list[Node]:
    """Return the nodes in order: root, base nodes, joints by depth (equal depths in the MJCF's order), ground."""
    depth: dict[str, int] = {}
    for joint in robot.joints:
        depth[joint.name] = depth[joint.parent] + 1 if joint.parent else 1
    taken = set(depth)
    root = _free_name(robot.root, taken)
    nodes = [Node(root, "root", (), root)]
    for coordinate in robot.base.extra:
        name = _free_name(f"{root}_{coordinate}", taken)
        nodes.append(Node(name, "base", (root,), name))
    for name in sorted(depth, key=depth.__getitem__):
        joint = robot.joint(name)
        nodes.append(Node(name, joint.kind, (joint.parent or root,), robot.mirror[name]))
    many = len(robot.foot_pairs) > 1
    for i, feet in enumerate(robot.foot_pairs, start=1):
        name = _free_name(f"{GROUND}_{i}" if many else GROUND, taken)
        ends = dict.fromkeys(robot.legs[foot][-1].name if robot.legs[foot] else root for foot in feet)
        nodes.append(Node(name, "ground", tuple(ends), name))
    return nodes


def foot_slots(robot: Robot) -> np.ndarray:
    """Locate each foot's contact: ground node (-1 is the last node) and feature. Shape ``[feet, 2]``."""
    slots = np.zeros((len(robot.feet), 2), dtype=np.int64)
    for i, feet in enumerate(robot.foot_pairs):
        for feature, foot in enumerate(feet):
            slots[foot] = i - len(robot.foot_pairs), feature
    return slots


def read_adjacency(nodes: Sequence[Node], preset: str, seed: int) -> np.ndarray:
    """Build the adjacency of a preset of :meth:`.KinematicGraph.from_robot`. Shape ``[N, N]``.

    ``A[i, j] = 1`` if node ``i`` aggregates node ``j``.

    Raises:
        RobotError: If the preset is unknown.
    """
    tree = _tree(nodes)
    if preset == "tree":
        return tree
    if preset == "authors":
        return _authors(nodes)
    if preset == "edgeless":
        return np.zeros_like(tree)
    if preset == "complete":
        return np.ones_like(tree) - np.eye(len(nodes))
    if preset == "random":
        return _random(len(nodes), int(tree.sum()) // 2, seed)
    raise RobotError(f"No graph preset {preset!r}: expected one of {', '.join(PRESETS)}.")


def adjacency_of(names: Sequence[str], edges: Sequence[tuple[str, str]], directed: bool) -> np.ndarray:
    """Build the adjacency ``[N, N]`` of edges: ``(i, j)`` sets ``A[i, j]``, and ``A[j, i]`` too unless ``directed``."""
    place = {name: i for i, name in enumerate(names)}
    adjacency = np.zeros((len(names), len(names)))
    for a, b in edges:
        adjacency[place[a], place[b]] = 1.0
        if not directed:
            adjacency[place[b], place[a]] = 1.0
    return adjacency


def _tree(nodes: Sequence[Node]) -> np.ndarray:
    edges = [(parent, node.name) for node in nodes for parent in node.parents]
    ground = [node.name for node in nodes if node.kind == "ground"]
    edges += [(a, b) for i, a in enumerate(ground) for b in ground[i + 1 :]]
    return adjacency_of([node.name for node in nodes], edges, directed=False)


def _authors(nodes: Sequence[Node]) -> np.ndarray:
    """Build the released script's adjacency: a joint aggregates its parent, hips one another, the ground nothing.

    The authors' robot has no base nodes; the root aggregates them, so that they reach the joints.
    """
    root = nodes[0].name
    joints = [node for node in nodes if node.kind not in ("root", "base", "ground")]
    edges = [(joint.name, joint.parents[0]) for joint in joints]
    hips = [joint.name for joint in joints if joint.parents == (root,)]
    edges += [(a, b) for a in hips for b in hips if a != b]
    edges += [(root, node.name) for node in nodes if node.kind == "base"]
    return adjacency_of([node.name for node in nodes], edges, directed=True)


def _random(num_nodes: int, num_edges: int, seed: int) -> np.ndarray:
    rows, columns = np.triu_indices(num_nodes, k=1)
    chosen = np.random.default_rng(seed).choice(len(rows), size=num_edges, replace=False)
    adjacency = np.zeros((num_nodes, num_nodes))
    adjacency[rows[chosen], columns[chosen]] = 1.0
    return adjacency + adjacency.T


def _free_name(name: str, taken: set[str]) -> str:
    """Return ``name``, with underscores if a joint or an earlier node has that name, and mark it as taken."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name
