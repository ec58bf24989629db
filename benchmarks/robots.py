"""Do robots train as they are? Reads every legged robot of the packages that bring some, and trains those named.

    python benchmarks/robots.py out=benchmarks/results/robots_read.json
    python benchmarks/robots.py only=go1 again=failed
    python benchmarks/robots.py what=train robots=go1,go2 seeds=0,1,2 threads=2 out=benchmarks/results/robots_train.json
    python benchmarks/robots.py what=table
    python benchmarks/robots.py what=unlisted

``robots.json`` lists the files, with the number of feet that a person counts on each. ``what=read`` takes each as
``python -m gctd3.train robot=FILE`` does, in a process of its own with a time limit: it reads and completes the file,
compares the graph with the tree of joints that the file itself states, takes 200 random control steps of two robots,
begins a training, and holds action 0 for three seconds. ``what=train`` trains robots by their names, times the whole
command, and evaluates 50 episodes. Both go on where they stopped: what is done lies in ``runs``, a file each; a
training that was interrupted begins anew. ``again=failed`` or ``again=all`` does it once more. ``what=table`` prints
both results in Markdown. ``what=unlisted`` names the files of the packages that the list neither holds nor leaves out.
"""

from __future__ import annotations

import contextlib
import copy
import json
import multiprocessing
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from importlib import metadata
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from common import commit, options, report

from gctd3.files import title, write_text
from gctd3.robots.actuators import rest_servos
from gctd3.robots.robot import Robot

LIST = Path(__file__).with_name("robots.json")
RESULTS = Path(__file__).parent / "results"
STEPS, ROBOTS = 200, 2  # random control steps of so many robots
EPISODES = 50
HOLD = 3.0  # s
TILTED, DROPPED = 0.8, 0.3  # rad, and share of the body's height above its feet: a robot that holds a pose has fallen
TOUCHING = 0.05  # of the robot's height: how far above the lowest foot another one still stands
STIFFER = (1.0, 3.0, 10.0)  # times: with which servos the pose itself is held, where action 0 does not hold it
STAGES = ("found", "read", "graph", "steps", "trains")
PACKAGES = ("gctd3", "mujoco", "torch", "torchrl", "numpy")


@dataclass(frozen=True)
class Listed:
    """A file of the list: its place, as ``robot=`` takes it, what it is counted under, and the feet that it has."""

    place: str
    package: str
    kind: str
    feet: int


def listed(file: Path = LIST) -> list[Listed]:
    """All files of the list, in its order."""
    return [
        Listed(f"{folder}{path}", folder.partition(":")[0] or "gctd3", kind, feet)
        for kind in ("mjcf", "urdf")
        for folder, paths in json.loads(file.read_text()).get(kind, {}).items()
        for path, feet in paths.items()
    ]


def unlisted(file: Path = LIST) -> list[str]:
    """MJCF files of the installed packages that the list neither holds nor leaves out; its URDFs are chosen by name."""
    said, known = json.loads(file.read_text()), {one.place for one in listed(file)}
    found = []
    for package, folder in said["packages"].items():
        spec = find_spec(package)
        for root in spec.submodule_search_locations or [] if spec else []:
            for path in sorted(Path(root, folder).rglob("*.xml")):
                place = f"{package}:{path.relative_to(root).as_posix()}"
                if place not in known and not any(fnmatch(place, pattern) for pattern in said["left_out"]):
                    found.append(place)
    return found


# What the file itself states, read without gctd3.

Tree = dict[str, str | None]  # each driven joint and the next one above it; None below the root


def stated_tree(file: Path, root: str) -> Tree:
    """The driven joints below the root, as the file states them: all of its hinges and slides if it drives none."""
    if ElementTree.parse(file).getroot().tag == "robot":
        return _urdf_tree(file)
    spec, chains, count = mujoco.MjSpec.from_file(str(file)), dict[str, list[str]](), 0
    moving = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    kinds = dict[str, bool]()

    def walk(body: mujoco.MjsBody, above: list[str], inside: bool) -> None:
        nonlocal count
        for joint in body.joints:
            name = joint.name or f"joint_{count}"
            count += 1
            if inside:
                chains[name], kinds[name], above = above, joint.type in moving, [*above, name]
        for child in body.bodies:
            walk(child, above, inside or body.name == root)

    walk(spec.worldbody, [], False)
    on_joint = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    driven = {actuator.target for actuator in spec.actuators if actuator.trntype in on_joint} & set(chains)
    driven = driven or {name for name, moves in kinds.items() if moves}
    return _next_above({name: chains[name] for name in chains if name in driven})


def _urdf_tree(file: Path) -> Tree:
    robot = ElementTree.parse(file).getroot()
    joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}

    def link(joint: str, end: str) -> str | None:
        found = joints[joint].find(end)
        return None if found is None else found.get("link")

    above = {link(name, "child"): name for name in joints}
    masses = {one.get("name"): one.find("inertial/mass") for one in robot.findall("link")}

    def moves_mass(joint: str) -> bool:
        here = link(joint, "child")
        mass = masses.get(here)
        heavy = mass is not None and float(mass.get("value", "0")) > 0
        return heavy or any(moves_mass(other) for other in joints if link(other, "parent") == here)

    turns = ("revolute", "continuous", "prismatic")
    driven = [n for n, joint in joints.items() if joint.get("type") in turns and joint.find("mimic") is None]
    # What moves nothing that has a mass is no part of a mechanical system.
    driven = [name for name in driven if moves_mass(name)]
    chains = dict[str, list[str]]()
    for name in driven:
        chain, now = list[str](), above.get(link(name, "parent"))
        while now is not None:
            chain, now = [now, *chain], above.get(link(now, "parent"))
        chains[name] = chain
    return _next_above(chains)


def _next_above(chains: dict[str, list[str]]) -> Tree:
    return {name: next((j for j in reversed(chain) if j in chains), None) for name, chain in chains.items()}


# What gctd3 made of it, compared.


def wrong_nodes(robot: Robot, tree: Tree) -> Iterator[str]:
    """Return the faults of the graph's joints, compared with the tree that the file states."""
    from gctd3.robots.graph import KinematicGraph

    graph = KinematicGraph.from_robot(robot)
    joints = ("hinge", "slide", "ball")
    found = {n: p[0] for n, p, kind in zip(graph.nodes, graph.parents, graph.kinds, strict=True) if kind in joints}
    for name in [name for name in tree if name not in found and name not in robot.held]:
        yield f"joint {name} is no node"
    for name in [name for name in found if name not in tree]:
        yield f"node {name} is no driven joint"
    edges = {frozenset((graph.nodes[i], graph.nodes[k])) for i, k in zip(*np.nonzero(graph.adjacency), strict=True)}
    for name in [name for name in tree if name in found]:
        parent = tree[name] or graph.nodes[0]
        if found[name] != parent or frozenset((name, parent)) not in edges:
            yield f"node {name} hangs on {found[name]} instead of {parent}"


def wrong_feet(robot: Robot, count: int) -> Iterator[str]:
    """Return the faults of the feet: ends of legs, on the ground as the robot stands, as many as a person counts."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(model, data)
    if len(robot.feet) != count:
        yield f"{len(robot.feet)} feet instead of {count}: {', '.join(robot.feet)}"
    moved = {int(model.jnt_bodyid[joint.id]) for joint in robot.joints}
    lows = dict[str, float]()
    for foot in robot.feet:
        body = int(model.body(foot).id)
        if any(b != body and body in _ancestors(model, b) for b in moved):
            yield f"foot {foot} is no end of a leg"
        lows[foot] = min((lowest(model, data, g) for g in _colliding(model, body)), default=np.nan)
    height = float(data.xpos[1:, 2].max()) - min(lows.values())
    for foot, low in lows.items():
        if not low <= min(lows.values()) + TOUCHING * height:
            yield f"foot {foot} is {low - min(lows.values()):.3f} m above the ground"


def wrong_pairs(robot: Robot) -> Iterator[str]:
    """Return the faults of the mirror: images of images, and feet without one where the base is free."""
    images = robot.mirror
    for name in [name for name in images if images[images[name]] != name]:
        yield f"joint {name} is not the mirror image of its own"
    feet = robot.mirror_feet
    if any(feet[other] != i for i, other in enumerate(feet)):
        yield "the feet's mirror images are no pairs"
    alone = sum(other == i for i, other in enumerate(feet))
    if robot.base.free is not None and alone > len(feet) % 2:
        yield f"{alone} of {len(feet)} feet have no mirror image"
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(model, data)
    height = float(np.ptp(data.xpos[1:, 2]))
    along, _, up = robot.base.frame
    for name, other in images.items():
        apart = data.xanchor[robot.joint(name).id] - data.xanchor[robot.joint(other).id]
        if name < other and max(abs(float(along @ apart)), abs(float(up @ apart))) > 0.2 * height:
            yield f"joints {name} and {other} are a pair and not opposite"


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    found = list[int]()
    while body := int(model.body_parentid[body]):
        found.append(body)
    return found


def _colliding(model: mujoco.MjModel, body: int) -> list[int]:
    """A foot's geoms: those of its body, and of what is fixed to it, that can touch anything."""
    paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    fixed = [b for b in range(model.nbody) if model.body_weldid[b] == model.body_weldid[body]]
    within = [b for b in fixed if b == body or body in _ancestors(model, b)]
    geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in within]
    return [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g] or g in paired]


def lowest(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height of a geom's lowest point (m), by the support function of its shape."""
    down, size = -data.geom_xmat[geom].reshape(3, 3)[2], model.geom_size[geom]
    kinds, kind = mujoco.mjtGeom, int(model.geom_type[geom])
    if kind == kinds.mjGEOM_SPHERE:
        reach = size[0]
    elif kind == kinds.mjGEOM_CAPSULE:
        reach = size[0] + size[1] * abs(down[2])
    elif kind == kinds.mjGEOM_CYLINDER:
        reach = size[0] * np.hypot(down[0], down[1]) + size[1] * abs(down[2])
    elif kind == kinds.mjGEOM_BOX:
        reach = np.abs(down) @ size
    elif kind == kinds.mjGEOM_ELLIPSOID:
        reach = np.linalg.norm(down * size)
    elif kind == kinds.mjGEOM_MESH:
        start, count = (int(x[model.geom_dataid[geom]]) for x in (model.mesh_vertadr, model.mesh_vertnum))
        reach = (model.mesh_vert[start : start + count] @ down).max()
    else:
        return float("nan")
    return float(data.geom_xpos[geom][2] - reach)


def hold(robot: Robot) -> dict[str, Any]:
    """Hold action 0 for three seconds, from where episodes begin; if it falls, the pose itself by stiffer servos."""
    held = _hold(robot)
    return held if held["stands"] else {**held, "pose_held_by_times": next(filter(_pose_held(robot), STIFFER), None)}


def _pose_held(robot: Robot) -> Callable[[float], bool]:
    """Whether servos of the same torques, so many times as stiff, hold the standing pose."""

    def held(times: float) -> bool:
        model = copy.copy(robot.model)
        model.actuator_gainprm[:, 0] *= times
        model.actuator_biasprm[:, 1] *= times
        model.actuator_biasprm[:, 2] *= np.sqrt(times)
        scale = robot.action_scale or (1.0,) * len(robot.actuated)
        return bool(_hold(replace(robot, model=model, action_scale=scale, standing_command=None))["stands"])

    return held


def _hold(robot: Robot) -> dict[str, Any]:
    model, data = robot.model, mujoco.MjData(robot.model)
    root = int(model.body(robot.root).id)
    data.qpos[:] = robot.start_qpos
    data.ctrl[:] = robot.desired_angles(np.zeros(len(robot.actuated)))
    rest_servos(model, data)
    mujoco.mj_forward(model, data)
    begun, upright = float(data.xpos[root, 2]), data.xmat[root].reshape(3, 3).copy()
    soles = [lowest(model, data, geom) for foot in robot.feet for geom in _colliding(model, int(model.body(foot).id))]
    height, fell = begun - min(soles), None
    joints = [robot.joint(name).qpos for name in robot.actuated]
    away = tilt = 0.0
    while fell is None and data.time < HOLD:
        mujoco.mj_step(model, data)
        turned = (data.xmat[root].reshape(3, 3) @ upright.T)[2, 2]
        tilt = float(np.arccos(np.clip(turned, -1.0, 1.0)))
        away = float(np.abs(data.qpos[joints] - robot.start_qpos[joints]).max())
        # A simulation that fails begins again, and its clock with it.
        failed = data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number > 0 or not np.isfinite(data.qpos).all()
        if failed or tilt > TILTED or data.xpos[root, 2] < begun - DROPPED * height:
            fell = round(float(data.time), 3)
    feet = {int(model.body(foot).id) for foot in robot.feet}
    pairs = [{int(model.geom_bodyid[g]) for g in contact.geom} for contact in data.contact]
    down = [foot for foot in feet if any({0, foot} == pair for pair in pairs)]
    return {
        "stands": fell is None,
        "fell_after_s": fell,
        "tilt_rad": round(tilt, 4),
        "sank_m": round(begun - float(data.xpos[root, 2]), 4),
        "height_m": round(height, 4),
        "away_rad": round(away, 4),
        "feet_down": len(down),
    }


def read(place: str, feet: int) -> dict[str, Any]:
    """Everything about one file, up to the stage that fails."""
    row: dict[str, Any] = {"place": place, "commit": commit(), "done": [], "faults": []}
    began = time.perf_counter()
    try:
        _read(place, feet, row)
    except Exception as error:  # whatever it is, it is the result
        kind = type(error).__name__
        # Where files are on this machine is nobody's business.
        said = " ".join(str(error).split())
        for folder in sorted({str(Path(p).resolve()) for p in sys.path if p}, key=len, reverse=True):
            said = said.replace(f"{folder}/", "")
        row |= {"failed_at": STAGES[len(row["done"])] if len(row["done"]) < len(STAGES) else "hold"}
        row |= {"error": said if kind in ("RobotError", "ConfigError") else f"{kind}: {said}"}
    return {**row, "seconds": round(time.perf_counter() - began, 2)}


def _read(place: str, feet: int, row: dict[str, Any]) -> None:
    import torch
    from hydra import compose, initialize_config_module

    import gctd3.config.command_line  # noqa: F401 - the resolver of its configurations
    from gctd3.config.build import build
    from gctd3.envs.factory import build_env
    from gctd3.robots.command_line import robot_file
    from gctd3.robots.sources import find_place, find_source
    from gctd3.training.trainer import Trainer

    torch.set_num_threads(1)
    # As the command does; a name of conf/robot is one, too.
    chosen = robot_file([f"robot={place}"])
    small = [f"env.num_envs={ROBOTS}", "env.threads=1", "env.check=true", "threads=1", "logger=none"]
    small += ["total_frames=300", "exploration.learning_starts=250", "gradient_steps=1"]
    small += ["evaluation.episodes=1", "seed=0"]
    named = find_place(place) if ":" in place else None
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        settings = build(compose("config", [*chosen, *small]))
    source = named or find_source(settings.robot)
    row |= {"package": source.package, "version": source.version, "licence": source.licence}
    row |= {"sha256": source.sha256, "recipe": "free" if "robot=free" in chosen else "walk"}
    row["done"].append("found")

    robot = settings.robot.load()
    row |= {"joints": len(robot.joints), "actions": len(robot.actuated), "feet": list(robot.feet)}
    row |= {"free_base": robot.base.free is not None, "forward": robot.forward_axis}
    row |= {"hips": [hip.name for hip in robot.hips], "notes": list(robot.notes)}
    row["done"].append("read")

    tree = stated_tree(source.file, robot.root)
    row["faults"] = [*wrong_nodes(robot, tree), *wrong_feet(robot, feet), *wrong_pairs(robot)]
    row["done"].append("graph")

    settings.check_here()
    setup = settings.setup()
    check = setup.mirror_check
    residual = None if np.isnan(check.residual) else round(check.residual, 6)
    row["mirror"] = {"symmetric": check.symmetric, "residual": residual, "reason": check.reason}
    env = build_env(setup.task, settings.env, seed=0)
    env.set_seed(0)
    env.rollout(STEPS, auto_reset=True, break_when_any_done=False)
    row["done"].append("steps")

    with tempfile.TemporaryDirectory() as folder:
        trainer = Trainer(settings, Path(folder), setup=setup)
        trainer.run()
        row["diverged"] = trainer.counters.diverged
    row["done"].append("trains")
    row["hold"] = hold(robot)
    row["done"].append("hold")


def _answer(to: Connection, place: str, feet: int) -> None:
    # The bar of each training would break into the lines of this program.
    with open(os.devnull, "w") as nothing, contextlib.redirect_stderr(nothing), contextlib.redirect_stdout(nothing):
        row = read(place, feet)
    to.send(row)


def read_apart(one: Listed, limit: float) -> dict[str, Any]:
    """The same in a process of its own, which may crash or hang."""
    # A server that has imported everything forks, which is quicker than to begin anew.
    context = multiprocessing.get_context("forkserver" if os.name == "posix" else "spawn")
    if os.name == "posix":
        context.set_forkserver_preload(["gctd3.training.trainer", "gctd3.config.command_line"])
    ours, theirs = context.Pipe(duplex=False)
    process, began = context.Process(target=_answer, args=(theirs, one.place, one.feet)), time.perf_counter()
    about = {"place": one.place, "commit": commit(), "done": [], "faults": []}
    process.start()
    theirs.close()
    try:
        if not ours.poll(limit):
            process.kill()
            return {**about, "failed_at": "time", "error": f"not within {limit:g} s", "seconds": limit}
        row: dict[str, Any] = ours.recv()
        return row
    except EOFError:
        process.join()
        seconds = round(time.perf_counter() - began, 2)
        return {**about, "failed_at": "crash", "error": f"exit code {process.exitcode}", "seconds": seconds}
    finally:
        process.join()
        ours.close()


def read_all(given: dict[str, str], file: Path) -> list[dict[str, Any]]:
    """Read every file of the list that is not read yet, and return what is known of all."""
    folder, rows = Path(given["runs"]) / "read", []
    folder.mkdir(parents=True, exist_ok=True)
    for one in listed(file):
        # The suffix too, as some robots are there in both formats.
        kept = folder / f"{one.place.replace(':', '_').replace('/', '_')}.json"
        row = json.loads(kept.read_text()) if kept.is_file() else None
        asked = given["only"] in one.place
        again = given["again"] == "all" or (given["again"] == "failed" and not (row and walks_in(row)))
        if asked and (row is None or again):
            row = read_apart(one, float(given["limit"]))
            write_text(kept, json.dumps(row, indent=1) + "\n")
            print(line_of(row), flush=True)
        if row is not None:
            rows.append({**row, "counted_under": one.package, "kind": one.kind, "feet_counted": one.feet})
    return rows


def walks_in(row: dict[str, Any]) -> bool:
    """Whether a file has passed in everything."""
    return "trains" in row["done"] and not row["faults"] and bool(row.get("hold", {}).get("stands"))


def line_of(row: dict[str, Any]) -> str:
    """One file, for the screen."""
    if "error" in row:
        return f"{row['place']}: fails at {row['failed_at']}: {row['error']}"
    held, mirror = row["hold"], row["mirror"]
    stands = "holds" if held["stands"] else f"falls after {held['fell_after_s']:g} s"
    said = f"{row['place']}: starts, {stands}, {'mirrored' if mirror['symmetric'] else 'not mirrored'}"
    return f"{said}, {row['seconds']:.0f} s" + "".join(f"; {fault}" for fault in row["faults"])


def score(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Files by what they are counted under, with totals of the MJCFs and the URDFs."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(f"{row['counted_under']}{' (URDF)' if row['kind'] == 'urdf' else ''}", []).append(row)
    groups |= {f"all {kind}": [row for row in rows if row["kind"] == kind] for kind in ("mjcf", "urdf")}
    return {
        name: {
            "files": len(group),
            "start": sum("trains" in row["done"] for row in group),
            "graph_right": sum("graph" in row["done"] and not row["faults"] for row in group),
            "hold": sum(bool(row.get("hold", {}).get("stands")) for row in group),
            "pose_if_stiffer": sum(bool(row.get("hold", {}).get("pose_held_by_times")) for row in group),
            "mirrored": sum(bool(row.get("mirror", {}).get("symmetric")) for row in group),
        }
        for name, group in groups.items()
        if group
    }


def reasons(rows: Sequence[dict[str, Any]]) -> dict[str, list[str]]:
    """Places by what is wrong with them: where they fail, a fall, or the kind of fault."""
    found: dict[str, list[str]] = {}
    for row in rows:
        said = [f"fails at {row['failed_at']}: {row['error']}"] if "error" in row else []
        said += row["faults"]
        if not row.get("hold", {}).get("stands", True):
            times = row["hold"].get("pose_held_by_times")
            said.append(
                f"falls, but the pose itself is held by servos {times:g} times as stiff"
                if times
                else f"falls, and with servos up to {STIFFER[-1]:g} times as stiff"
            )
        for reason in said:
            found.setdefault(reason, []).append(row["place"])
    return found


# Trainings.


def train(robot: str, seed: int, folder: Path, threads: int, passed_on: Sequence[str]) -> dict[str, Any]:
    """Train a robot by its name, timing the whole command, and evaluate its best policy."""
    # What an interrupted training left would be timed in two parts.
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    row: dict[str, Any] = {"robot": robot, "seed": seed, "commit": commit(), "threads": threads}
    # As many for the libraries that no setting reaches.
    environment = {**os.environ, **{f"{name}_NUM_THREADS": str(threads) for name in ("OMP", "MKL", "OPENBLAS")}}
    with (folder / "output.txt").open("w") as log:

        def call(command: str, *arguments: str) -> int:
            line = [sys.executable, "-m", f"gctd3.{command}", *arguments]
            done = subprocess.run(line, stdout=log, stderr=subprocess.STDOUT, env=environment, check=False)
            return done.returncode

        cores = [f"threads={threads}", f"env.threads={threads}"]
        began = time.monotonic()
        code = call("train", f"robot={robot}", f"seed={seed}", *cores, *passed_on, f"hydra.run.dir='{folder}'")
        row["seconds"] = round(time.monotonic() - began, 1)
        if code == 0:
            code = call("evaluate", f"run='{folder}'", f"episodes={EPISODES}")
    if code:
        said = [text for text in (folder / "output.txt").read_text().splitlines() if text.strip()]
        return {**row, "failed": f"exit code {code}: {said[-1] if said else 'nothing said'}"}
    return {**row, **evaluated(folder)}


def evaluated(folder: Path) -> dict[str, Any]:
    """Return the numbers of the walk in a run's evaluation."""
    from gctd3.runs.load import load_run

    evaluation, run = json.loads((folder / "evaluation.json").read_text()), load_run(str(folder))
    gait, robot = evaluation["gait"] or {}, run.setup.robot
    progress = (folder / "progress.csv").read_text().splitlines()
    names, last = progress[0].split(","), progress[-1].split(",")
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(model, data)
    soles = [lowest(model, data, geom) for foot in robot.feet for geom in _colliding(model, int(model.body(foot).id))]
    home = float(data.xpos[int(model.body(robot.root).id), 2]) - min(soles)
    return {
        "package": robot.source.package if robot.source else None,
        "version": robot.source.version if robot.source else None,
        "licence": robot.source.licence if robot.source else None,
        "frames": int(float(last[names.index("frames")])),
        "finishes": round(evaluation["success_rate"] * evaluation["episodes"]),
        "episodes": evaluation["episodes"],
        "distance_m": evaluation["distance_mean"],
        "speed_m_s": evaluation["velocity_mean"],
        "stride_hz": gait.get("stride_frequency") or gait.get("stride_hz"),
        "periodic_share": gait.get("periodic_fraction"),
        "slip_m_s": gait.get("slip_speed"),
        "height_from_home": evaluation["body_position_mean"] / home,
        "saturation_percent": gait.get("torque_saturation"),
        "evaluation": evaluation,
    }


def train_all(given: dict[str, str], passed_on: Sequence[str]) -> list[dict[str, Any]]:
    """Train what is not trained yet, and return what is known of all that are asked for."""
    rows = []
    for robot in filter(None, given["robots"].split(",")):
        for seed in [int(text) for text in given["seeds"].split(",")]:
            folder = Path(given["runs"]).absolute() / "train" / title(robot) / f"seed{seed}"
            kept = folder.with_suffix(".json")
            row = json.loads(kept.read_text()) if kept.is_file() else None
            if row is None or given["again"] == "all" or (given["again"] == "failed" and "failed" in row):
                row = train(robot, seed, folder, int(given["threads"]), passed_on)
                write_text(kept, json.dumps(row, indent=1) + "\n")
                print(training_line(row), flush=True)
            rows.append(row)
    return rows


def training_line(row: dict[str, Any]) -> str:
    """One training, for the screen."""
    about = f"{row['robot']} seed {row['seed']}: {row['seconds']:.0f} s"
    if "failed" in row:
        return f"{about}, {row['failed']}"
    return (
        f"{about}, {row['frames']:,} frames, {row['finishes']} of {row['episodes']} finish, {row['speed_m_s']:.2f} m/s"
    )


# Tables.


def tables(found: dict[str, Any] | None, trained: dict[str, Any] | None) -> str:
    """Both results, in Markdown."""
    parts = [text for text in (read_table(found) if found else "", train_table(trained) if trained else "") if text]
    return "\n\n".join(parts)


def read_table(found: dict[str, Any]) -> str:
    """The score, and every file."""
    lines = [
        "| package | files | start a training | graph right | hold the pose 3 s | would by stiffer servos | mirrored |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, counted in found["score"].items():
        lines.append("| " + " | ".join([name, *(str(value) for value in counted.values())]) + " |")
    lines += [
        "",
        "| file | licence | joints | feet | starts | graph | holds | mirror | |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in found["rows"]:
        held, mirror = row.get("hold"), row.get("mirror")
        stands = "" if held is None else "yes" if held["stands"] else f"{held['fell_after_s']:.1f} s"
        image = "" if mirror is None else "no" if not mirror["symmetric"] else f"{100 * mirror['residual']:.2g} %"
        cells = [
            f"{row['place'].rpartition(':')[2].split('assets/')[-1]} ({row['counted_under']})",
            row.get("licence") or "none stated",
            str(row.get("joints", "")),
            str(len(row["feet"])) if "feet" in row else "",
            "yes" if "trains" in row["done"] else "no",
            "" if "graph" not in row["done"] else "no" if row["faults"] else "right",
            stands,
            image,
            row.get("error", "; ".join(row["faults"])),
        ]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)


def train_table(trained: dict[str, Any]) -> str:
    """A line for each robot, medians over its seeds."""
    head = ["robot", "seeds that finish", "frames", "seconds", "m/s", "stride, Hz", "periodic", "slip, m/s"]
    head += ["height from home", "saturated"]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for robot in dict.fromkeys(row["robot"] for row in trained["rows"]):
        rows = [row for row in trained["rows"] if row["robot"] == robot]
        done = [row for row in rows if "failed" not in row]
        full = sum(row["finishes"] == row["episodes"] for row in done)

        def middle(key: str, form: str, of: Sequence[dict[str, Any]] = tuple(done)) -> str:
            values = [row[key] for row in of if row[key] is not None]
            return form.format(statistics.median(values)) if values else "-"

        cells = [robot, f"{full} of {len(rows)}", middle("frames", "{:,.0f}"), middle("seconds", "{:.0f}")]
        cells += [middle("speed_m_s", "{:.2f}"), middle("stride_hz", "{:.1f}"), middle("periodic_share", "{:.0%}")]
        cells += [middle("slip_m_s", "{:.2f}"), middle("height_from_home", "{:+.0%}")]
        cells += [middle("saturation_percent", "{:.0f} %")]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _result(given: str, name: str) -> dict[str, Any] | None:
    file = Path(given) if given else RESULTS / name
    found: dict[str, Any] | None = json.loads(file.read_text()) if file.is_file() else None
    return found


def main() -> None:
    """Read, train or print."""
    own = {
        "what": "read",
        "list": str(LIST),
        "only": "",
        "again": "",
        "limit": "180",
        "robots": "",
        "seeds": "0",
        "threads": "2",
        "runs": "runs/robots",
        "read": "",
        "train": "",
        "place": "",
        "feet": "0",
        "out": "",
    }
    # What is no option of this program goes to the trainings.
    passed_on = [a for a in sys.argv[1:] if "=" in a and a.split("=", 1)[0] not in own and "what=train" in sys.argv]
    sys.argv = [argument for argument in sys.argv if argument not in passed_on]
    given = options(**own)
    what = given["what"]
    if what == "one":
        print(json.dumps(read(given["place"], int(given["feet"]))))
    elif what == "unlisted":
        print("\n".join(unlisted(Path(given["list"]))) or "every file is in the list or left out by it")
    elif what == "table":
        found = _result(given["read"], "robots_read.json")
        print(tables(found, _result(given["train"], "robots_train.json")))
    elif what == "read":
        rows = read_all(given, Path(given["list"]))
        counted = score(rows)
        for name, numbers in counted.items():
            print(f"{name}: " + ", ".join(f"{value} {key.replace('_', ' ')}" for key, value in numbers.items()))
        versions = {name: metadata.version(name) for name in PACKAGES}
        commits = dict(Counter(row["commit"] for row in rows))
        figures = {"versions": versions, "commits": commits, "score": counted, "failures": reasons(rows), "rows": rows}
        report("robots", figures, given["out"])
    elif what == "train":
        rows = train_all(given, passed_on)
        print(train_table({"rows": rows}))
        versions = {name: metadata.version(name) for name in PACKAGES}
        report("robots", {"passed_on": passed_on, "versions": versions, "rows": rows}, given["out"])
    else:
        raise SystemExit(f"what must be read, train, table or unlisted, got {what}")


if __name__ == "__main__":
    main()
