"""Gaits that follow a command: feet go as the ground does, and hard commands do not make a gait less fit."""

import math

import mujoco
import pytest
import torch

from gctd3.data.commanded_stepping import CommandedStepping
from gctd3.data.foot_paths import foot_places
from gctd3.data.trials import Shown, Trials
from gctd3.robots.gait_pattern import GaitPattern, alternating_phases
from gctd3.robots.settings import RobotSettings

FREQUENCY = 2.0  # Hz


@pytest.fixture
def quadruped():
    return RobotSettings("quadruped", action_scale=0.5).load()


def commanded(robot, robots=1, **genes):
    """Make gaits with factors of 1, without crouch, shift and sway, and with the given genes."""
    torch.manual_seed(0)
    gait = GaitPattern(FREQUENCY, alternating_phases(robot))
    gaits = CommandedStepping(robot, robots, Trials(0.1, 0.02), gait)
    plain = {"forward_gain": 1.0, "side_gain": 1.0, "turn_gain": 1.0, "crouch": 0.0, "shift": 0.0, "sway": 0.0}
    for name, value in (plain | {"lead": 0.0, "lag": 0.0} | genes).items():
        getattr(gaits, name).fill_(value)
    return gaits


def genes_of(gaits):
    return {name: getattr(gaits, name) for name in gaits.GENES}


def placed(robot, gaits, cycles, command):
    """Return where each foot is in the body's frame, by MuJoCo's kinematics, ``[feet, 3]`` (m)."""
    data = mujoco.MjData(robot.model)
    action = gaits.act(genes_of(gaits), torch.tensor([float(cycles)]), Shown(torch.tensor([command])))[0].numpy()
    data.qpos[:] = robot.standing_qpos
    data.qpos[[robot.joint(name).qpos for name in robot.actuated]] += robot.action_map[1] * action
    mujoco.mj_kinematics(robot.model, data)
    return [robot.base.frame @ robot.foot_place(data, foot) for foot in robot.feet]


@pytest.mark.parametrize(
    "command", [(0.3, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.4), (0.2, 0.1, 0.3)]
)
def test_feet_on_the_ground_move_against_the_body(quadruped, command):
    """A foot that is down moves at -(v + w x r), as a point of the ground does in the frame of a moving body."""
    gaits = commanded(quadruped, duty=0.5)
    phases = alternating_phases(quadruped)
    step = 0.02
    for foot, place in enumerate(foot_places(quadruped).tolist()):
        # The middle of its stance, at three quarters of its period.
        middle = 0.75 - phases[foot]
        before, after = (placed(quadruped, gaits, middle + side * step, command)[foot] for side in (-0.5, 0.5))
        moved = (after - before)[:2] * FREQUENCY / step
        forward, side, turn = command
        expected = (-(forward - turn * place[1]), -(side + turn * place[0]))
        # Legs without a joint to the side stay in their planes.
        sideways = gaits.joints[foot, 1].abs().max() > 0
        assert moved[0] == pytest.approx(expected[0], abs=0.03)
        assert moved[1] == pytest.approx(expected[1] if sideways else 0.0, abs=0.03)


def test_a_robot_that_is_to_stand_keeps_its_feet_down(quadruped):
    gaits = commanded(quadruped, lift=0.3)
    for cycles in (0.0, 0.3, 0.6):
        still = gaits.act(genes_of(gaits), torch.tensor([cycles]), Shown(torch.zeros(1, 3)))
        assert not still.any()
        walks = gaits.act(genes_of(gaits), torch.tensor([cycles]), Shown(torch.tensor([[0.3, 0.0, 0.0]])))
        assert walks.abs().max() > 0.01


def test_a_step_is_as_long_as_the_ground_moves_while_a_foot_is_down(quadruped):
    gaits = commanded(quadruped, duty=0.6)
    half, amount = gaits._steps_of(genes_of(gaits), torch.tensor([[0.5, 0.0, 0.0]]))
    # 0.6 of half a second at 0.5 m/s, half to either side.
    expected = 0.5 * 0.5 * 0.6 / FREQUENCY / quadruped.leg_length
    torch.testing.assert_close(half, torch.tensor([expected, 0.0]).expand(1, len(quadruped.feet), 2))
    assert float(amount) == 1.0
    # Slower than a twentieth of sqrt(g L) feet are lifted in proportion.
    slow = 0.01 * math.sqrt(9.81 * quadruped.leg_length)
    assert float(gaits._steps_of(genes_of(gaits), torch.tensor([[slow, 0.0, 0.0]]))[1]) == pytest.approx(0.2)


def test_no_step_is_longer_than_a_leg_can_reach(quadruped):
    """Feet that would go too far go less far, all of them in proportion, and in the same directions."""
    gaits = commanded(quadruped, duty=0.5)
    slow, fast = (gaits._steps_of(genes_of(gaits), k * torch.tensor([[0.5, 0.1, 0.4]]))[0] for k in (0.1, 20.0))
    assert float(fast.norm(dim=-1).max()) == pytest.approx(0.45)
    torch.testing.assert_close(fast / fast.norm(dim=-1).max(), slow / slow.norm(dim=-1).max())


def test_a_hard_command_does_not_make_a_gait_less_fit(quadruped):
    """Rewards that only depend on the command leave all gaits alike; a gait that earns more beyond that is fitter."""
    robots = 64
    gaits = commanded(quadruped, robots)
    generator = torch.Generator().manual_seed(1)
    nothing, returned = torch.zeros(robots, dtype=torch.bool), torch.zeros(robots)
    better = torch.zeros(robots)
    better[5] = 0.2
    command = torch.zeros(robots, 3)
    for step in range(5 * 6 + 1):
        gaits(~nothing if step == 0 else nothing, returned, shown=Shown(command))
        if step % 5 == 0:
            command = torch.rand(robots, 3, generator=generator) - 0.5
            # A trial's first action follows its command.
            gaits.asked_so_far.copy_(gaits._sizes(command))
        returned = returned + 2.0 - command[:, 0].abs() - 0.5 * command[:, 2].abs() + better
    assert int(gaits.fitness.argmax()) == 5
    others = torch.cat([gaits.fitness[:5], gaits.fitness[6:]])
    assert others.abs().max() < 0.05 < float(gaits.fitness[5])


def test_a_trial_that_the_time_limit_cuts_short_counts_as_no_fall(quadruped):
    torch.manual_seed(0)
    gaits = CommandedStepping(quadruped, 2, Trials(0.1, 0.02, limit=7))
    begins, command = torch.ones(2, dtype=torch.bool), torch.tensor([[0.3, 0.0, 0.0]]).expand(2, 3)
    for step in range(8):
        now = begins if step == 0 else torch.tensor([step == 7, step == 3])
        gaits(now, torch.full((2,), 0.1 * step) * ~now, shown=Shown(command))
    # The first one's trial of five steps ended, its second one was cut short; the other robot fell after three.
    assert float(gaits.results[0]) == pytest.approx(0.1)
    assert float(gaits.results[1]) < -0.9


def test_it_needs_the_command(quadruped):
    gaits = commanded(quadruped)
    with pytest.raises(ValueError, match="need it"):
        gaits(torch.ones(1, dtype=torch.bool), torch.zeros(1))


def test_commands_are_corrected_by_robots_without_noise(quadruped):
    """Half of the robots of each gait follow it as it is, and only these are observed."""
    torch.manual_seed(0)
    robots = 16
    gaits = CommandedStepping(quadruped, robots, Trials(0.1, 0.02, steps=1000))
    command = torch.tensor([[0.4, 0.1, 0.2]]).expand(robots, 3)
    gaits.final.fill_(True)
    gaits.finalist.zero_()
    gaits.SETTLED = 0.0
    begins = torch.ones(robots, dtype=torch.bool)
    for step in range(6):
        # The robots with noise stand still, the others do as commanded.
        moved = torch.where(gaits.steady[:, None], command, torch.zeros(robots, 3))
        shown = Shown(command, velocity=moved)
        action = gaits(begins if step == 0 else ~begins, torch.zeros(robots), shown=shown)
        plain = gaits.act(genes_of(gaits), gaits.cycles, shown).clamp(-1.0, 1.0)
        assert torch.equal(action[:8], plain[:8]) and not (action[8:] == plain[8:]).all(dim=1).any()
    gaits.correction.fit()
    assert gaits.correction.moments.any() and gaits.correction.correction.abs().max() < 1e-6


def test_what_was_asked_for_changes_only_with_the_command(quadruped):
    """A gait that slides is asked for more once a fit shows it, but not before the next command."""
    torch.manual_seed(0)
    robots = 64
    gaits = CommandedStepping(quadruped, robots, Trials(0.1, 0.02, steps=10_000))
    gaits.final.fill_(True)
    gaits.finalist.zero_()
    gaits.SETTLED = 0.0
    begins, slow = torch.ones(robots, dtype=torch.bool), 0.5
    command, asked = torch.empty(robots, 3).uniform_(-0.4, 0.4), []
    for step in range(50):
        if step % 10 == 0:
            command = torch.empty(robots, 3).uniform_(-0.4, 0.4)
        shown = Shown(command, velocity=slow * gaits.corrected)
        gaits(begins if step == 0 else ~begins, torch.zeros(robots), shown=shown)
        asked.append(gaits.corrected.clone())
        assert step % 10 == 0 or torch.equal(asked[-1], asked[-2])
    assert torch.equal(asked[0].abs() <= 0.4, torch.ones(robots, 3, dtype=torch.bool))
    within = (command.abs() < 0.35).all(dim=1)  # what is asked for is bounded by twice the largest command so far
    torch.testing.assert_close(slow * asked[-1][within], command[within], atol=0.03, rtol=0.0)


def test_a_gait_that_moves_otherwise_than_commanded_is_less_fit(quadruped):
    """0.1 m/s and 0.2 rad/s off cost 2 * (0.1 + 0.75 * 0.2) of the mean reward."""
    torch.manual_seed(0)
    gaits = CommandedStepping(quadruped, 2, Trials(0.1, 0.02))
    gaits.SETTLED = 0.0
    command = torch.tensor([[0.3, 0.1, 0.2]]).expand(2, 3)
    moved = command + torch.tensor([[0.0, 0.0, 0.0], [0.06, -0.08, 0.2]])
    begins = torch.ones(2, dtype=torch.bool)
    for step in range(6):
        gaits(begins if step == 0 else ~begins, torch.zeros(2), shown=Shown(command, velocity=moved))
    assert float(gaits.results[0]) == pytest.approx(0.0, abs=1e-6)
    assert float(gaits.results[1]) == pytest.approx(-0.5)
