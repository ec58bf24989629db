"""Arrays that gait terms remember: durations of each foot's contact and swing, and of each hip on one side."""

from __future__ import annotations

from gctd3.tasks.measurement import Measurement
from gctd3.tasks.terms import Array, Remembered, RobotFacts, Step, hips


def _contact(before: Array, step: Step) -> Array:
    return step.xp.where(step.now.feet_down, before + 1, 0)


def _air(before: Array, step: Step) -> Array:
    return step.xp.where(step.now.feet_down, 0, before + 1)


def _positive_at_first(now: Measurement, facts: RobotFacts) -> Array:
    return hips(now, facts) >= 0.0


def _positive(before: Array, step: Step) -> Array:
    return step.hips >= 0.0


def _same_side(before: Array, step: Step) -> Array:
    return step.xp.where((step.hips >= 0.0) == step.before[HIP_POSITIVE.name], before + 1, 1)


# Control steps for which each foot has been down, shape [*, feet].
CONTACT_STEPS = Remembered("contact_steps", ("feet",), 0, _contact)
# Control steps for which each foot has been up, shape [*, feet].
AIR_STEPS = Remembered("air_steps", ("feet",), 0, _air)
# Control steps for which each hip has kept its sign, shape [*, feet]; and whether that is positive.
HIP_STEPS = Remembered("hip_steps", ("feet",), 0, _same_side)
HIP_POSITIVE = Remembered("hip_positive", ("feet",), _positive_at_first, _positive)
