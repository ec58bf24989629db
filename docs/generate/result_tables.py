"""Tables of measured results, read from the files of benchmarks/results."""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from markdown_table import table

from gctd3.engines.settings import TITLES

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
_WALK_HEADS = ("seed", "minutes", "restarts", "return", "velocity m/s", "reached 15 m")
_GAIT_HEADS = ("hip correlation", "stride Hz", "flight")


def load(name: str) -> dict[str, Any]:
    """Read a file of results."""
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def walks(*names: str) -> Iterator[str]:
    """List the best policy of each training of ``benchmarks/walk.py``."""
    seeds = sorted((seed for name in names for seed in load(name)["seeds"]), key=lambda seed: seed["seed"])
    yield from table((*_WALK_HEADS, *_GAIT_HEADS), (_walk(seed) for seed in seeds))


def _walk(seed: dict[str, Any]) -> tuple[object, ...]:
    evaluation, gait = seed["evaluation"], seed["evaluation"]["gait"]
    restarts = max((row.get("restarts", 0) for row in seed["curve"]), default=0)
    return (
        seed["seed"],
        f"{seed['minutes']:.1f}",
        f"{restarts:.0f}",
        f"{evaluation['return_mean']:.1f} ± {evaluation['return_std']:.1f}",
        f"{evaluation['velocity_mean']:.2f}",
        _reached(evaluation),
        *(_or_none(gait.get(key), form) for key, form in (("hip_correlation", "{:.2f}"), ("stride_hz", "{:.2f}"))),
        _or_none(gait.get("flight_fraction"), "{:.0%}").replace("%", " %"),
    )


def _reached(evaluation: dict[str, Any]) -> str:
    return f"{evaluation['success_rate'] * evaluation['episodes']:.0f}/{evaluation['episodes']}"


def _or_none(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def other_robots() -> Iterator[str]:
    """List the trainings of robots other than the biped."""
    rows = []
    for robot in ("biped_planar", "quadruped", "hexapod", "op3"):
        for seed in load(f"walk_{robot}")["seeds"]:
            evaluation = seed["evaluation"]
            frames = f"{seed['curve'][-1]['frames']:,.0f}"
            moved = f"{evaluation['distance_mean']:.1f}", f"{evaluation['velocity_mean']:.2f}"
            rows.append((f"`{robot}`", seed["seed"], frames, f"{seed['minutes']:.1f}", _reached(evaluation), *moved))
    for row in load("robots_train")["rows"]:
        start = f"`{row['robot']}`", row["seed"]
        if "failed" in row:
            rows.append((*start, "-", f"{row['seconds'] / 60:.1f}", "-", "-", row["failed"]))
            continue
        reached = f"{row['finishes']}/{row['episodes']}"
        moved = f"{row['distance_m']:.1f}", f"{row['speed_m_s']:.2f}"
        rows.append((*start, f"{row['frames']:,}", f"{row['seconds'] / 60:.1f}", reached, *moved))
    yield from table(("`robot=`", "seed", "frames", "minutes", "reached 15 m", "distance m", "velocity m/s"), rows)


def time_to_gait() -> Iterator[str]:
    """Compare the minutes until a contender walks."""
    names = {
        "gctd3": "gctd3",
        "td3": "td3 (gctd3's, MLP)",
        "sbx": "SBX TD3 (JAX)",
        "torchrl": "TorchRL's TD3 example",
        "sb3": "Stable-Baselines3 TD3",
    }
    rows = []
    for key, one in load("time_to_gait")["summary"].items():
        median, longest = (("> " if end in one["bounds"] else "") + f"{one[end]:.1f}" for end in ("median", "max"))
        rows.append((list(names).index(key), (names[key], f"{one['reached']} of {one['all']}", median, longest)))
    yield from table(("", "seeds that walk", "median, minutes", "longest"), (row for _, row in sorted(rows)))


def robot_peers() -> Iterator[str]:
    """Compare the minutes until a real robot arrives and walks, by contender and robots at once."""
    rows = []
    for name, one in load("robot_peers")["summary"].items():
        times: list[str] = []
        for key in ("arrival", "walk"):
            bound = "> " if "median" in one[key]["bounds"] else ""
            times += [f"{bound}{one[key]['median']:.1f}", one[f"{key}_ratio"].replace(">", "> ")]
        # Of a robot that does not get far the gait is not known.
        known = [each for each in one["missed"] if not each.endswith("undefined")]
        lacking = "never evaluated" if one["at"] is None else ", ".join(known) or "nothing"
        rows.append((*name.split(" x"), *times, lacking))
    heads = ("", "robots", "arrives, minutes", "times ours", "walks, minutes", "times ours", "lacks at its best")
    yield from table(heads, rows)


def yardsticks() -> Iterator[str]:
    """Compare returns after the last step with those of Stable-Baselines3."""
    data, rows, tasks = load("yardsticks"), [], {"halfcheetah": "HalfCheetah-v5", "walker2d": "Walker2d-v5"}
    for one in data["comparisons"]:
        ours, theirs = (_interval(one["curves"][side][-1]) for side in ("gctd3", "sb3"))
        minutes = (_minutes(data, one, side) for side in ("gctd3", "sb3"))
        overlap = f"{sum(one['overlap'])} of {len(one['overlap'])}"
        rows.append(
            (tasks[one["task"]], one["algo"], ours, theirs, _interval(one["average"]), overlap, ", ".join(minutes))
        )
    heads = ("task", "algorithm", "gctd3", "Stable-Baselines3", "difference, whole curve", "overlap", "minutes")
    yield from table(heads, rows)


def _interval(bounds: dict[str, float]) -> str:
    return f"{bounds['value']:.0f} [{bounds['low']:.0f}, {bounds['high']:.0f}]"


def _minutes(data: dict[str, Any], one: dict[str, Any], side: str) -> str:
    runs = [r for r in data["runs"] if (r["task"], r["algo"], r["side"]) == (one["task"], one["algo"], side)]
    return f"{statistics.median(run['minutes'] for run in runs):.0f}"


def crosscheck() -> Iterator[str]:
    """Compare walks in other engines with MuJoCo's."""
    rows = []
    for row in load("crosscheck")["rows"]:
        one, other = row["mujoco"], row[row["engine"]]
        title = TITLES[row["engine"]] + ("" if row["armature"] else ", no armature")
        flight = row["flight_difference_rad"]
        parted = row["partings"]
        rows.append(
            (
                row["robot"],
                title,
                f"{round(other['finishes'] * other['starts'])}/{other['starts']}",
                f"{one['speed_m_s']:.2f}",
                f"{other['speed_m_s']:.2f}",
                other["not_sane"],
                "explodes" if flight is None else f"{flight:.3f}",
                "passed" if row["passed"] else f"failed: {max(parted, key=parted.get)}",
            )
        )
    heads = ("robot", "engine", "finishes", "MuJoCo m/s", "m/s", "beyond bounds", "free flight, rad", "verdict")
    yield from table(heads, sorted(rows))


def provenance() -> Iterator[str]:
    """List the files of results: the command, the commit and the machine of each."""
    rows = []
    for file in sorted(RESULTS.glob("*.json")):
        data = json.loads(file.read_text(encoding="utf-8"))
        commit = data.get("commit", "")
        commit = ", ".join(sorted(set(commit.values()))) if isinstance(commit, dict) else commit
        command = f"`{data['command']}`" if "command" in data else "see the file"
        rows.append((f"[{file.name}](../benchmarks/results/{file.name})", command, commit, data.get("machine", "-")))
    yield from table(("file", "command", "commit", "machine"), rows)


TABLES = {
    "walk": lambda: walks("walk_gctd3"),
    "table5-best": lambda: walks("table5_best", "table5_best_more"),
    "other-robots": other_robots,
    "time-to-gait": time_to_gait,
    "robot-peers": robot_peers,
    "yardsticks": yardsticks,
    "crosscheck": crosscheck,
    "provenance": provenance,
}
