"""A robot's graph drawn over its silhouette: ``python -m gctd3.graph robot=biped out=graph.svg``.

The view is from the robot's right, forward to the right, with depth drawn aslant so that both sides show.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from omegaconf import DictConfig, OmegaConf

from gctd3.config.build import build
from gctd3.files import check_writable, quoted
from gctd3.robots.geometry import convex_hull, geom_points
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.mjcf import bodies_below, body_name, colliding_geoms
from gctd3.robots.robot import Robot
from gctd3.viz.settings import GraphSettings
from gctd3.viz.svg_canvas import Disc, Picture, Point, Polygon, Words

# (fill of a node, fill of a silhouette, its outline)
COLOURS = {
    "right": ("#2f6fb5", "#cfe0f2", "#9dbfe0"),
    "left": ("#d9772a", "#f8dfca", "#ecb98d"),
    "middle": ("#4a4f57", "#e6e8ea", "#bcc1c6"),
    "ground": ("#6b8f4e", "#eef3ea", "#c3d3b6"),
}
ASLANT = (0.55, 0.30)  # where a metre to the left goes: metres forward, metres up
_INK = "#30343a"
_ROW, _ROWS = 22.0, 30  # the list of names: pixels to a row, rows to a column
_VISIBLE = 2  # MuJoCo's viewer shows geoms of the groups 0 to 2


def draw_graph(robot: Robot, graph: KinematicGraph, size: int = 720) -> Picture:
    """Draw a robot in its standing pose, its graph on top, the nodes' names beside.

    Args:
        robot: The robot.
        graph: Graph from :meth:`.KinematicGraph.from_robot`, of any preset.
        size: Longer side of the robot's picture (pixels).
    """
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(robot.model, data)
    mujoco.mj_comPos(robot.model, data)
    sides = _sides(robot, data)
    shapes = _silhouette(robot, data, sides)
    places, floor = _places(robot, graph, data)
    outlines = [outline for outline, _ in shapes]
    everything = np.concatenate([*outlines, floor, places])
    low, high = everything.min(axis=0), everything.max(axis=0)
    scale = size / float((high - low).max())
    radius = float(np.clip(16.0 - 0.12 * graph.num_nodes, 7.0, 14.0))
    nodes = _apart((places - low) * scale, 2.2 * radius)
    margin = 2.0 * radius
    lift = margin - np.minimum(nodes.min(axis=0), 0.0)
    extent = np.maximum(nodes.max(axis=0), (high - low) * scale) + lift + margin
    height = max(float(extent[1]), _ROW * (min(_ROWS, graph.num_nodes) + 3))

    def page(points: np.ndarray) -> tuple[Point, ...]:
        """Convert pixels with y upwards to the picture's coordinates."""
        return tuple((float(x + lift[0]), float(extent[1] - y - lift[1])) for x, y in points)

    things: list[Polygon | Disc | Words] = [Polygon(page((floor - low) * scale), *COLOURS["ground"][1:])]
    things += [Polygon(page((outline - low) * scale), *COLOURS[side][1:]) for outline, side in shapes]
    at = page(nodes)
    for i, j in np.argwhere(np.triu(graph.adjacency + graph.adjacency.T)):
        things.append(Polygon((at[i], at[j]), None, _INK, 2.0))
        if graph.directed:
            things += [_arrow(at[b], at[a], radius) for a, b in ((i, j), (j, i)) if graph.adjacency[a, b]]
    colours = [_side_of_node(graph, sides, i) for i in range(graph.num_nodes)]
    for i, side in enumerate(colours):
        things.append(Disc(at[i], radius, COLOURS[side][0], "white"))
        things.append(Words(at[i], str(i), radius, "white", centred=True))
    names, width = _names(graph, colours, float(extent[0]))
    return Picture(round(width), round(height), (*things, *names))


def _flat(robot: Robot, points: np.ndarray) -> np.ndarray:
    """Project points of the world ``[K, 3]`` onto the picture's plane ``[K, 2]``, both in metres."""
    forward, side, up = (points @ robot.base.frame.T).T
    return np.stack([forward + ASLANT[0] * side, up + ASLANT[1] * side], axis=1)


def _sides(robot: Robot, data: mujoco.MjData) -> dict[str, str]:
    """Return whether each joint is on the right, the left or in the middle."""
    sides = {}
    for joint in robot.joints:
        other = robot.joint(robot.mirror[joint.name])
        right, left = (
            float(data.subtree_com[robot.model.jnt_bodyid[j.id]] @ robot.base.frame[1]) for j in (joint, other)
        )
        # If a pair shares one place (planar models), the joint called left is on the left, otherwise the later one.
        if abs(right - left) < 1e-6:
            right = -float("left" in other.name.lower() or ("left" not in joint.name.lower() and joint.id < other.id))
            left = 0.0 if right else -1.0
        sides[joint.name] = "middle" if other is joint else "right" if right < left else "left"
    return sides


def _silhouette(robot: Robot, data: mujoco.MjData, sides: dict[str, str]) -> list[tuple[np.ndarray, str]]:
    """Return the outlines ``[K, 2]`` (m) of the geoms and the side of each, the farthest first."""
    model, drawn = robot.model, []
    shown: list[int] = []
    for body in bodies_below(model, robot.base.root):
        geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
        shown += [g for g in geoms if model.geom_group[g] <= _VISIBLE] or geoms
    moved = {joint.body: sides[joint.name] for joint in robot.joints}
    for geom in shown:
        points = geom_points(model, data, geom)
        body = int(model.geom_bodyid[geom])
        while body_name(model, body) not in moved and body != robot.base.root:
            body = int(model.body_parentid[body])
        if len(points):
            depth = float(points.mean(axis=0) @ robot.base.frame[1])
            outline = convex_hull(_flat(robot, points))
            drawn.append((depth, outline, moved.get(body_name(model, body), "middle")))
    return [(outline, side) for _, outline, side in sorted(drawn, key=lambda item: -item[0])]


def _places(robot: Robot, graph: KinematicGraph, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes' places, ``[N, 2]``, and the corners of a piece of ground below the robot, ``[4, 2]`` (m)."""
    model, (forward, side, up) = robot.model, robot.base.frame
    bodies = {body_name(model, b): b for b in bodies_below(model, robot.base.root)}
    soles = np.array([_sole(robot, data, bodies[foot]) for foot in robot.feet])
    anchors = np.array([data.xanchor[joint.id] for joint in robot.joints])
    root = data.xpos[robot.base.root]
    reach = float(max(np.ptp(np.vstack([anchors, root]), axis=0).max(), 1e-3))
    step, ground = 0.1 * reach, float(soles[:, 2].min())
    near = anchors[np.abs((anchors - root) @ forward) < 2.0 * step]
    above = root + (max([0.0, *((near - root) @ up)]) + 1.2 * step) * up
    # A ground node lies on the ground in front of its feet, where the picture shows it straight below them.
    front = float((soles @ side).min()) - 1.2 * step / ASLANT[1]
    places, pairs, extra = [], iter(robot.foot_pairs), 0
    for kind, name in zip(graph.kinds, graph.nodes, strict=True):
        if kind == "root":
            places.append(root)
        elif kind == "base":
            places.append(above + (extra - 0.5 * (len(robot.base.extra) - 1)) * 0.8 * step * forward)
            extra += 1
        elif kind == "ground":
            middle = soles[list(next(pairs))].mean(axis=0)
            aside = float(middle @ side) - front
            places.append(middle - aside * side + ASLANT[0] * aside * forward + (ground - middle[2]) * up)
        else:
            places.append(data.xanchor[robot.joint(name).id])
    touching = [place for place, kind in zip(places, graph.kinds, strict=True) if kind == "ground"]
    spread = np.vstack([anchors, root, soles, *touching]) @ robot.base.frame.T
    (a, c, _), (b, d, _) = spread.min(axis=0) - 0.7 * step, spread.max(axis=0) + 0.7 * step
    floor = np.array([x * forward + y * side + ground * up for x, y in ((a, c), (b, c), (b, d), (a, d))])
    return _flat(robot, np.array(places)), _flat(robot, floor)


def _sole(robot: Robot, data: mujoco.MjData, body: int) -> np.ndarray:
    """Return the mean of a foot's lowest points; its origin if it has no colliding geom."""
    clouds = [geom_points(robot.model, data, g) for g in colliding_geoms(robot.model, body)]
    points = np.concatenate(clouds) if clouds else data.xpos[body][None]
    low = float(points[:, 2].min())
    middle = points[points[:, 2] < low + 1e-3].mean(axis=0)
    return np.array([middle[0], middle[1], low])


def _apart(places: np.ndarray, least: float) -> np.ndarray:
    """Move points ``[N, 2]`` apart until every two are about ``least`` apart."""
    # Points in one place leave it in different directions, sunflower-wise.
    turns = 2.4 * np.arange(len(places))
    spread = places + 1e-3 * least * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    for _ in range(400):
        gaps = spread[:, None] - spread[None]
        distance = np.linalg.norm(gaps, axis=-1) + np.eye(len(spread)) * least
        short = np.maximum(least - distance, 0.0)
        if short.max() < 0.02 * least:
            break
        spread = spread + 0.5 * (short[..., None] * gaps / distance[..., None]).sum(axis=1)
    return spread


def _arrow(tail: Point, head: Point, radius: float) -> Polygon:
    """Return the head of an arrow that ends at the rim of the node at ``head``."""
    along = np.array(head) - np.array(tail)
    along /= max(float(np.linalg.norm(along)), 1e-9)
    tip, across = np.array(head) - radius * along, np.array([-along[1], along[0]])
    back = tip - 0.9 * radius * along
    corners = (tip, back + 0.4 * radius * across, back - 0.4 * radius * across)
    return Polygon(tuple((float(x), float(y)) for x, y in corners), _INK, _INK)


def _side_of_node(graph: KinematicGraph, sides: dict[str, str], node: int) -> str:
    kind = graph.kinds[node]
    return "ground" if kind == "ground" else sides.get(graph.nodes[node], "middle")


def _names(graph: KinematicGraph, colours: list[str], left: float) -> tuple[list[Polygon | Disc | Words], float]:
    """Return the shapes of the list of nodes from ``left`` on, and its right end (pixels)."""
    things: list[Polygon | Disc | Words] = []
    for place, side in enumerate(side for side in ("right", "left", "middle") if side in colours):
        things.append(Words((left + 3.0 + 42.0 * place, 0.6 * _ROW), side, 12.0, COLOURS[side][0]))
    for first in range(0, graph.num_nodes, _ROWS):
        last = min(first + _ROWS, graph.num_nodes)
        for i in range(first, last):
            y = _ROW * (i - first + 1.7)
            things.append(Disc((left + 12.0, y), 9.0, COLOURS[colours[i]][0], "white"))
            things.append(Words((left + 12.0, y), str(i), 9.5, "white", centred=True))
            things.append(Words((left + 27.0, y), graph.nodes[i], 13.0, _INK))
        left += 45.0 + 7.6 * max(len(name) for name in graph.nodes[first:last])
    return things, left


def show_graph(config: DictConfig) -> None:
    """Print the graph that a configuration asks for, and draw it if ``out`` names a file."""
    # A robot's YAML also holds settings of its training.
    settings: GraphSettings = build(OmegaConf.masked_copy(config, ["_target_", *GraphSettings.__dataclass_fields__]))
    if settings.out is not None:
        check_writable(Path(settings.out))
    robot = settings.robot.load(settings.feet)
    graph = KinematicGraph.from_robot(robot, settings.robot.graph, settings.robot.graph_seed)
    if robot.origin:
        print(f"{robot.origin}\n")
    print(f"{quoted(robot.path)}: {robot.base.kind} base, forward {robot.forward_axis}, feet {', '.join(robot.feet)}")
    print(graph)
    if settings.out is not None:
        draw_graph(robot, graph, settings.size).save(Path(settings.out))
        print(f"\nWritten to {quoted(settings.out)}")
