"""Commands are corrected until a robot that moves otherwise than asked moves as commanded."""

import pytest
import torch

from gctd3.data.command_correction import CommandCorrection


def drifting(asked):
    """Move as a robot that slides, and that turns when it goes forward and to the side at once."""
    forward, side, turn = asked.unbind(-1)
    return torch.stack([0.8 * forward - 0.1 * side.square(), 1.2 * side, turn + 0.9 * forward * side], dim=-1)


def tiring(asked):
    """Move as a robot whose legs yield the more the faster it goes, and that turns less when it goes fast."""
    forward, side, turn = asked.unbind(-1)
    return torch.stack([1.15 * forward - 0.4 * forward**3, side, turn * (1.16 - 0.75 * forward.square())], dim=-1)


def creeping(asked):
    """Move as a robot that goes backward on the spot, and stands still when it is to stand."""
    return asked - torch.tensor([0.15, 0.0, 0.0]) * (asked != 0).any(dim=-1, keepdim=True)


@pytest.mark.parametrize(
    ("robot", "at_first", "share"), [(drifting, 0.1, 0.2), (tiring, 0.025, 0.4), (creeping, 0.045, 0.2)]
)
def test_what_is_left_of_the_error_becomes_small(robot, at_first, share):
    generator = torch.Generator().manual_seed(0)
    correction, left = CommandCorrection(), []
    for _ in range(4):
        command = torch.rand(500, 3, generator=generator) * 1.6 - 0.8
        moved = robot(correction(command))
        left.append(float((moved - command).abs().mean()))
        correction.observe(command, moved + 0.02 * torch.randn(500, 3, generator=generator))
        correction.end_round()
    assert left[0] > at_first and left[-1] < share * left[0]


def test_a_command_to_stand_is_left_alone():
    correction = CommandCorrection()
    correction.observe(torch.rand(20, 3), torch.rand(20, 3))
    correction.end_round()
    assert correction.correction.abs().max() > 0
    assert not correction(torch.zeros(2, 3)).any()


def test_what_no_command_had_is_not_corrected():
    """A base that can only go forward is never asked for anything else."""
    correction = CommandCorrection()
    correction.end_round()
    assert not correction.correction.any()
    forward = torch.tensor([[0.5, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.8, 0.0, 0.0], [0.1, 0.0, 0.0]])
    correction.observe(forward, 0.5 * forward)
    correction.end_round()
    asked = correction(forward)
    # Half as fast as commanded: half of the command is missing, and asked for in addition.
    torch.testing.assert_close(asked, 1.5 * forward, atol=0.02, rtol=0.0)
    assert not asked[:, 1:].any()
