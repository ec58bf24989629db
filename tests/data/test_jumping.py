"""Jumps that evolve in the warm-up: their poses, their evolution, and what policies imitate."""

import numpy as np
import pytest
import torch

from gctd3.data.exploration import Explorer
from gctd3.data.gait_policy import ByClock, fittest_gait
from gctd3.data.jumping import POSES, TIMES, Jumping
from gctd3.data.settings import ExplorationSettings
from gctd3.data.trials import Shown, Trials
from gctd3.errors import ConfigError
from gctd3.nn import make_actor
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.jump import JumpSettings
from gctd3.tasks.jump_command import JumpCommand
from gctd3.tasks.walk import WalkSettings

LEVELS = (0.1, 0.2)
LIMIT = 10  # control steps of an episode


@pytest.fixture(scope="module")
def task():
    return JumpSettings(commands={"jump": JumpCommand(levels=LEVELS)}).build(RobotSettings("biped"))


def jumps_of(task, robots=32, steps=None, limit=LIMIT):
    torch.manual_seed(0)
    trials = Trials(1.0, task.control_dt, steps=steps, limit=limit)
    return Jumping(task.robot, robots, task.levels, task.gait.frequency, trials)


def episodes(jumps, count, fitness, commands):
    """Let all robots try ``count`` jumps, whose return is ``fitness(jumps [N, D], level [N])``."""
    robots = len(commands)
    for _ in range(count):
        for step in range(LIMIT):
            first = torch.full((robots,), step == 0)
            returned = torch.zeros(robots) if step == 0 else fitness(jumps.tried_now, jumps.level)
            jumps(first, returned, shown=Shown(commands))


def test_a_jump_begins_and_ends_as_the_robot_stands(task):
    jumps = jumps_of(task)
    drawn = torch.randn(4, jumps.search.mean.shape[1])
    standing = (task.robot.home_angles - task.robot.action_map[0]) / task.robot.action_map[1]
    standing = standing.clip(-Jumping.MOST, Jumping.MOST)
    for time in (0.0, 0.29, 2.5):
        np.testing.assert_allclose(jumps.poses(drawn, torch.full((4,), time)), np.tile(standing, (4, 1)), atol=1e-6)


def test_poses_are_joined_by_lines(task):
    """At the middle times crouch = 0.35 s and spacing = 0.085 s, by hand."""
    jumps = jumps_of(task)
    assert TIMES == ((0.2, 0.5), (0.05, 0.12))
    poses = torch.linspace(-0.9, 0.9, POSES)[:, None] * torch.tensor([1.0, 0.5, -1.0])
    drawn = torch.cat([torch.zeros(2), poses.flatten()])[None]
    for k in range(POSES - 1):
        for share in (0.0, 0.25):
            time = 0.3 + 0.35 + 0.085 * (k + share)
            expected = (1 - share) * poses[k] + share * poses[k + 1]
            action = jumps.poses(drawn, torch.tensor([time]))[0]
            # Hip, knee and ankle of the right leg, then of the left one, whose joints turn alike.
            np.testing.assert_allclose(action, torch.cat([expected, expected]), atol=1e-5)


def test_legs_are_drawn_up_at_first(task):
    """In the middle of the first jump the soles are well above those of a robot that stands."""
    jumps = jumps_of(task)
    time = torch.tensor([0.3 + 0.35 + 3.5 * 0.085])
    action = jumps.poses(jumps.search.mean[:1], time)[0].numpy().astype(np.float64)
    lifted = task.facts.soles.below(task.robot.desired_angles(action), np.array([0.0, 0.0, 1.0]))
    assert (lifted + task.facts.soles.standing > 0.3).all()


def test_hind_legs_begin_as_front_legs_do():
    quadruped = JumpSettings().build(RobotSettings("quadruped", action_scale="range"))
    jumps = jumps_of(quadruped)
    action = jumps.poses(jumps.search.mean[:1], torch.tensor([0.9]))[0].reshape(4, 3)
    np.testing.assert_allclose(action, action[:1].expand(4, 3), atol=1e-6)


def test_each_height_finds_its_own_jump(task):
    """Returns are the nearness to a target that differs between the heights: both distributions move there."""
    jumps, commands = jumps_of(task, robots=64), torch.tensor(LEVELS).repeat(32)[:, None]
    targets = torch.stack([torch.full((jumps.search.mean.shape[1],), value) for value in (0.3, -0.4)])

    def nearness(tried, level):
        return -10.0 * (tried - targets[level]).square().mean(dim=1)

    before = (jumps.search.mean - targets).square().mean(dim=1).sqrt()
    episodes(jumps, 60, nearness, commands)
    after = (jumps.search.mean - targets).square().mean(dim=1).sqrt()
    assert jumps.tried and (after < 0.35 * before).all()
    assert (jumps.winners - targets).square().mean(dim=1).sqrt().max() < 0.3
    assert (jumps.search.size * jumps.search.spread.mean(dim=1).sqrt() < 0.4).all()


def test_the_last_round_tries_the_fittest_again_and_the_mean_wins(task):
    """Returns are luck but for one of the elite, which is worth 1 each time."""
    jumps, commands = jumps_of(task, robots=64, steps=40 * LIMIT), torch.tensor(LEVELS).repeat(32)[:, None]
    luck = torch.Generator().manual_seed(1)

    def lucky(tried, level):
        return torch.rand(len(tried), generator=luck) * 2.0

    episodes(jumps, 27, lucky, commands)
    good = jumps.elite[:, 3].clone()

    def steady(tried, level):
        same = (tried - good[level]).abs().amax(dim=1) < 1e-6
        return torch.where(same, 1.0, 0.5 * torch.rand(len(tried), generator=luck))

    episodes(jumps, 7, steady, commands)
    assert (jumps.count.sum(dim=1) > 50).all()
    torch.testing.assert_close(jumps.winners, good)
    # Then all robots try them.
    assert jumps.shows and jumps.followers.all()
    torch.testing.assert_close(jumps.tried_now, good[jumps.level])


def test_a_fall_costs(task):
    """Lower the return of a robot that fell, after 4 of 10 steps, by the penalty."""
    jumps = jumps_of(task, robots=2)
    commands = torch.tensor([[0.1], [0.2]])
    for step in range(LIMIT + 1):
        first = torch.tensor([step in (0, 4), step in (0, LIMIT)])
        jumps(first, torch.full((2,), 0.0 if step == 0 else 7.0), shown=Shown(commands))
    assert jumps.result_level[:2].tolist() == [0, 1]
    assert jumps.result[:2].tolist() == pytest.approx([7.0 - Jumping.FALL, 7.0])


def test_policies_imitate_what_robots_did(task):
    """Replayed by the clock that observations show, the winner of each height acts as it did when it was tried."""
    jumps, commands = jumps_of(task, robots=16), torch.tensor(LEVELS).repeat(8)[:, None]
    episodes(jumps, 6, lambda tried, level: -tried.square().mean(dim=1), commands)
    assert jumps.tried and isinstance(fittest_gait(jumps, task), ByClock)
    steps = torch.arange(40)
    for level, height in enumerate(LEVELS):
        phase = task.gait.frequency * task.control_dt * steps
        action = jumps.fittest_action(phase, Shown(torch.full((40, 1), height)))
        expected = jumps.poses(jumps.winners[level].expand(40, -1), task.control_dt * (steps + 1)).clamp(-1.0, 1.0)
        torch.testing.assert_close(action, expected, atol=1e-4, rtol=0)
    with pytest.raises(ValueError, match="commanded height"):
        jumps.fittest_action(phase)
    assert not (jumps.anew or jumps.shows)


def test_it_goes_on_exactly_as_it_was(task):
    commands = torch.tensor(LEVELS).repeat(8)[:, None]
    jumps, other = jumps_of(task, robots=16), jumps_of(task, robots=16)
    episodes(jumps, 5, lambda tried, level: tried[:, 3], commands)
    other.load_state_dict(jumps.state_dict())
    futures = []
    for one in (jumps, other):
        torch.manual_seed(5)
        episodes(one, 3, lambda tried, level: tried[:, 3], commands)
        futures.append(one.state_dict())
    assert all(torch.equal(futures[0][name], futures[1][name]) for name in futures[0])


def test_only_jumps_are_warmed_up_by_jumping(task):
    settings = ExplorationSettings(warmup="jumping")
    walking = WalkSettings().build(RobotSettings("biped"))
    with pytest.raises(ConfigError, match=r"exploration\.warmup must not be jumping for this task"):
        Explorer.of_task(walking, make_actor(walking.graph), 2, settings)
    explorer = Explorer.of_task(task, make_actor(task.graph), 2, settings)
    assert isinstance(explorer.rhythm, Jumping) and "episode_reward" in explorer.in_keys
    # Other warm-ups of the task follow no command.
    for warmup in ("stepping", "swinging", "rhythmic", "uniform"):
        Explorer.of_task(task, make_actor(task.graph), 2, ExplorationSettings(warmup=warmup))
