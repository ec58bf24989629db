"""The benchmark of many robots: what it compares with, what it finds wrong, and that it goes on where it stopped."""

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from robots import FREE_LEGS, TWO_LEGS, write

from gctd3.robots.mjcf import shipped_robots
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def bench(monkeypatch):
    """The program, under another name than that of the tests' robots."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    spec = importlib.util.spec_from_file_location("benchmark_of_robots", BENCHMARKS / "robots.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


def a_list(folder, files, **more):
    file = folder / "list.json"
    file.write_text(json.dumps({"packages": {}, "left_out": {}, "mjcf": {"": files}, **more}))
    return file


# The list.


def test_list_names_each_file_once_and_fifteen_urdfs(bench):
    places = [one.place for one in bench.listed()]
    assert len(places) == len(set(places))
    kinds = [one.kind for one in bench.listed()]
    assert kinds.count("urdf") == 15
    assert {one.package for one in bench.listed() if one.kind == "mjcf"} == set(
        json.loads(bench.LIST.read_text())["packages"]
    )
    assert {one.feet for one in bench.listed()} == {1, 2, 4}
    assert all(one.place.endswith(f".{'urdf' if one.kind == 'urdf' else 'xml'}") for one in bench.listed())


def test_files_that_nobody_listed_are_named(bench, tmp_path, monkeypatch):
    for name in ("a/dog.xml", "a/hand.xml", "cat.xml"):
        (tmp_path / "brings" / "robots" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "brings" / "robots" / name).write_text("<mujoco/>")
    (tmp_path / "brings" / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(str(tmp_path))
    said = {"packages": {"brings": "robots", "not_installed": "x"}, "left_out": {"*hand*": "a hand"}}
    file = a_list(tmp_path, {"brings:robots/cat.xml": 4}, **said)
    assert bench.unlisted(file) == ["brings:robots/a/dog.xml"]


# What files state.


def test_tree_of_an_mjcf_is_its_driven_joints(bench, tmp_path):
    shank = '<body name="shank_r" pos="0 0 -0.5"><joint name="knee_r"/><geom size="0.02"/></body>'
    text = TWO_LEGS.replace('size="0.02"/>\n      </body>', f'size="0.02"/>\n{shank}</body>', 1)
    passive = write(tmp_path, text)
    assert bench.stated_tree(passive, "torso") == {"hip_r": None, "hip_l": None}
    driven = write(tmp_path, text.replace("</actuator>", '<motor joint="knee_r"/></actuator>'))
    assert bench.stated_tree(driven, "torso") == {"hip_r": None, "knee_r": "hip_r", "hip_l": None}
    begin, end = text.index("<actuator>"), text.index("</actuator>") + len("</actuator>")
    none = write(tmp_path, text[:begin] + text[end:])
    assert bench.stated_tree(none, "torso") == {"hip_r": None, "knee_r": "hip_r", "hip_l": None}


URDF = """
<robot name="legs">
  <link name="base"/> <link name="mount"/> <link name="thigh"/> <link name="tip"/>
  <link name="shank"> <inertial><mass value="1"/></inertial> </link>
  <link name="finger"> <inertial><mass value="1"/></inertial> </link>
  <joint name="moves_nothing" type="revolute"> <parent link="shank"/> <child link="tip"/> </joint>
  <joint name="fixed" type="fixed"> <parent link="base"/> <child link="mount"/> </joint>
  <joint name="knee" type="continuous"> <parent link="thigh"/> <child link="shank"/> </joint>
  <joint name="hip" type="revolute"> <parent link="mount"/> <child link="thigh"/> </joint>
  <joint name="follows" type="revolute"> <parent link="shank"/> <child link="finger"/> <mimic joint="knee"/> </joint>
</robot>
"""


def test_tree_of_a_urdf_is_its_joints_that_move_by_themselves(bench, tmp_path):
    file = tmp_path / "legs.urdf"
    file.write_text(URDF)
    assert bench.stated_tree(file, "base") == {"knee": "hip", "hip": None}


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "box", "ellipsoid", "mesh"])
def test_lowest_point_is_as_far_from_the_ground_as_mujoco_says(bench, kind):
    vertices = " ".join(str(x) for x in np.random.default_rng(3).normal(size=(20, 3)).ravel())
    shape = 'type="mesh" mesh="m"' if kind == "mesh" else f'type="{kind}" size="0.1 0.2 0.3"'
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco> <asset><mesh name="m" vertex="{vertices}"/></asset>
        <worldbody> <geom type="plane" size="9 9 1"/> <body pos="0.1 0.2 5"><freejoint/><geom {shape}/></body>
        </worldbody> </mujoco>""")
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(5):
        data.qpos[3:7] = rng.normal(size=4)
        mujoco.mj_forward(model, data)
        assert bench.lowest(model, data, 1) == pytest.approx(
            mujoco.mj_geomDistance(model, data, 0, 1, 99.0, None), abs=1e-6
        )


# What is wrong.


@pytest.mark.parametrize(("name", "feet"), [("biped", 2), ("biped_planar", 2), ("quadruped", 4), ("hexapod", 6)])
def test_nothing_is_wrong_with_the_robots_that_ship(bench, name, feet):
    robot = RobotSettings(name).load()
    tree = bench.stated_tree(robot.path, robot.root)
    wrong = [*bench.wrong_nodes(robot, tree), *bench.wrong_feet(robot, feet), *bench.wrong_pairs(robot)]
    assert wrong == []
    assert set(tree) == set(robot.actuated)
    assert name in shipped_robots()


def test_faults_are_found_and_named(bench, tmp_path):
    robot = Robot.from_mjcf(write(tmp_path, FREE_LEGS))
    tree = {"hip_r": None, "hip_l": "hip_r", "tail": None}
    assert list(bench.wrong_nodes(robot, tree)) == [
        "joint tail is no node",
        "node hip_l hangs on torso instead of hip_r",
    ]
    assert list(bench.wrong_nodes(robot, {"hip_r": None})) == ["node hip_l is no driven joint"]
    assert list(bench.wrong_feet(robot, 4)) == ["2 feet instead of 4: leg_r, leg_l"]
    kneeling = Robot.from_mjcf("quadruped", feet=["shank_front_right", "foot_hind_right"])
    assert [fault for fault in bench.wrong_feet(kneeling, 2) if "end" in fault] == [
        "foot shank_front_right is no end of a leg"
    ]
    lame = replace(robot, feet=("torso", "leg_l"))
    assert "foot torso is no end of a leg" in list(bench.wrong_feet(lame, 2))
    assert any(fault.startswith("foot torso is 0.4") for fault in bench.wrong_feet(lame, 2))
    assert list(bench.wrong_pairs(robot)) == []
    pairs = robot._mirror.pairs
    robot.__dict__["_mirror"] = SimpleNamespace(pairs=pairs, feet=(0, 1))
    assert list(bench.wrong_pairs(robot)) == ["2 of 2 feet have no mirror image"]
    crossed = SimpleNamespace(images={"hip_r": "hip_l", "hip_l": "hip_l"})
    robot.__dict__["_mirror"] = SimpleNamespace(pairs=crossed, feet=(0, 1))
    assert "joint hip_r is not the mirror image of its own" in list(bench.wrong_pairs(robot))


def test_a_robot_that_is_held_falls_or_stands(bench, tmp_path):
    rods = FREE_LEGS.replace('pos="0 0 1"', 'pos="0 0 0.52"')
    leaning = rods.replace('name="torso" size="0.1"', 'name="torso" pos="0.2 0 0" size="0.1"')
    fell = bench.hold(Robot.from_mjcf(write(tmp_path, leaning)))
    assert fell["stands"] is False
    assert 0.1 < fell["fell_after_s"] < 3.0
    assert fell["pose_held_by_times"] is None  # its weight is beside its feet
    boxes = rods.replace(
        'type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02"', 'type="box" pos="0 0 -0.4" size="0.2 0.05 0.1"'
    )
    stood = bench.hold(Robot.from_mjcf(write(tmp_path, boxes.replace("<position ", '<position kp="100" kv="5" '))))
    assert stood["stands"] is True
    assert "pose_held_by_times" not in stood
    nodding = boxes.replace('name="torso" size="0.1"', 'name="torso" pos="0.02 0 0.1" size="0.1"')
    soft = bench.hold(Robot.from_mjcf(write(tmp_path, nodding.replace("<position ", '<position kp="1" kv="0.1" '))))
    assert (soft["stands"], soft["pose_held_by_times"]) == (False, 3.0)
    assert stood["feet_down"] == 2 and stood["tilt_rad"] < 0.02
    assert stood["height_m"] == pytest.approx(0.5, abs=0.01)


# Going on.


def test_it_goes_on_where_it_stopped_and_counts_what_fails(bench, tmp_path, monkeypatch, capsys):
    asked = []
    right = {"done": list(bench.STAGES), "faults": [], "seconds": 1.0, "mirror": {"symmetric": True, "residual": 0.0}}
    rows = {
        "good.xml": {**right, "hold": {"stands": True}},
        "falls.xml": {**right, "hold": {"stands": False, "fell_after_s": 0.5, "pose_held_by_times": 3.0}},
        "feet.xml": {
            **right,
            "hold": {"stands": True},
            "faults": ["3 feet instead of 4"],
            "mirror": {"symmetric": False},
        },
        "bad.xml": {"done": ["found"], "faults": [], "failed_at": "read", "error": "no foot"},
    }

    def read_apart(one, limit):
        asked.append(one.place)
        if asked == ["good.xml", "falls.xml"]:
            raise KeyboardInterrupt
        return {"place": one.place, **rows[one.place]}

    monkeypatch.setattr(bench, "read_apart", read_apart)
    file = a_list(tmp_path, dict.fromkeys(rows, 4))
    given = {"runs": str(tmp_path / "runs"), "only": "", "again": "", "limit": "9"}
    with pytest.raises(KeyboardInterrupt):
        bench.read_all(given, file)
    found = bench.read_all(given, file)
    assert asked == ["good.xml", "falls.xml", "falls.xml", "feet.xml", "bad.xml"]
    counted = {"files": 4, "start": 3, "graph_right": 2, "hold": 2, "pose_if_stiffer": 1, "mirrored": 2}
    assert bench.score(found) == {"gctd3": counted, "all mjcf": counted}
    assert bench.reasons(found) == {
        "falls, but the pose itself is held by servos 3 times as stiff": ["falls.xml"],
        "3 feet instead of 4": ["feet.xml"],
        "fails at read: no foot": ["bad.xml"],
    }
    del asked[:]
    assert bench.read_all(given, file) == found
    assert asked == []
    bench.read_all({**given, "again": "failed", "only": "f"}, file)
    assert asked == ["falls.xml", "feet.xml"]
    assert "bad.xml: fails at read: no foot" in capsys.readouterr().out
    # Cells of a table's lines are as many as its head's.
    text = bench.tables({"score": bench.score(found), "rows": found}, None)
    for part in text.split("\n\n"):
        assert len({line.count("|") for line in part.splitlines()}) == 1
    assert "| gctd3 | 4 | 3 | 2 | 2 | 1 | 2 |" in text
    assert "| bad.xml (gctd3) | none stated |  |  | no |  |  |  | no foot |" in text


def test_trainings_are_counted_whatever_becomes_of_them(bench, tmp_path, monkeypatch):
    walked = {"frames": 100_000, "finishes": 50, "episodes": 50, "speed_m_s": 1.0, "stride_hz": 2.0, "slip_m_s": 0.1}
    walked |= {"periodic_share": 1.0, "height_from_home": -0.05, "saturation_percent": 3.0}
    calls = []

    def run(line, stdout, **_):
        calls.append(line)
        stdout.write("error: no legs\n")
        return SimpleNamespace(returncode=2 if "robot=bad" in line else 0)

    monkeypatch.setattr(bench.subprocess, "run", run)
    monkeypatch.setattr(bench, "commit", lambda: "abc")
    monkeypatch.setattr(bench, "evaluated", lambda folder: dict(walked, finishes=50 if folder.name == "seed0" else 49))
    given = {"runs": str(tmp_path), "robots": "go1,bad", "seeds": "0,1", "threads": "1", "again": ""}
    rows = bench.train_all(given, ["total_frames=9"])
    assert [row.get("failed") for row in rows] == [None, None, *["exit code 2: error: no legs"] * 2]
    trainings = [line for line in calls if "gctd3.train" in line]
    assert {"threads=1", "env.threads=1", "total_frames=9", "robot=go1", "seed=1"} < set(trainings[1])
    assert [line for line in calls if "gctd3.evaluate" in line and "episodes=50" not in line] == []
    assert bench.train_all(given, []) == rows
    assert len(calls) == 6
    lines = bench.tables(None, {"rows": rows}).splitlines()
    assert lines[2].startswith("| go1 | 1 of 2 | 100,000 | 0 | 1.00 | 2.0 | 100% | 0.10 | -5% | 3 % |")
    assert lines[3] == "| bad | 0 of 2 | - | - | - | - | - | - | - | - |"


def test_options_are_checked(bench, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["robots.py", "ouput=x.json"])
    with pytest.raises(SystemExit, match=r"^unknown ouput=x.json; accepted: .*="):
        bench.main()
    monkeypatch.setattr(sys, "argv", ["robots.py", "what=walk"])
    with pytest.raises(SystemExit, match="what must be read, train, table or unlisted, got walk"):
        bench.main()


def program(*arguments, folder):
    line = [sys.executable, str(BENCHMARKS / "robots.py"), f"runs={folder / 'runs'}", *arguments]
    return subprocess.run(line, capture_output=True, text=True, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})


@pytest.mark.nightly
def test_shipped_robots_and_a_file_of_ones_own_are_read(tmp_path):
    own, damaged = write(tmp_path, FREE_LEGS), tmp_path / "damaged.xml"
    damaged.write_text("<mujoco")
    file, out = a_list(tmp_path, {"biped_planar": 2, "hexapod": 6, str(own): 2, str(damaged): 2}), tmp_path / "out.json"
    said = program(f"list={file}", f"out={out}", folder=tmp_path).stdout
    found = json.loads(out.read_text())
    assert [row["done"][-1] for row in found["rows"][:3]] == ["hold"] * 3
    assert [row["faults"] for row in found["rows"]] == [[]] * 4
    assert found["rows"][3]["failed_at"] == "read"
    assert (found["score"]["all mjcf"]["files"], found["score"]["all mjcf"]["start"]) == (4, 3)
    assert str(damaged) in said
    # Nothing is read twice, and a limit ends what takes longer.
    again = program(f"list={file}", "again=all", "only=hexapod", "limit=0.01", folder=tmp_path).stdout
    assert "hexapod: fails at time: not within 0.01 s" in again
    assert "biped_planar: starts" not in again


@pytest.mark.nightly
def test_a_robot_is_trained_and_evaluated(bench, tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "EPISODES", 2)
    short = ["total_frames=600", "exploration.learning_starts=300", "env.num_envs=4", "gradient_steps=1", "logger=none"]
    given = {"runs": str(tmp_path), "robots": "quadruped", "seeds": "3", "threads": "1", "again": ""}
    row = bench.train_all(given, short)[0]
    assert (row["frames"], row["episodes"], row["finishes"]) == (600, 2, 0)
    assert (row["package"], row["periodic_share"]) == ("gctd3", None)
    assert row["speed_m_s"] == row["evaluation"]["velocity_mean"]
    assert (tmp_path / "train" / "quadruped" / "seed3" / "evaluation.json").is_file()
