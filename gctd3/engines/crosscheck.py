"""Run a policy in another engine and in MuJoCo from the same randomised starts, and compare the walks."""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gctd3.deploy.export import export_run
from gctd3.deploy.policy import Policy
from gctd3.deploy.settings import ExportSettings
from gctd3.engines.bullet import Bullet
from gctd3.engines.dart import Dart
from gctd3.engines.engine import Engine, OtherEngine
from gctd3.engines.gazebo import Gazebo
from gctd3.engines.parting import Parting, find_parting, flight_difference
from gctd3.engines.reference import Reference
from gctd3.engines.sanity import Bounds
from gctd3.engines.settings import TITLES, CrossCheckSettings, engine_version
from gctd3.engines.walk import Walk, walk
from gctd3.errors import ConfigError, ContractError
from gctd3.progress import StatusLine
from gctd3.robots.gait_pattern import GRAVITY
from gctd3.robots.physics import physics_hash
from gctd3.runs.load import load_run
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.training.checkpoint import versions

Start = tuple[np.ndarray, np.ndarray]
# Froude number below which a speed counts as none: that of a robot that stands, jumps or steps aside is no number that
# another speed could be compared with by their ratio.
SLOW = 0.01


@dataclass(frozen=True)
class CrossCheck:
    """Hold the walks of both engines from the same starts.

    Attributes:
        settings: The settings.
        task: The task.
        servos: Names of the servos.
        reference: MuJoCo's walks.
        walks: The other engine's walks.
        broken: For each of these the bounds that it breaks.
        flight: Largest difference of a joint's angle in free flight (rad).
        partings: Where each walk parts from MuJoCo's; a walk that agrees does so late, as every motion does.
    """

    settings: CrossCheckSettings
    task: SimulatedTask
    servos: tuple[str, ...]
    reference: tuple[Walk, ...]
    walks: tuple[Walk, ...]
    broken: tuple[tuple[str, ...], ...]
    flight: float
    partings: tuple[Parting, ...]

    def reasons(self) -> list[str]:
        """Return a sentence for each reason for which the check has failed; none if it has passed."""
        one, other = self.numbers(self.reference), self.numbers(self.walks, self.broken)
        most, reasons = self.settings.tolerance, []
        if not one["finishes"]:
            return ["MuJoCo itself finishes from no start, so there is nothing to compare with."]
        if other["finishes"] < one["finishes"] - most:
            reasons.append(
                f"It finishes from {other['finishes']:.0%} of the starts, MuJoCo from {one['finishes']:.0%}."
            )
        faster, speed = other["speed_m_s"] - one["speed_m_s"], abs(one["speed_m_s"])
        least = math.sqrt(SLOW * GRAVITY * self.task.robot.leg_length)
        if not abs(faster) <= most * max(speed, least):
            by = f"{faster / speed:+.0%}" if speed > least else f"{faster:+.2f} m/s"
            reasons.append(f"Its speed differs from MuJoCo's by {by}.")
        insane = [phrases for phrases in self.broken if phrases]
        if insane:
            example = insane[0][0]
            reasons.append(f"{len(insane)} of {len(self.broken)} walks are none of a robot's; in the first {example}.")
        return reasons

    def numbers(self, walks: Sequence[Walk], broken: Sequence[Sequence[str]] | None = None) -> dict[str, Any]:
        """Summarise walks; one that breaks a bound has not finished, and its numbers do not count if others do."""
        dt = self.task.control_dt
        sane = [w for w, phrases in zip(walks, broken or [()] * len(walks), strict=True) if not phrases]
        counted = [w for w in sane if len(w.position) > 1] or list(walks)
        # Walks that end at once say little about how the others walk.
        finished = [w for w in sane if w.finished] or counted
        speeds = [w.speed(dt) for w in finished]
        down = np.concatenate([w.feet_down for w in counted])
        height = np.concatenate([w.height for w in counted])
        torque = np.concatenate([np.square(w.torque) for w in counted])
        return {
            "starts": len(walks),
            "finishes": sum(w.finished for w in sane) / len(walks),
            "falls": sum(w.fell for w in walks) / len(walks),
            "not_sane": len(walks) - len(sane),
            "speed_m_s": float(np.mean(speeds)),
            "speed_std_m_s": float(np.std(speeds)),
            "height_m": float(height.mean()),
            "height_lowest_m": float(height.min()),
            "height_highest_m": float(height.max()),
            "feet_down": dict(zip(self.task.robot.feet, down.mean(axis=0).tolist(), strict=True)),
            "no_foot_down": float((~down.any(axis=1)).mean()),
            "torque_rms_nm": dict(zip(self.servos, np.sqrt(torque.mean(axis=0)).tolist(), strict=True)),
            "torque_peak_nm": float(max(w.peak.max() for w in counted)),
            "refused_readings": sum(len(w.refused) for w in walks),
        }

    def report(self) -> dict[str, Any]:
        """Return all numbers, for a JSON file."""
        settings, reasons = self.settings, self.reasons()
        counts = Counter(parting.boundary for parting in self.partings)
        return {
            "robot": self.task.robot.path.stem,
            "engine": settings.engine,
            "seed": settings.seed,
            "timestep_s": settings.timestep,
            "armature": settings.armature,
            "tolerance": settings.tolerance,
            "passed": not reasons,
            "reasons": reasons,
            "flight_difference_rad": self.flight if np.isfinite(self.flight) else None,
            # Walks that agree part, too, late.
            "partings": dict(counts) if reasons else {},
            "mujoco": self.numbers(self.reference),
            settings.engine: self.numbers(self.walks, self.broken),
            "versions": {**versions(), **engine_version(settings.engine)},
        }


def cross_check(settings: CrossCheckSettings) -> CrossCheck:
    """Run a policy in another engine and in MuJoCo from the same starts.

    Raises:
        RunError: If the directory is not a run, or its task cannot be exported.
        ContractError: If ``policy`` is of another robot.
        ConfigError: If the control period is no multiple of the time step.
    """
    run = load_run(settings.run)
    # Other engines have planes alone.
    task: SimulatedTask = run.task("export").on_plane()
    steps = task.control_dt / settings.timestep
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
        raise ConfigError(
            f"timestep must divide the control period of {task.control_dt:g} s, got {settings.timestep:g} s."
        )
    with tempfile.TemporaryDirectory() as folder, StatusLine() as line:
        file = Path(folder) / "policy.onnx"
        if settings.policy is None:
            line.show("exporting the policy")
            export_run(ExportSettings(run=settings.run, out=str(file), threads=settings.threads))
        policy = Policy(file if settings.policy is None else settings.policy)
        if policy.contract.robot.sha256 != physics_hash(task.robot.model):
            raise ContractError(f"{settings.policy} is of another robot than the run: {policy.contract.robot.name!r}.")
        reference = Reference(task.robot, task.control_dt)
        line.show(f"opening {TITLES[settings.engine]}")
        other = open_engine(settings, task, policy, Path(folder))
        rng = np.random.default_rng(settings.seed)
        starts = [task.start(rng) for _ in range(settings.episodes)]

        def walks(engine: Engine) -> tuple[Walk, ...]:
            done = []
            for i, start in enumerate(starts):
                line.show(f"{engine.name}: {i} of {len(starts)} starts")
                done.append(walk(task, policy, engine, start, settings.seed + i))
            return tuple(done)

        known, found = walks(reference), walks(other)
        flight = flight_difference(task, reference, other, starts[0], known[0].desired)
    bounds = Bounds.of(known, task.robot.leg_length, task.control_dt)
    broken = tuple(tuple(bounds.broken(one)) for one in found)
    pairs = zip(found, known, strict=True)
    partings = tuple(find_parting(one, of, flight, task.control_dt) for one, of in pairs)
    servos = tuple(servo.actuator for servo in policy.contract.servos)
    return CrossCheck(settings, task, servos, known, found, broken, flight, partings)


def open_engine(settings: CrossCheckSettings, task: SimulatedTask, policy: Policy, folder: Path) -> OtherEngine:
    """Open the other engine with the task's robot, whose URDF or SDF is written to a folder."""
    chosen: dict[str, type[Dart | Bullet | Gazebo]] = {"dart": Dart, "bullet": Bullet, "gazebo": Gazebo}
    return chosen[settings.engine](task.robot, policy.contract, settings.timestep, settings.armature, folder)


def table(check: CrossCheck) -> str:
    """Format the comparison as a table, with the verdict below."""
    one, other = check.numbers(check.reference), check.numbers(check.walks, check.broken)
    title = TITLES[check.settings.engine]

    def spread(numbers: dict[str, Any]) -> str:
        return f"{numbers['speed_m_s']:.3f} ± {numbers['speed_std_m_s']:.3f}"

    def heights(numbers: dict[str, Any]) -> str:
        return f"{numbers['height_m']:.3f} ({numbers['height_lowest_m']:.3f} to {numbers['height_highest_m']:.3f})"

    rows = [
        ("starts", *(str(numbers["starts"]) for numbers in (one, other))),
        ("share of finishes", *(f"{numbers['finishes']:.2f}" for numbers in (one, other))),
        ("share of falls", *(f"{numbers['falls']:.2f}" for numbers in (one, other))),
        ("walks beyond a robot's bounds", *(str(numbers["not_sane"]) for numbers in (one, other))),
        ("speed, m/s", spread(one), spread(other)),
        ("body height from standing, m", heights(one), heights(other)),
    ]
    rows += [
        (f"{foot} down, share of time", *(f"{numbers['feet_down'][foot]:.2f}" for numbers in (one, other)))
        for foot in check.task.robot.feet
    ]
    rows.append(("no foot down, share of time", *(f"{numbers['no_foot_down']:.2f}" for numbers in (one, other))))
    rows += [
        (f"torque of {servo}, RMS, N m", *(f"{numbers['torque_rms_nm'][servo]:.1f}" for numbers in (one, other)))
        for servo in check.servos
    ]
    rows += [
        ("largest torque, N m", *(f"{numbers['torque_peak_nm']:.1f}" for numbers in (one, other))),
        ("readings that the policy refused", *(str(numbers["refused_readings"]) for numbers in (one, other))),
    ]
    width = max(len(label) for label, *_ in rows) + 2
    lines = [f"{'':{width}}{'MuJoCo':>28}{title:>28}"]
    lines += [f"{label:{width}}{left:>28}{right:>28}" for label, left, right in rows]
    lines.append("")
    if np.isfinite(check.flight):
        lines.append(f"In free flight under the same commands joints differ by at most {check.flight:.3f} rad.")
    else:
        lines.append("In free flight under the same commands the simulation explodes.")
    reasons = check.reasons()
    if not reasons:
        return "\n".join([*lines, f"Passed: {title} agrees with MuJoCo."])
    lines += [f"Failed: {reasons[0]}", *reasons[1:]]
    counts = Counter(parting.boundary for parting in check.partings)
    times = {name: [p.time for p in check.partings if p.boundary == name] for name in counts}
    words = {"servo": "at the servos", "first contact": "at the first contact", "drift": "by drift"}
    parts = [f"{n} {words[name]}, from {min(times[name]):.2f} s on" for name, n in counts.most_common()]
    return "\n".join([*lines, f"Where the walks part from MuJoCo's: {'; '.join(parts)}."])
