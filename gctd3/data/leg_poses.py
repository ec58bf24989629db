"""Poses of legs, as actions: drawn up below the body, and which joints are alike in different legs."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gctd3.errors import ConfigError
from gctd3.robots.robot import Robot
from gctd3.robots.sole_heights import SoleHeights

SAMPLES = 4096  # of actions, among which that is sought which draws a leg up
AWAY = 0.05  # share of a leg's length that an action of a joint away from standing has to gain


def drawn_up(robot: Robot) -> Tensor:
    """Return actions that draw all legs up below an upright body, ``[A]``.

    They are the best of many random ones for each leg: how far its sole is lifted, less a little for each joint that is
    moved away from where it is when the robot stands.
    """
    soles = SoleHeights.of(robot)
    if soles is None:
        raise ConfigError("exploration.warmup must not be jumping: the heights of the robot's soles are not known.")
    names = [joint.name for joint in robot.joints]
    driven, home = [names.index(name) for name in robot.actuated], robot.home_angles
    centre, scale = robot.action_map
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (SAMPLES, len(driven)))
    angles = np.repeat(home[None], SAMPLES, axis=0)
    angles[:, driven] = np.clip(
        centre + scale * actions, *np.array([joint.range for joint in robot.joints]).T[:, driven]
    )
    lifts = soles.below(angles, np.broadcast_to(np.array([0.0, 0.0, 1.0]), (SAMPLES, 3))) / robot.leg_length
    standing = (home[driven] - centre) / scale
    best = np.clip(standing, -1.0, 1.0)
    for foot, leg in enumerate(robot.legs):
        own = [i for i, name in enumerate(robot.actuated) if name in {joint.name for joint in leg}]
        cost = AWAY * ((actions - standing)[:, own] ** 2).sum(axis=1)
        best[own] = actions[int((lifts[:, foot] - cost).argmax())][own]
    return torch.from_numpy(best).float()


def places_in_legs(robot: Robot) -> Tensor:
    """Return for each action the first one that moves a joint of the same place in a leg, ``[A]``."""
    place = {joint.name: number for leg in robot.legs for number, joint in enumerate(leg)}
    first: dict[int, int] = {}
    return torch.tensor([first.setdefault(place.get(n, -1 - i), i) for i, n in enumerate(robot.actuated)])
