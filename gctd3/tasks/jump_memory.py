"""Arrays that terms of a jump remember: its apex, and for how long the robot has stood after it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gctd3.robots.array_library import array_namespace
from gctd3.tasks.heading import gravity
from gctd3.tasks.jump_command import HEIGHT
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.terms import Array, Remembered, RobotFacts, Step

SAG = 0.15  # of the body's height from standing, up to which a robot stands (leg lengths)
TILT = 0.3  # of the body, up to which a robot stands (rad)


def sole_heights(now: Measurement, facts: RobotFacts) -> Array:
    """Return the height of each foot's lowest point above the ground, shape ``[*, feet]`` (m).

    On terrain the ground is that below the body, as it is of the body's height.
    """
    if facts.soles is None:
        raise ValueError("The heights of the soles of this robot cannot be computed.")
    xp, down = array_namespace(now.angles), gravity(now, facts)
    # Without a coordinate, gravity is given as a number that broadcasts.
    up = xp.stack([now.height * 0.0 - down[axis] for axis in ("forward", "side", "up")], axis=-1)
    return now.height[..., None] + facts.soles.standing + facts.soles.below(now.angles, up)


def clearance(now: Measurement, facts: RobotFacts) -> Array:
    """Return the height of the lowest sole while nothing touches the ground, else 0, shape ``[*]`` (m)."""
    xp = array_namespace(now.angles)
    lowest = xp.min(sole_heights(now, facts), axis=-1)
    up = ~(xp.any(now.feet_down, axis=-1) | now.other_down | now.shank_down)
    return xp.where(up & (lowest > 0.0), lowest, 0.0)


def standing(now: Measurement, facts: RobotFacts) -> Array:
    """Return whether robots stand: upright at about their height, on all feet and on nothing else, bool ``[*]``."""
    xp = array_namespace(now.angles)
    touches = xp.all(now.feet_down, axis=-1) & ~now.other_down & ~now.shank_down
    return touches & (xp.abs(now.height) <= SAG * facts.leg_length) & (now.tilt <= TILT)


def _grounded(before: Array, step: Step) -> Array:
    return before | step.xp.all(step.now.feet_down, axis=-1)


def _apex(before: Array, step: Step) -> Array:
    # What a robot is dropped from is no jump.
    jumped = step.before[GROUNDED.name]
    return step.xp.where(jumped, step.xp.maximum(before, clearance(step.now, step.facts)), before)


def _stood(before: Array, step: Step) -> Array:
    reached = step.before[APEX.name] >= step.before[HEIGHT][..., 0]
    return step.xp.where(reached & standing(step.now, step.facts), before + 1, 0)


# Whether all feet were down together in the episode, shape [*].
GROUNDED = Remembered("jump_grounded", (), False, _grounded)
# Greatest height of the lowest sole since then, with nothing on the ground, shape [*] (m).
APEX = Remembered("jump_apex", (), 0.0, _apex)
# Control steps for which the robot has stood since a jump of at least the commanded height, shape [*].
STOOD = Remembered("jump_stood", (), 0, _stood)
ARRAYS = (GROUNDED, APEX, STOOD)


def jumped(memory: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Return the commanded height and the apex so far of robots' jumps, ``[*, 2]`` (m); ``None`` without jumps."""
    if HEIGHT not in memory or APEX.name not in memory:
        return None
    return np.stack([memory[HEIGHT][..., 0], memory[APEX.name]], axis=-1)
