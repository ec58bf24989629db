"""Pairs of joints that are mirror images of each other, of which one leads and the other follows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gctd3.robots.robot import Robot


@dataclass(frozen=True)
class JointPairs:
    """Hold pairs of driven joints; a joint without a mirror image is a pair by itself.

    Attributes:
        leaders: Action of the joint that leads each pair, the one that the robot lists first, ``[P]``.
        pair_of: Number of the pair of each action, ``[A]``.
        follows: Whether the action is that of a pair's other joint, bool ``[A]``.
        sign: Sign of the action that mirrors its leader's, ``[A]``; 1 for leaders.
    """

    leaders: Tensor
    pair_of: Tensor
    follows: Tensor
    sign: Tensor

    @classmethod
    def of(cls, robot: Robot) -> JointPairs:
        """Return the pairs of a robot."""
        partner, signs = map(torch.from_numpy, robot.action_mirror)
        own = torch.arange(len(partner))
        leaders, pair_of = torch.unique(torch.minimum(own, partner), return_inverse=True)
        follows = own > partner
        return cls(leaders, pair_of, follows, torch.where(follows, signs, 1.0).float())
