"""Reflexes of feet that step: they answer to a body that tilts, speeds up or drifts, with gains that evolve."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from gctd3.tasks.posture import SENSES

FORWARD, SIDE = SENSES[:3], SENSES[3:]
GAIN, SOLE_GAIN, LEVEL_GAIN = 0.6, 1.0, 0.3  # largest of either sign
NONE_AT_FIRST = 0.5  # share of the gains that are 0 in a gait that is drawn, so that few act against each other


def _genes() -> dict[str, tuple[float, float, bool]]:
    genes = {f"{when}_{sense}": (-GAIN, GAIN, False) for when in ("stance", "swing") for sense in SENSES}
    genes |= {f"sole_{sense}": (-SOLE_GAIN, SOLE_GAIN, False) for sense in SENSES}
    return genes | {f"level_{sense}": (-LEVEL_GAIN, LEVEL_GAIN, False) for sense in ("roll", "roll_rate")}


# Lowest and highest value of each gain, none of which differs from pair to pair of feet: in leg lengths for each unit
# of a sense, those of the sole in rad.
GENES: dict[str, tuple[float, float, bool]] = _genes()


def reflexes(genes: Mapping[str, Tensor], posture: Tensor, lift: Tensor, left: Tensor) -> Tensor:
    """Compute how far feet move for the sake of balance.

    Each displacement is linear in what is sensed. Forward ones answer to pitch and speed, those to the side to roll and
    drift, with gains of their own for a foot in the air, whose next place catches the body (Raibert 1986), and for one
    on the ground, which moves the body. Soles on the ground turn, which shifts the centre of pressure, and legs of the
    lower side stretch.

    Args:
        genes: Gains by name, ``[robots]``.
        posture: Senses less those of the steady gait, ``[robots, 6]``; NaN for what is not seen, which moves nothing.
        lift: How high each foot is in its stride, from 0 to 1, ``[robots, feet]``.
        left: 1 for feet on the left, -1 on the right, ``[feet]``.

    Returns:
        Displacements forward, to the side and up (leg lengths), and pitch and roll of the sole (rad),
        ``[robots, feet, 5]``.
    """
    sensed = dict(zip(SENSES, posture.nan_to_num(0.0).clamp(-1.0, 1.0).unbind(-1), strict=True))

    def sum_of(what: str, senses: tuple[str, ...]) -> Tensor:
        return torch.stack([genes[f"{what}_{sense}"] * sensed[sense] for sense in senses]).sum(0)[:, None]

    down = 1.0 - lift
    forward, side = (sum_of("stance", one) * down + sum_of("swing", one) * lift for one in (FORWARD, SIDE))
    up = sum_of("level", ("roll", "roll_rate")) * left
    pitch, roll = (sum_of("sole", one) * down for one in (FORWARD, SIDE))
    return torch.stack([forward, side, up.expand_as(forward), pitch, roll], dim=-1)
