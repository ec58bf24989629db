"""The picture of a graph shows every node and edge, without overlaps, and the command writes it."""

import re
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import gymnasium
import mujoco
import numpy as np
import pytest
from PIL import Image
from running import command

from gctd3.robots.geometry import convex_hull, geom_points
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.viz.graph_drawing import draw_graph
from gctd3.viz.svg_canvas import Disc, Polygon, Words

ANT = Path(gymnasium.__file__).parent / "envs/mujoco/assets/ant.xml"
SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize("source", ["biped", ANT])
def test_nodes_edges_and_names_are_drawn(source):
    robot = Robot.from_mjcf(source)
    graph = KinematicGraph.from_robot(robot)
    picture = draw_graph(robot, graph)
    discs = [thing for thing in picture.things if isinstance(thing, Disc)][: graph.num_nodes]
    centres = np.array([disc.centre for disc in discs])
    gaps = [np.linalg.norm(a - b) for a, b in combinations(centres, 2)]
    assert min(gaps) > 2 * discs[0].radius
    assert (centres > 0).all() and (centres < (picture.width, picture.height)).all()
    lines = {frozenset(thing.points) for thing in picture.things if isinstance(thing, Polygon) and not thing.fill}
    ends = {frozenset((discs[graph.nodes.index(a)].centre, discs[graph.nodes.index(b)].centre)) for a, b in graph.edges}
    assert lines == ends
    assert {thing.text for thing in picture.things if isinstance(thing, Words)} >= set(graph.nodes)


def test_sides_have_colours(robot, graph):
    discs = [thing for thing in draw_graph(robot, graph).things if isinstance(thing, Disc)]
    fills = dict(zip(graph.nodes, [disc.fill for disc in discs], strict=False))
    assert fills["hip_right"] == fills["ankle_right"] != fills["hip_left"] == fills["knee_left"] != fills["body"]


def test_command_writes_svg_and_png(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command("graph", f"robot={ANT}", "out=ant.svg") == 0
    said = capsys.readouterr().out
    assert "15 nodes, 17 edges" in said and "Written to ant.svg" in said and "free base" in said
    root = ElementTree.parse(tmp_path / "ant.svg").getroot()
    assert {text.text for text in root.iter(f"{SVG}text")} >= {"hip_1", "ground_2"}
    assert command("graph", "robot=biped", "feet=[foot_left]", "out=biped.png", "size=300") == 0
    assert "feet foot_left" in capsys.readouterr().out
    with Image.open(tmp_path / "biped.png") as image:
        assert len(image.convert("RGB").getcolors(1 << 20)) > 50
    # Options of robots have keys of a training, too.
    for robot in ("biped", "quadruped"):
        assert command("graph", f"robot={robot}", "out=null") == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ant.svg", "biped.png"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("out=graph.pdf",), "out must end in .svg or .png"),
        (("out=nowhere/graph.svg",), "there is no folder"),
        (("feet=[toe]",), "no body, geom or site 'toe'"),
        (("robot=none.xml",), "No MJCF file at none.xml"),
        (("siz=3",), "Did you mean 'size'"),
    ],
)
def test_command_says_what_is_wrong(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command("graph", *arguments) == 2
    assert re.search(re.escape(said), capsys.readouterr().err)


def test_a_place_that_cannot_be_written_is_said_first(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "gctd3.files._make_file", lambda path: (_ for _ in ()).throw(PermissionError(13, "Not allowed"))
    )
    assert command("graph", "robot=biped") == 2
    said = capsys.readouterr()
    assert said.err == f"error: out=graph.svg cannot be written: Not allowed: {tmp_path}.\n" and not said.out


def test_hull_of_a_square_with_points_inside():
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5], [0.2, 0.9], [0.5, 0.0]])
    assert sorted(map(tuple, convex_hull(points))) == [(0, 0), (0, 1), (1, 0), (1, 1)]


def test_points_of_the_sole_and_thigh(robot):
    data = mujoco.MjData(robot.model)
    mujoco.mj_kinematics(robot.model, data)
    sole = geom_points(robot.model, data, robot.model.geom("foot_right").id)
    # Ankle at x 0, y -0.1, z 0.0935; the sole from -0.055 to 0.1 and 0.070 below.
    np.testing.assert_allclose(sole.min(axis=0), (-0.055, -0.135, 0.0235), atol=1e-9)
    np.testing.assert_allclose(sole.max(axis=0), (0.1, -0.065, 0.0485), atol=1e-9)
    thigh = geom_points(robot.model, data, robot.model.geom("thigh_right").id)
    # Hip at z 0.613: the capsule's axis ends 0.2467 below it, its radius is 0.028.
    assert thigh[:, 2].min() == pytest.approx(0.613 - 0.2467 - 0.028)
