r"""Minutes until a real robot arrives, and walks: our whole command, and other libraries' TD3, SAC and PPO.

    python benchmarks/robot_peers.py robot=go2 peers=gctd3,sb3-td3,sb3-sac,sb3-ppo,sbx-td3,sbx-sac,sbx-ppo \
        parallel=1,64 cap=20 seeds=0 out=benchmarks/results/robot_peers.json
    python benchmarks/robot_peers.py peers=sbx-sac parallel=64 updates=-1 runs=runs/more_updates
    python benchmarks/robot_peers.py robot=go2 settings='task=velocity' own='algo=td3 network=mlp' cap=40 \
        runs=benchmarks/results/velocity_peers out=benchmarks/results/velocity_peers.json

``gctd3`` is the whole ``python -m gctd3.train robot=...`` until it ends by itself. ``settings`` are
arguments of all, which choose task and reward, ``own`` those of our command alone. The others are those of
``benchmarks/peers.py``: same robot, task, reward and observation through Gymnasium, with the libraries' defaults on one
robot, and on as many robots as ours (what changes then, ``peers.py`` says). All are evaluated by one function, from the
same starts, ours as often as it is by itself, the others every ``seconds`` of training. Evaluations count as time of
ours, and not as time of the others.

A policy arrives if every episode of an evaluation reaches the finish; of a task with a commanded velocity, if 90 % of
the commands are followed, whatever falls there are. Arriving is not walking: it walks if it meets the
conditions that end our training (``stop_when``), in as many evaluations in a row. Each training ends when it walks, or
after ``cap`` minutes, counted from the start of its process, imports and compilation included. Ratios are of times
over our whole command; who does not get there counts as longer than the cap.

It goes on where it stopped: each training that is over is a file in ``runs``. ``again=failed`` or ``again=all`` makes
those anew, and ``again=none`` makes none and compares those that are over. Nothing else should run on the machine.
"""

from __future__ import annotations

import json
import shlex
import shutil
import threading
from collections.abc import Callable, Container, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

from common import commit, machine, options, report
from gait_table import BASE, Row, Run, Summary, outcome, ratio, summary
from peers import PEERS, installed, shared_settings, versions
from time_to_gait import our_command, peer_command, race, until_interrupted

from gctd3.errors import GCTD3Error
from gctd3.files import title, write_text
from gctd3.training.announcements import FOLLOWED
from gctd3.training.settings import TrainSettings
from gctd3.training.stop_when import StopWhen

Criterion = Callable[[Sequence[Row]], bool]  # whether evaluations up to now, one at least, show it
KEPT = ("robot", "settings", "own", "cap", "seconds", "threads", "updates")  # options that trainings of one table share
OWN_PACKAGES = ("gctd3", "torch", "mujoco", "gymnasium", "numpy")
# What is shown of a gait, with its format.
SHOWN = {
    "velocity_mean": "{:.2f} m/s",
    "stride_hz": "{:.1f} Hz",
    "periodic_fraction": "periodic {:.0%}",
    "slip_speed": "slip {:.2f} m/s",
    "height_from_home": "height {:+.0%}",
    "torque_saturation": "saturated {:.0f} %",
    "flight_fraction": "flight {:.0%}",
}


@dataclass(frozen=True)
class Cell:
    """A training: whose, on how many robots at once, and its seed."""

    peer: str
    robots: int
    seed: int

    @property
    def contender(self) -> str:
        """Its name in tables; runs of several seeds share it."""
        return f"{self.peer} x{self.robots}"

    @property
    def title(self) -> str:
        """Its name among files."""
        return f"{self.peer}_{self.robots}_seed{self.seed}"


def arrives(curve: Sequence[Row]) -> bool:
    """Whether each episode of the last evaluation reached the finish, or followed nearly all commands."""
    return all(curve[-1].get(key, 0.0) >= least for key, least in arrival(curve[-1]).items())


def arrival(names: Container[str]) -> dict[str, float]:
    """Return what an evaluation needs for an arrival, by the names of its metrics."""
    return {"followed_rate": FOLLOWED} if "followed_rate" in names else {"success_rate": 1.0}


def walking(rule: StopWhen) -> Criterion:
    """Return the criterion that the last evaluations met all conditions, as many as it takes to end our training."""
    needed = rule.evaluations or 1
    return lambda curve: len(curve) >= needed and all(rule.all_reached(row) for row in curve[-needed:])


def until(run: Run, criterion: Criterion) -> Run:
    """Return the run up to the first evaluation that meets a criterion; if none does, as one that did not get there."""
    for i, row in enumerate(run.curve):
        if criterion(run.curve[: i + 1]):
            return replace(run, outcome="reached", minutes=row["minutes"], curve=run.curve[: i + 1])
    return replace(run, outcome="not within") if run.reached else run


def train(cell: Cell, folder: Path, given: dict[str, str], settings: TrainSettings, stop: threading.Event) -> Run:
    """Make one training, from its beginning."""
    shutil.rmtree(folder, ignore_errors=True)  # what an interrupted training left
    run, cap, threads = Run(cell.contender, cell.seed), float(given["cap"]), int(given["threads"])
    walks, mine = walking(settings.stop_when), cell.peer == BASE
    if mine:
        asked = [*shlex.split(given["settings"]), *shlex.split(given["own"])]
        line = our_command(folder, threads, f"robot={given['robot']}", f"seed={cell.seed}", *asked)
    else:
        shared = {key: given[key] for key in ("robot", "settings", "seconds", "threads", "updates")}
        line = peer_command(**shared, peer=cell.peer, run=folder, seed=cell.seed, robots=cell.robots, minutes=cap)
    race(run, line, folder, cap, threads, stop, walks=walks, whole=mine)
    return run


def known(file: Path, given: dict[str, str]) -> Run | None:
    """Return the run that a file holds, or ``None`` if it is still to be made.

    Raises:
        SystemExit: If it was made with other options.
    """
    if not file.is_file() or given["again"] == "all":
        return None
    held = json.loads(file.read_text(encoding="utf-8"))
    # Of files that are older than an option it had no value.
    options = {key: held["options"].get(key, "") for key in KEPT}
    if other := [f"{key}={value}" for key, value in options.items() if value != given[key]]:
        raise SystemExit(f"{file} was made with {', '.join(other)}: choose another runs=, or the same options")
    run = Run(**held["run"])
    return None if given["again"] == "failed" and run.outcome == "failed" else run


def plan(given: dict[str, str], own_robots: int) -> tuple[list[Cell], list[str]]:
    """Return the trainings to make, seed by seed, and who cannot run.

    Raises:
        SystemExit: If an option is wrong.
    """
    peers = given["peers"].split(",")
    accepted = (BASE, *(name for name in PEERS if name.startswith(("sb3-", "sbx-"))))
    if unknown := [name for name in peers if name not in accepted]:
        raise SystemExit(f"peers knows no {', '.join(unknown)}; there are {', '.join(accepted)}")
    if given["again"] not in ("", "none", "failed", "all"):
        raise SystemExit(f"again must be none, failed, all or nothing, got {given['again']}")
    parallel = [int(text) for text in given["parallel"].split(",")] if given["parallel"] else [1, own_robots]
    if min(parallel) < 1 or float(given["cap"]) <= 0 or float(given["seconds"]) <= 0 or int(given["threads"]) < 1:
        raise SystemExit("parallel and threads must be at least 1, cap and seconds above 0")
    missing = [f"{name} is not installed" for name in peers if name != BASE and not installed(name)]
    cells = [
        Cell(peer, robots, seed)
        for seed in map(int, given["seeds"].split(","))
        for peer in peers
        if peer == BASE or installed(peer)
        for robots in ([own_robots] if peer == BASE else parallel)
    ]
    return list(dict.fromkeys(cells)), missing


@dataclass(frozen=True)
class Result:
    """One contender over its seeds.

    Attributes:
        arrival: Minutes until it arrives.
        walk: Minutes until it walks; of ours, of the whole command.
        arrival_ratio: Its arrival over our whole command, ``>`` before a lower bound.
        walk_ratio: The same of the walk.
        at: Its evaluation at the arrival, or else the one in which most episodes arrived; of the first seed.
        missed: The conditions of a walk that this evaluation does not meet.
    """

    arrival: Summary
    walk: Summary
    arrival_ratio: str
    walk_ratio: str
    at: Row | None
    missed: list[str]


def results(runs: Sequence[Run], cap: float, rule: StopWhen) -> dict[str, Result]:
    """Summarise each contender."""
    by_name: dict[str, list[Run]] = {}
    for run in runs:
        by_name.setdefault(run.contender, []).append(run)
    arrived = {name: [until(run, arrives) for run in those] for name, those in by_name.items()}
    walked = {name: [r if ours(name) else until(r, walking(rule)) for r in those] for name, those in by_name.items()}
    base = next((summary(those, cap) for name, those in walked.items() if ours(name)), None)
    found = {}
    for name in by_name:
        first = arrived[name][0]
        at = first.curve[-1] if first.reached else first.best
        one, other = summary(arrived[name], cap), summary(walked[name], cap)
        # An undefined metric with two bounds is named once.
        lacking = list(dict.fromkeys(rule.missed(at))) if at else []
        found[name] = Result(one, other, ratio(one, base), ratio(other, base), at, lacking)
    return found


def ours(contender: str) -> bool:
    """Whether a contender is gctd3."""
    return contender.startswith(f"{BASE} ")


def best_peer(found: dict[str, Result]) -> str | None:
    """Return who of the others arrives first, if anybody does."""
    theirs = {name: one.arrival for name, one in found.items() if not ours(name) and "median" not in one.arrival.bounds}
    return min(theirs, key=lambda name: theirs[name].median, default=None)


def table(found: dict[str, Result], runs: Sequence[Run], cap: float) -> str:
    """Write a line for each contender, the gait of each, and a line for each training that did not walk."""
    titles = ("arrives", "median min", f"x {BASE}", "walks", "median min", f"x {BASE}", "steps")
    lines = [f"{'':12}" + "".join(f"{text:>11}" for text in titles)]
    for name, one in found.items():
        cells = []
        for figures, compared in ((one.arrival, one.arrival_ratio), (one.walk, one.walk_ratio)):
            cells += [f"{figures.reached}/{figures.all}", figures.minutes("median"), compared]
        cells += ["-" if one.arrival.frames is None else f"{one.arrival.frames:,.0f}"]
        lines.append(f"{name:12}" + "".join(f"{cell:>11}" for cell in cells))
    lines += ["", "at the arrival, or else the evaluation with most arrivals:"]
    for name, one in found.items():
        lines.append(f"{name}: {gait_words(one)}")
    first = best_peer(found)
    lines += ["", f"of the others, {first} arrives first" if first else f"of the others, nobody arrives in {cap:g} min"]
    lines += [f"{run.contender} seed {run.seed}: {outcome(run, cap)}" for run in runs if not run.reached]
    return "\n".join(lines)


def gait_words(one: Result) -> str:
    """Describe a gait on a line."""
    if one.at is None:
        return "never evaluated"
    if "followed_rate" in one.at:
        shown = [f"{one.at['followed_rate']:.0%} of the commands followed, falls {one.at['fall_rate']:.0%}"]
    else:
        shown = [f"{one.at['success_rate']:.0%} arrive, {one.at['distance_mean']:.1f} m"]
    shown += [form.format(one.at[key]) for key, form in SHOWN.items() if key in one.at]
    return f"{', '.join(shown)}; " + (f"misses {', '.join(one.missed)}" if one.missed else "meets all conditions")


def main() -> None:
    """Train what is not trained yet, and compare."""
    given = options(
        robot="go2",
        settings="",
        own="",
        peers=",".join((BASE, *(f"{library}-{name}" for library in ("sb3", "sbx") for name in ("td3", "sac", "ppo")))),
        parallel="",
        cap="20",
        seeds="0",
        seconds="20",
        updates="",
        threads="2",
        jobs="1",
        again="",
        runs="runs/robot_peers",
        out="",
    )
    try:
        settings = shared_settings(f"robot={given['robot']}", *shlex.split(given["settings"]))
        source = settings.setup().robot.source
    except GCTD3Error as error:
        raise SystemExit(str(error)) from None
    cells, missing = plan(given, settings.env.num_envs)
    runs = Path(given["runs"]).absolute() / title(given["robot"])
    files = {cell: runs / f"{cell.title}.json" for cell in cells}
    over = {cell: run for cell, file in files.items() if (run := known(file, given)) is not None}
    cap, to_do = float(given["cap"]), [cell for cell in cells if cell not in over]
    if given["again"] == "none":
        missing += [f"{cell.contender} seed {cell.seed} has not been trained" for cell in to_do]
        to_do = []
    print(f"{len(to_do)} trainings of at most {cap:g} min, {len(over)} known, {given['jobs']} at a time", flush=True)
    runs.mkdir(parents=True, exist_ok=True)
    stop = threading.Event()

    def start(cell: Cell) -> None:
        if stop.is_set():
            return
        run = train(cell, runs / cell.title, given, settings, stop)
        if run.outcome != "interrupted":
            over[cell] = run
            asked = {key: given[key] for key in KEPT}
            held = {"commit": commit(), "machine": machine(), "options": asked, "run": asdict(run)}
            write_text(files[cell], json.dumps(held, indent=1) + "\n")

    with ThreadPoolExecutor(int(given["jobs"])) as pool, until_interrupted(stop):
        list(pool.map(start, to_do))
    done = [over[cell] for cell in cells if cell in over]
    found = results(done, cap, settings.stop_when)
    if found:
        print(f"\n{table(found, done, cap)}")
    for line in missing:
        print(f"not measured: {line}")
    peers = [name for name in dict.fromkeys(cell.peer for cell in over) if name != BASE]
    figures = {
        "criterion": {
            "episodes": settings.evaluation.episodes,
            "seed": settings.evaluation.seed,
            "arrives": arrival(settings.stop_when.names),
            "walks": {key: value for key, value in asdict(settings.stop_when).items() if key != "restart_after"},
        },
        "options": {key: given[key] for key in (*KEPT, "jobs")},
        "robot": {"name": given["robot"], "package": source and source.package, "version": source and source.version},
        "robots_of_ours": settings.env.num_envs,
        "interrupted": stop.is_set(),
        "versions": {name: metadata.version(name) for name in OWN_PACKAGES}
        | {package: number for name in peers for package, number in versions(name).items()},
        "best_peer": best_peer(found),
        "summary": {name: asdict(one) for name, one in found.items()},
        "runs": [{"commit": _commit(files[cell]), **asdict(over[cell])} for cell in cells if cell in over],
        "not_measured": missing,
    }
    report("robot_peers", figures, given["out"])
    if stop.is_set():
        raise SystemExit(130)


def _commit(file: Path) -> str:
    held: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return str(held["commit"])


if __name__ == "__main__":
    main()
