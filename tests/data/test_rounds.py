"""Rounds of the warm-up: when one is over, what the next one begins with, and gaits that begin from standing."""

from dataclasses import replace

import pytest
import torch
from hydra import compose, initialize_config_module
from tensordict import TensorDict

from gctd3.config.build import build
from gctd3.data.commanded_stepping import CommandedStepping
from gctd3.data.exploration import Explorer
from gctd3.data.inline_collector import InlineCollector
from gctd3.data.settings import ExplorationSettings
from gctd3.data.stepping import Stepping
from gctd3.data.trials import Shown, Trials
from gctd3.envs.factory import EnvRecipe
from gctd3.errors import ConfigError
from gctd3.robots.settings import RobotSettings

ROBOTS = 8
DT = 0.02


@pytest.fixture(scope="module")
def quadruped():
    return RobotSettings("quadruped", action_scale=0.5).load()


class Actor(torch.nn.Module):
    """Act by a number, whatever is observed."""

    in_keys, out_keys = ("nodes",), ("action",)

    def __init__(self, actions):
        super().__init__()
        self.value = torch.nn.Parameter(torch.tensor(0.25))
        self.actions = actions

    def forward(self, seen):
        return seen.set("action", self.value.expand(len(seen), self.actions))


def gaits_of(robot, **trials):
    torch.manual_seed(0)
    return Stepping(robot, ROBOTS, Trials(**{"duration": 2 * DT, "control_dt": DT, **trials}))


def play(gaits, steps, returned):
    """Take steps that none of the robots begins an episode in; return what they have earned then."""
    nothing = torch.zeros(ROBOTS, dtype=torch.bool)
    for _ in range(steps):
        returned = returned + 0.01 * torch.rand(ROBOTS)
        gaits(nothing, returned)
    return returned


def begun(gaits):
    gaits(torch.ones(ROBOTS, dtype=torch.bool), torch.zeros(ROBOTS))
    return torch.zeros(ROBOTS)


def test_a_round_ends_with_the_fittest_few_and_another_one_searches_on(quadruped):
    """Try the fittest few from the 14th to the 20th of 40 steps in two rounds, and from the 34th to the 40th."""
    gaits = gaits_of(quadruped, steps=40, rounds=2)
    returned = begun(gaits)
    final, over = [bool(gaits.final)], [gaits.round_over]
    for step in range(1, 40):
        if step == 20:
            gaits.go_on()
        returned = play(gaits, 1, returned)
        final.append(bool(gaits.final))
        over.append(gaits.round_over)
    assert final == 14 * [False] + 6 * [True] + 14 * [False] + 6 * [True]
    # After its last step the first round is over; the last round has none that follows.
    assert over == [*(19 * [False]), True, *(20 * [False])]


def test_one_of_the_last_gaits_can_be_chosen(quadruped):
    """The fittest by the mean unless one is chosen; with eight robots each of the eight finalists has one."""
    gaits = gaits_of(quadruped, steps=40, rounds=2)
    play(gaits, 19, begun(gaits))
    ranked = [gaits.finalist.tolist()[i] for i in gaits.fitness.argsort(descending=True).tolist()]
    assert gaits.finalists == ranked
    for one in (None, *ranked):
        gaits.choose(one)
        robot = gaits.finalist.tolist().index(ranked[0] if one is None else one)
        assert gaits.followers.nonzero().tolist() == [[robot]]
        assert gaits._fittest(1)["stride"].tolist() == [gaits.best_stride[robot].item()]
    # The choice is part of the state, and holds for this round.
    other = gaits_of(quadruped, steps=40, rounds=2)
    other.load_state_dict(gaits.state_dict())
    assert other.followers.tolist() == gaits.followers.tolist()
    gaits.go_on()
    assert gaits.finalists == []
    assert gaits._fittest(1)["stride"].tolist() == [gaits.best_stride[int(gaits.fitness.argmax())].item()]


def test_between_two_rounds_robots_wait_for_a_new_episode(quadruped):
    """They ask for it, since a clock has gone on, and no gait is tried that did not begin with it."""
    gaits = gaits_of(quadruped, steps=40, rounds=2)
    returned = play(gaits, 19, begun(gaits))
    gaits.go_on()
    known = gaits.fitness.clone()
    assert gaits.anew.tolist() == ROBOTS * [True]
    returned = play(gaits, 3, returned)
    ends = torch.arange(ROBOTS) < 3
    assert gaits.fitness.tolist() == known.tolist() and gaits.anew.all()
    gaits(ends, torch.where(ends, 0.0, returned))
    assert gaits.anew.tolist() == (~ends).tolist() and gaits.age[ends].tolist() == [1, 1, 1]
    assert gaits.cycles[ends].unique().numel() == gaits.frequency[ends].unique().numel()


def test_a_round_is_long_enough_for_a_trial_of_its_last_gaits():
    """Hold a trial of 4 s in the last three tenths of each of three rounds of 40 s, but not of four."""
    settings = ExplorationSettings(warmup="stepping", gait_time=4.0, rounds=4)
    assert [settings.rounds_of(seconds) for seconds in (1.0, 26.0, 27.0, 40.0, 54.0, 1e4)] == [1, 1, 2, 3, 4, 4]
    assert replace(settings, warmup="swinging").rounds_of(1e4) == 1


def test_what_a_round_has_found_is_known_in_the_next_one(quadruped):
    """Each robot remembers its own gait again, and of the fittest few how they did when they were tried again."""
    gaits = gaits_of(quadruped, steps=40, rounds=2)
    returned = play(gaits, 13, begun(gaits))
    gaits.fitness.copy_(torch.arange(8.0))
    genes = gaits.best_stride.clone()
    returned = play(gaits, 6, returned)
    # With eight robots all eight gaits are finalists, each in one robot.
    measured = gaits.fitness.clone()
    assert measured.max() < 0.1 and gaits.finalist.tolist() == list(range(7, -1, -1))
    gaits.go_on()
    torch.testing.assert_close(gaits.fitness, measured.flip(0))
    assert gaits.best_stride.tolist() == genes.tolist() and not gaits.final
    # The next trials are of new gaits, and none of the cut ones counts.
    known = gaits.fitness.clone()
    play(gaits, 1, returned)
    assert gaits.fitness.tolist() == known.tolist()
    assert gaits.fittest_action(torch.zeros(1)).isfinite().all()


def test_a_warm_up_of_one_round_is_never_over_before_its_end(quadruped):
    gaits = gaits_of(quadruped, steps=20)
    returned = begun(gaits)
    for _ in range(30):
        returned = play(gaits, 1, returned)
        assert not gaits.round_over


def test_the_last_trials_count_alike(quadruped):
    """The fitness of each robot's finalist is the mean of its trials in the last round, and of no luckier one."""
    gaits = gaits_of(quadruped, duration=DT, steps=20)
    returned = begun(gaits)
    gaits.fitness.fill_(5.0)
    gaits.taken.fill_(14)
    earned = torch.zeros(ROBOTS)
    # The trial that the last round cuts short counts for nothing.
    gaits(torch.zeros(ROBOTS, dtype=torch.bool), returned)
    for trial in range(1, 6):
        earned = torch.rand(ROBOTS)
        returned = returned + earned
        gaits(torch.zeros(ROBOTS, dtype=torch.bool), returned)
        torch.testing.assert_close(gaits.fitness, returned / trial)
    assert float((gaits.fitness - earned).abs().max()) > 0.1


def test_a_gait_from_standing_is_tried_until_its_episode_ends(quadruped):
    """It asks for a new episode after its time, and has not fallen then; one that ends before has."""
    gaits = gaits_of(quadruped, duration=3 * DT, from_standing=True)
    nothing = torch.zeros(ROBOTS, dtype=torch.bool)
    begun(gaits)
    tried = gaits.stride.clone()
    gaits(nothing, torch.full((ROBOTS,), 0.1))
    assert gaits.anew is None
    gaits(nothing, torch.full((ROBOTS,), 0.2))
    assert gaits.anew.tolist() == ROBOTS * [True]
    # The collector may take another step first.
    gaits(nothing, torch.full((ROBOTS,), 0.3))
    assert gaits.stride.tolist() == tried.tolist() and not gaits.fitness.isfinite().any()
    ends = torch.arange(ROBOTS) < 3
    gaits(ends, torch.where(ends, 0.0, 0.4))
    # Three steps were rewarded before the fourth began, whose reward is not known.
    torch.testing.assert_close(gaits.fitness[:3], torch.full((3,), 0.3 / 4))
    assert gaits.anew.tolist() == (~ends).tolist()
    # The three have new gaits, of which one falls after two steps.
    gaits(nothing, torch.where(ends, 0.1, 0.5))
    falls = torch.arange(ROBOTS) == 0
    again = bool(gaits.again[0])
    gaits(falls, torch.where(falls, 0.0, 0.6))
    fallen = 0.1 / 3 - 1.0
    assert gaits.fitness[0] == pytest.approx(0.5 * (0.3 / 4 + fallen) if again else 0.3 / 4)


def test_only_the_robots_that_are_asked_for_begin_anew():
    """TorchRL's reset by a mask: the others' episodes go on, and neither learns from the other's end."""
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        settings = build(compose("config", ["robot=quadruped"]))
    task = settings.setup().task
    torch.manual_seed(0)
    env = EnvRecipe(task, replace(settings.env, num_envs=4, threads=1)).make(0)

    class Still(torch.nn.Module):
        in_keys, out_keys = ("nodes",), ("action",)

        def forward(self, tensordict):
            return tensordict.set("action", torch.zeros(4, env.action_spec.shape[-1]))

    collector = InlineCollector(env, Still(), 3)
    first = collector.collect()
    assert not first["next", "done"].any()
    chosen = torch.tensor([False, True, False, True])
    collector.begin_anew(first, chosen)
    for key in ("done", "truncated"):
        assert first["next", key][:, -1, 0].tolist() == chosen.tolist()
        assert not first["next", key][:, :-1].any()
    second = collector.collect()
    assert second["is_init"][:, 0, 0].tolist() == chosen.tolist()
    # What went on begins where it was, to the digit.
    assert second["nodes"][~chosen, 0].tolist() == first["next", "nodes"][~chosen, -1].tolist()
    assert second["episode_reward"][chosen, 0].tolist() == [[0.0], [0.0]]
    assert (second["episode_reward"][~chosen, 0] == first["next", "episode_reward"][~chosen, -1]).all()
    collector.close()


def test_a_warm_up_has_at_least_one_round():
    with pytest.raises(ConfigError, match="rounds must be at least 1, got 0"):
        ExplorationSettings(warmup="stepping", rounds=0)


@pytest.mark.parametrize("warmup", ["stepping", "swinging"])
def test_only_feet_that_step_have_several_rounds(quadruped, warmup):
    """A robot that brings rounds can be given another warm-up by one word: then that has one round."""
    settings = ExplorationSettings(warmup=warmup, learning_starts=160, rounds=2, reflexes=False, gait_time=DT)
    explorer = Explorer(Actor(quadruped.model.nu), quadruped, 4, settings)
    start = TensorDict({"is_init": torch.ones(4, 1, dtype=torch.bool), "episode_reward": torch.zeros(4, 1)}, [4])
    ends = []
    for step in range(1, 41):
        explorer(start.clone())
        start["is_init"].zero_()
        start["episode_reward"] += torch.rand(4, 1)
        if explorer.round_over:
            ends.append(step)
            explorer.rhythm.go_on()
    assert ends == ([20] if warmup == "stepping" else []) and not explorer.warming_up


def test_gaits_that_follow_a_command_are_corrected_anew_in_each_round(quadruped):
    """Keep what was measured of the last gaits with those who found them, but not the corrections."""
    torch.manual_seed(0)
    robots = 32
    gaits = CommandedStepping(quadruped, robots, Trials(5 * DT, DT, steps=200, rounds=2))
    gaits.SETTLED = 0.0
    command, nothing = torch.rand(robots, 3) - 0.5, torch.zeros(robots, dtype=torch.bool)
    returned = torch.zeros(robots)
    for step in range(100):
        if step % 10 == 0:
            command = torch.rand(robots, 3) - 0.5
        gaits(~nothing if step == 0 else nothing, returned, shown=Shown(command, velocity=0.5 * command))
        returned = returned + torch.rand(robots)
    assert gaits.round_over and gaits.correction.correction.any()
    known = gaits.finalists
    means = [float(gaits.results[gaits.finalist == one].mean()) for one in known]
    gaits.go_on()
    assert gaits.results[known].tolist() == pytest.approx(means)
    others = [robot for robot in range(robots) if robot not in known]
    assert torch.equal(gaits.results[others], gaits.before_results[others])
    gaits._begin_last_round()
    assert not gaits.correction.correction.any()


def test_other_processes_have_nobody_who_ends_rounds_and_episodes():
    """They have one round, as long as one of several."""
    settings = ExplorationSettings(warmup="stepping", learning_starts=100, rounds=4, from_standing=True)
    alone = settings.in_workers
    assert (alone.rounds, alone.from_standing, alone.learning_starts) == (1, False, 25)


def test_the_policy_acts_from_the_end_of_the_warm_up_on(quadruped):
    """The explorer's warm-up lasts until it is ended, and its end is part of its state."""

    settings = ExplorationSettings(learning_starts=4000, noise=None)
    explorer = Explorer(Actor(quadruped.model.nu), quadruped, 4, settings)
    seen = TensorDict({"nodes": torch.zeros(4, 1), "is_init": torch.ones(4, 1, dtype=torch.bool)}, [4])
    explorer(seen.clone())
    assert explorer.warming_up
    explorer.end_warmup()
    assert not explorer.warming_up
    assert explorer(seen.clone())["action"].unique().tolist() == [0.25]
    other = Explorer(Actor(quadruped.model.nu), quadruped, 4, settings)
    other.load_state_dict(explorer.state_dict())
    assert not other.warming_up
