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


def corrected(robot, gait, correction, rounds=4, noise=0.02):
    """Ask a gait for velocities in rounds, as robots would be; return the mean error of each round, without noise."""
    generator, left = torch.Generator().manual_seed(0), []
    for _ in range(rounds):
        command = torch.rand(500, 3, generator=generator) * 1.6 - 0.8
        which = torch.full((500,), gait)
        asked = correction(command, which)
        moved = robot(asked)
        left.append(float((moved - command).abs().mean()))
        correction.observe(command, asked, moved + noise * torch.randn(500, 3, generator=generator), which)
        correction.fit()
    return left


@pytest.mark.parametrize(
    ("robot", "at_first", "share"), [(drifting, 0.1, 0.1), (tiring, 0.025, 0.3), (creeping, 0.045, 0.1)]
)
def test_what_is_left_of_the_error_becomes_small(robot, at_first, share):
    left = corrected(robot, 0, CommandCorrection(1))
    assert left[0] > at_first and left[-1] < share * left[0]


def test_gaits_have_corrections_of_their_own():
    correction = CommandCorrection(3)
    corrected(drifting, 0, correction)
    corrected(creeping, 2, correction)
    command = torch.tensor([[0.5, 0.2, 0.1]]).expand(4, 3)
    asked = correction(command, torch.tensor([0, 1, 2, -1]))
    for gait, robot in ((0, drifting), (2, creeping)):
        torch.testing.assert_close(robot(asked[gait]), command[0], atol=0.02, rtol=0.0)
    # The second gait was never observed, and the last robot follows none.
    assert torch.equal(asked[[1, 3]], command[:2])


def test_a_gait_that_cannot_go_as_fast_is_not_asked_for_ever_more():
    """Ask for no more than twice the largest command, however slow the robot is."""
    correction = CommandCorrection(1)
    left = corrected(lambda asked: 0.3 * torch.tanh(asked / 0.3), 0, correction, rounds=12)
    asked = correction(torch.tensor([[0.8, -0.8, 0.8]]), torch.tensor([0]))
    assert asked.abs().max() <= 2.0 * 0.8 + 1e-6
    # Slow commands are followed all the while.
    slow = torch.tensor([[0.1, 0.1, -0.1]])
    torch.testing.assert_close(correction(slow, torch.tensor([0])), slow, atol=0.1, rtol=0.0)
    assert left[-1] < 1.1 * left[0]


def test_what_was_observed_before_is_forgotten():
    correction = CommandCorrection(1)
    corrected(drifting, 0, correction)
    command = torch.tensor([[0.5, 0.2, 0.1]])
    assert not torch.equal(correction(command, torch.tensor([0])), command)
    correction.forget()
    assert torch.equal(correction(command, torch.tensor([0])), command)


def test_a_command_to_stand_is_left_alone():
    correction = CommandCorrection(1)
    corrected(creeping, 0, correction)
    assert correction.correction.abs().max() > 0
    assert not correction(torch.zeros(2, 3), torch.zeros(2, dtype=torch.int64)).any()


def test_what_no_command_had_is_not_corrected():
    """A base that can only go forward is never asked for anything else."""
    correction = CommandCorrection(1)
    correction.fit()
    assert not correction.correction.any()
    forward = torch.tensor([[0.5, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.8, 0.0, 0.0], [0.1, 0.0, 0.0]])
    which = torch.zeros(4, dtype=torch.int64)
    for _ in range(3):
        asked = correction(forward, which)
        correction.observe(forward, asked, 0.7 * asked, which)
        correction.fit()
    asked = correction(forward, which)
    torch.testing.assert_close(asked, forward / 0.7, atol=0.03, rtol=0.0)
    assert not asked[:, 1:].any()
