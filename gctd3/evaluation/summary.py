"""The gait of many episodes in a table of numbers: every metric of :mod:`.gait_metrics` and :mod:`.effort`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gctd3.evaluation import effort, gait_metrics
from gctd3.evaluation.episode import Episode
from gctd3.evaluation.quantities import ASYMMETRY
from gctd3.evaluation.recorder import Motion, standing_height, total_mass
from gctd3.robots.robot import Robot

# Metrics that only a gait with strides has; `null` for other gaits.
OF_STRIDES = (
    "stride_time",
    "stride_frequency",
    "stride_variation",
    "duty_factor",
    "phase_offset",
    "duty_symmetry",
    "step_symmetry",
    "regularity",
    "foot_clearance",
    "floquet_max",
)


@dataclass(frozen=True)
class Gait:
    """Represent the gait in the last 10 m of one episode whose motion was recorded.

    Attributes:
        episode: The episode; it got that far.
        motion: The recorded motion, from the beginning of the episode.
        robot: The robot that walked.
        dt: Control period (s).
    """

    episode: Episode
    motion: Motion
    robot: Robot
    dt: float

    @cached_property
    def begin(self) -> int:
        """Return the step with which the last 10 m begin."""
        walked = self.episode.walked
        return int(np.argmax(walked)) if walked is not None else 0

    @cached_property
    def lag(self) -> int | None:
        """Return the control steps in a stride, by the joint angles; ``None`` for a motion that does not repeat."""
        return gait_metrics.stride_lag(self.motion.angles[self.begin :])

    @cached_property
    def feet_down(self) -> np.ndarray:
        """Return contacts without bounces, ``[T, feet]``: interruptions too short for a swing of this gait are removed.

        A stance may be that short: the faster a robot runs, the shorter its feet are down.
        """
        shortest = max(int(gait_metrics.SHORTEST_SWING * (self.lag or 0)), gait_metrics.SHORTEST)
        return np.stack([gait_metrics.debounce(foot, gap=shortest) for foot in self.episode.feet_down.T], axis=1)

    @cached_property
    def strides(self) -> list[np.ndarray]:
        """Return each foot's strides in the last 10 m, and never the first ones of the episode."""
        all_strides = [gait_metrics.strides(contact) for contact in self.feet_down.T]
        return [foot[foot[:, 0] >= self.begin] for foot in all_strides]

    @cached_property
    def periodic(self) -> bool:
        """Tell whether the joint motion repeats and the strides are periodic, see :func:`.is_periodic`."""
        return self.lag is not None and gait_metrics.is_periodic(self.strides)

    @property
    def sections(self) -> np.ndarray:
        """Return the states at the first foot's touchdowns, shape ``[K, n]``."""
        foot = self.strides[0]
        return self.motion.state[np.append(foot[:, 0], foot[-1:, 1])]

    def of_time(self, mass: float, leg: float, standing: float) -> dict[str, float]:
        """Compute the metrics that are defined for every motion, periodic or not.

        Args:
            mass: Mass of the robot (kg).
            leg: Leg length of the robot (m).
            standing: Height of the robot's body above the ground when it stands (m).
        """
        part, episode, begin = self.motion.since(self.begin), self.episode, self.begin
        distance = float(episode.position[-1] - episode.position[begin])
        steps = len(episode.position) - 1 - begin
        gravity = float(np.linalg.norm(self.robot.model.opt.gravity))
        # The first step's work was done on the way to where the last 10 m begin.
        absolute, positive = part.work[1:].sum(axis=0)
        slips = [
            effort.slip_speed(speed, contact)
            for speed, contact in zip(part.sole_speed.T, episode.feet_down[begin:].T, strict=True)
        ]
        return {
            "froude": effort.froude_number(distance / (steps * self.dt), leg, gravity),
            "cost_of_transport": effort.cost_of_transport(absolute, mass, distance, gravity),
            "cost_of_transport_positive": effort.cost_of_transport(positive, mass, distance, gravity),
            "torque_saturation": float(part.saturated.mean() * 100.0),
            "slip_speed": _mean(slips),
            "height_from_home": float(episode.height[begin:].mean()) / standing,
            "action_rate": effort.action_rate(part.action, self.dt),
            "action_jerk": effort.action_jerk(part.action, self.dt),
            "action_smoothness": effort.action_smoothness(part.action, self.dt),
        }

    def of_strides(self) -> dict[str, float]:
        """Compute the metrics that are defined only for a periodic gait."""
        episode, feet = self.episode, self.strides
        duty = [gait_metrics.duty_factor(self.feet_down[:, i], foot) for i, foot in enumerate(feet)]
        phases = [
            gait_metrics.phase_offset(feet[i], gait_metrics.touchdowns(self.feet_down[:, k])) for i, k in episode.pairs
        ]
        period = float(np.median(np.concatenate([np.diff(foot, axis=1) for foot in feet])))
        heights = zip(self.motion.sole_height[self.begin :].T, self.feet_down[self.begin :].T, strict=True)
        return {
            "strides": float(sum(map(len, feet))),
            "stride_time": period * self.dt,
            "stride_frequency": 1.0 / (period * self.dt),
            "stride_variation": _mean([gait_metrics.stride_variation(foot) for foot in feet]),
            "duty_factor": _mean(duty),
            "phase_offset": gait_metrics.circular_mean(phases),
            "duty_symmetry": _mean([gait_metrics.symmetry_index(duty[i], duty[k]) for i, k in episode.pairs]),
            # Time from the one foot's touchdown to the other's, against that from the other's to the one's.
            "step_symmetry": _mean([gait_metrics.symmetry_index(phase, 1.0 - phase) for phase in phases]),
            "regularity": gait_metrics.regularity(self.motion.angles[self.begin :], round(period)),
            "foot_clearance": _mean([gait_metrics.swing_clearance(height, down) for height, down in heights]),
            **self._asymmetry(),
        }

    def _asymmetry(self) -> dict[str, float]:
        """Compute the asymmetry of each pair of joints, by the name of the joint in the leg that comes first."""
        robot, asymmetries = self.robot, {}
        names = [joint.name for joint in robot.joints]
        for i, _ in self.episode.pairs:
            for joint in robot.legs[i]:
                other = robot.mirror[joint.name]
                if other != joint.name:
                    angle = self.motion.angles[:, names.index(joint.name)]
                    mirrored = self.motion.angles[:, names.index(other)] * robot.mirror_sign(other)
                    asymmetries[asymmetry_of(joint.name)] = gait_metrics.shifted_rms(angle, mirrored, self.strides[i])
        return asymmetries


def asymmetry_of(joint: str) -> str:
    """Name the metric for the left-right difference of a joint's movement."""
    return f"{ASYMMETRY}{joint}"


def summarize(episodes: Sequence[Episode], robot: Robot, dt: float) -> dict[str, float | None]:
    """Average metrics of the last 10 m over the recorded episodes that got that far; empty if none did.

    ``periodic_fraction`` is the share of those with a periodic gait, and ``strides`` the number of their strides, over
    all feet. Metrics of ``OF_STRIDES`` are ``None`` unless half of the gaits are periodic: a few would not be typical.
    """
    far = [e for e in episodes if e.walked is not None and e.motion is not None]
    gaits = [Gait(e, e.motion, robot, dt) for e in far if e.motion is not None]
    if not gaits:
        return {}
    body = total_mass(robot), robot.leg_length, standing_height(robot)
    periodic = [gait for gait in gaits if gait.periodic]
    means: dict[str, float | None] = {
        **_averages([gait.of_time(*body) for gait in gaits]),
        "periodic_fraction": len(periodic) / len(gaits),
        "strides": 0.0,
    }
    if 2 * len(periodic) < len(gaits):
        return {**means, **dict.fromkeys(OF_STRIDES)}
    each = [gait.of_strides() for gait in periodic]
    multipliers = gait_metrics.floquet_multipliers([gait.sections for gait in periodic])
    return {
        **means,
        **_averages(each),
        "strides": sum(one["strides"] for one in each),
        "phase_offset": gait_metrics.circular_mean([one["phase_offset"] for one in each]),
        "floquet_max": None if multipliers is None else float(np.abs(multipliers[0])),
    }


def why_missing(gait: Mapping[str, float | None], key: str) -> str:
    """Return the reason why a metric of ``OF_STRIDES`` is ``None`` in the result of :func:`summarize`."""
    fraction = gait.get("periodic_fraction") or 0.0
    return "too few strides" if key == "floquet_max" and 2 * fraction >= 1 else "not periodic"


def _averages(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    return {key: _mean([row[key] for row in rows]) for key in rows[0]}


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan
