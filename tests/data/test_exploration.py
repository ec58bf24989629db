"""Exploration: the length of the warm-up, the shape of its gaits, and the policy that acts after it."""

import itertools

import numpy as np
import pytest
import torch
from compositions import env_of
from robots import opposite_axes
from tensordict import TensorDict
from torchrl.collectors import Collector

from gctd3.data.exploration import Explorer
from gctd3.data.rhythm import Rhythm
from gctd3.data.settings import ExplorationSettings
from gctd3.errors import ConfigError
from gctd3.nn import make_actor, make_stochastic_actor

DT = 0.02


def explorer(robot, actor, robots=4, **settings):
    return Explorer(actor, robot, robots, ExplorationSettings(**settings), DT)


def step(explorer, nodes=None, is_init=False):
    robots = len(explorer.held)
    nodes = torch.zeros(robots, 8, 10) if nodes is None else nodes
    start = torch.as_tensor(is_init).expand(robots, 1).clone()
    with torch.no_grad():
        return explorer(TensorDict({"nodes": nodes, "is_init": start}, [robots]))["action"]


@pytest.fixture
def actor(graph):
    actor = make_actor(graph)
    for parameter in actor.parameters():  # so that the actor's actions differ from state to state
        torch.nn.init.normal_(parameter, std=0.2)
    return actor


@pytest.fixture
def still(monkeypatch):
    """Make rhythms without noise."""
    monkeypatch.setattr(Rhythm, "NOISE", 0.0)


# The warm-up.


@pytest.mark.parametrize("frames, steps", [(0, 0), (1, 1), (8, 2), (10, 3)])
@pytest.mark.parametrize("warmup", ["rhythmic", "uniform"])
def test_warm_up_is_counted_in_frames_of_all_robots(robot, actor, warmup, frames, steps):
    # Four robots collect four frames a step: 10 frames take three steps.
    explore, nodes = explorer(robot, actor, warmup=warmup, learning_starts=frames, noise=None), torch.randn(4, 8, 10)
    expected = actor(TensorDict({"nodes": nodes}, [4]))["action"]
    for t in range(5):
        assert explore.warming_up == (t < steps)
        action = step(explore, nodes, is_init=t == 0)
        assert torch.equal(action, expected) == (t >= steps)
    assert int(explore.frames) == 20


def test_uniform_actions_are_held(robot, actor):
    explore = explorer(robot, actor, robots=500, warmup="uniform", learning_starts=10**6, hold=3)
    actions = [step(explore) for _ in range(9)]
    for t, (before, after) in enumerate(itertools.pairwise(actions), start=1):
        assert torch.equal(before, after) == (t % 3 != 0)
    # Uniform in [-1, 1] has mean 0 and variance 1/3; 9000 of them.
    drawn = torch.stack(actions[::3])
    assert drawn.abs().max() <= 1.0
    assert abs(float(drawn.mean())) < 0.03 and float(drawn.var()) == pytest.approx(1 / 3, abs=0.02)
    assert not torch.equal(drawn[0, 0], drawn[0, 1])  # each robot has its own


def test_an_action_written_down_is_not_changed_by_the_next(robot, actor):
    for warmup in ("uniform", "rhythmic"):
        explore = explorer(robot, actor, warmup=warmup, learning_starts=10**6, hold=1)
        first = step(explore, is_init=True)
        kept = first.clone()
        step(explore)
        assert torch.equal(first, kept)


# Rhythms.


@pytest.fixture(scope="module", params=["biped", "opposite axes"])
def biped(request, robot, tmp_path_factory):
    return robot if request.param == "biped" else opposite_axes(robot, tmp_path_factory.mktemp("robot"))


def gaits(robot, robots, steps, low=1.2, high=2.4):
    rhythm = Rhythm(robot, robots, (low, high), DT)
    start = torch.ones(robots, dtype=torch.bool)
    return rhythm, torch.stack([rhythm(start if t == 0 else ~start) for t in range(steps)])


def test_rhythmic_actions_stay_in_range(robot):
    _, actions = gaits(robot, 300, 50)
    assert actions.abs().max() == 1.0  # some are clipped


def test_mirrored_joints_follow_half_a_period_later(biped, still):
    # 1 / (2.5 Hz * 0.02 s) = 20 steps a period.
    _, actions = gaits(biped, 50, 40, low=2.5, high=2.5)
    order, sign = biped.action_mirror
    mirrored = torch.from_numpy(sign).float() * actions[..., torch.from_numpy(order)]
    torch.testing.assert_close(actions[10:], mirrored[:-10], atol=1e-4, rtol=0.0)
    torch.testing.assert_close(actions[20:], actions[:-20], atol=1e-4, rtol=0.0)
    assert not torch.allclose(actions, mirrored, atol=0.1)


def test_rhythms_are_the_sines_that_they_say(robot, still):
    rhythm, actions = gaits(robot, 20, 3)
    assert ((rhythm.frequency >= 1.2) & (rhythm.frequency <= 2.4)).all()
    assert (rhythm.offset.abs() <= 0.5).all()
    assert ((rhythm.amplitude >= 0.1) & (rhythm.amplitude <= 1.0)).all()
    for t, action in enumerate(actions.numpy(), start=1):
        cycles = rhythm.frequency.numpy()[:, None] * DT * t + rhythm.phase.numpy()
        wave = rhythm.offset.numpy() + rhythm.amplitude.numpy() * np.sin(2 * np.pi * cycles)
        np.testing.assert_allclose(action, np.clip(wave, -1.0, 1.0), atol=1e-5)


def test_only_robots_whose_episode_begins_draw_a_new_gait(robot, actor, still):
    explore = explorer(robot, actor, learning_starts=10**6)
    step(explore, is_init=True)
    names = ("offset", "amplitude", "phase", "frequency", "cycles")
    before = {name: getattr(explore.rhythm, name).clone() for name in names}
    start = torch.tensor([False, True, False, True])
    step(explore, is_init=start[:, None])
    period = DT * explore.rhythm.frequency
    torch.testing.assert_close(explore.rhythm.cycles, torch.where(start, period, before["cycles"] + period))
    for name in names[:-1]:
        changed = (getattr(explore.rhythm, name) != before[name]).reshape(4, -1).all(dim=1)
        assert torch.equal(changed, start), name


def evolving(robot, robots=64):
    torch.manual_seed(0)
    rhythm = Rhythm(robot, robots, (1.2, 2.4), DT, mutation_share=1.0)
    everyone, nobody = torch.ones(robots, dtype=torch.bool), torch.zeros(robots, dtype=torch.bool)
    rhythm(everyone, torch.zeros(robots))
    return rhythm, everyone, nobody


def test_mutations_are_near_the_gaits_that_got_farthest(robot):
    rhythm, everyone, nobody = evolving(robot)
    far = torch.arange(64) >= 48
    parents = {name: getattr(rhythm, name)[far].clone() for name in rhythm.MUTATION}
    rhythm(nobody, torch.where(far, 3.0, 0.1))
    rhythm(everyone, torch.zeros(64))  # all begin anew; a start is not counted as distance
    distance = sum(
        ((getattr(rhythm, name)[:, None] - parents[name][None]) / size).square().reshape(64, 16, -1).mean(-1)
        for name, size in rhythm.MUTATION.items()
    )
    # Four rivals, a quarter of all robots far: 1 - (3/4)^4 = 0.68 of the mutations descend from those.
    assert float((distance.min(dim=1).values < 12.0).float().mean()) == pytest.approx(0.68, abs=0.15)
    assert (rhythm.amplitude >= 0.1).all() and (rhythm.amplitude <= 1.0).all()
    assert (rhythm.frequency >= 1.2).all() and (rhythm.frequency <= 2.4).all()


def test_mutations_alternate_too(robot, still):
    rhythm, everyone, nobody = evolving(robot)
    for _ in range(20):
        rhythm(nobody, torch.rand(64))
        rhythm(everyone, torch.zeros(64))
    other = torch.from_numpy(robot.action_mirror[0])
    torch.testing.assert_close((rhythm.phase - rhythm.phase[:, other]).abs(), torch.full((64, 6), 0.5))
    torch.testing.assert_close(rhythm.offset, rhythm.offset[:, other])
    torch.testing.assert_close(rhythm.amplitude, rhythm.amplitude[:, other])


def test_only_the_farthest_is_remembered(robot):
    rhythm, _, nobody = evolving(robot)
    rhythm(nobody, torch.full((64,), 2.0))
    best = rhythm.best_phase.clone()
    rhythm.draw(~nobody)
    rhythm(nobody, torch.full((64,), 1.0))
    assert torch.equal(rhythm.best_phase, best) and (rhythm.farthest == 2.0).all()


def test_without_mutations_nothing_else_is_drawn(robot):
    """With ``mutation_share=0`` no further numbers are drawn: the seeds of other trainings keep their meaning."""
    torch.manual_seed(0)
    plain = Rhythm(robot, 4, (1.2, 2.4), DT)
    plain(torch.ones(4, dtype=torch.bool))
    drawn = torch.rand(1)
    torch.manual_seed(0)
    torch.rand(4, 6), torch.rand(4, 6), torch.rand(4, 6), torch.rand(4), torch.randn(4, 6)
    assert torch.equal(torch.rand(1), drawn) and "farthest" not in plain.state_dict()


def test_noise_on_the_rhythm(robot, monkeypatch):
    monkeypatch.setattr(Rhythm, "AMPLITUDE", (0.0, 0.0))
    monkeypatch.setattr(Rhythm, "OFFSET", 0.0)
    _, actions = gaits(robot, 100, 50)
    assert float(actions.std()) == pytest.approx(Rhythm.NOISE, rel=0.05)


# After the warm-up.


def test_noise_is_spread_geometrically_over_the_robots(robot, actor):
    # 0.05 to 0.4 over four robots: each twice the one before.
    explore = explorer(robot, actor, learning_starts=0, noise=(0.05, 0.4))
    torch.testing.assert_close(explore.sigma.flatten(), torch.tensor([0.05, 0.1, 0.2, 0.4]))
    for parameter in actor.parameters():
        torch.nn.init.zeros_(parameter)  # acts with zeros, so that only noise is seen
    actions = torch.stack([step(explore) for _ in range(1000)])
    assert actions.abs().max() <= 1.0
    expected = torch.tensor([0.05, 0.1, 0.2, 0.4])  # of 6000; at 0.4 one in eighty is clipped to 1
    torch.testing.assert_close(actions.std(dim=(0, 2)), expected, rtol=0.04, atol=0.0)


@pytest.mark.nightly
def test_the_noise_of_every_second_robot_wanders(robot, actor):
    for parameter in actor.parameters():
        torch.nn.init.zeros_(parameter)
    explore = explorer(robot, actor, learning_starts=0, noise=(0.1, 0.1), noise_time=0.1)
    actions = torch.stack([step(explore) for _ in range(4000)])
    torch.testing.assert_close(actions.std(dim=(0, 2)), torch.full((4,), 0.1), rtol=0.05, atol=0.0)
    following = (actions[1:] * actions[:-1]).mean(dim=(0, 2)) / 0.01
    # exp(-0.02 s / 0.1 s) from one step to the next; the other robots' is white.
    torch.testing.assert_close(following, torch.tensor([0.0, 0.8187, 0.0, 0.8187]), rtol=0.0, atol=0.05)
    last, first = actions[-1], step(explore, is_init=True)
    assert abs(float((last * first)[1::2].mean()) / 0.01) < 1.5  # 12 products of independent noise
    assert torch.equal(explore.wander * 0.1, first)


def test_one_robot_gets_the_smallest_noise(robot, actor):
    torch.testing.assert_close(explorer(robot, actor, robots=1, noise=(0.1, 0.4)).sigma, torch.tensor([[0.1]]))


def test_noise_leaves_the_actors_action_in_range(robot, actor):
    for parameter in actor.parameters():
        torch.nn.init.constant_(parameter, 1.0)
    action = step(explorer(robot, actor, learning_starts=0), torch.ones(4, 8, 10))
    assert ((action > 0.0) & (action <= 1.0)).all()


def test_without_noise_the_action_is_the_actors(robot, actor):
    nodes = torch.randn(4, 8, 10)
    action = step(explorer(robot, actor, learning_starts=0, noise=None), nodes)
    assert torch.equal(action, actor(TensorDict({"nodes": nodes}, [4]))["action"])


def test_a_policy_that_is_random_by_itself_is_drawn_from(robot, graph):
    actor = make_stochastic_actor(graph)
    explore, nodes = explorer(robot, actor, robots=500, learning_starts=0, noise=None), torch.randn(8, 10)
    seen = actor(TensorDict({"nodes": nodes[None]}, [1]))
    action = step(explore, nodes.expand(500, 8, 10))
    # 500 draws before the tanh: of the distribution's mean and deviation, to some standard errors.
    drawn = action.atanh()
    error = seen["scale"][0] / 500**0.5
    assert ((drawn.mean(dim=0) - seen["loc"][0]).abs() < 4 * error).all()
    torch.testing.assert_close(drawn.std(dim=0), seen["scale"][0], rtol=0.15, atol=0.0)


def test_it_is_the_live_actor_that_acts(robot, task, actor):
    """The actor under training acts, also in a collector, which could have copied it."""
    explore = explorer(robot, actor, learning_starts=0, noise=None)
    env = env_of(task)
    collector = Collector(env, explore, frames_per_batch=4, total_frames=12)
    for collected in collector:
        expected = actor(TensorDict({"nodes": collected["nodes"]}, collected.batch_size))["action"]
        torch.testing.assert_close(collected["action"], expected)
        with torch.no_grad():
            for parameter in actor.parameters():
                parameter.add_(0.1 * torch.randn_like(parameter))
        assert not torch.allclose(actor(collected.clone())["action"], expected, atol=1e-3)
    collector.shutdown()


@pytest.mark.parametrize(
    "key, value",
    [
        ("learning_starts", -1),
        ("hold", 0),
        ("frequency", (0.0, 1.0)),
        ("frequency", (2.0, 1.0)),
        ("frequency", (1.0,)),
        ("noise_time", -0.1),
        ("mutation_share", -0.1),
        ("mutation_share", 1.1),
        ("noise", (0.0, 0.1)),
        ("noise", (0.2, 0.1)),
        ("noise", (0.1, 0.2, 0.3)),
    ],
)
def test_settings_out_of_range(key, value):
    shown = list(value) if isinstance(value, tuple) else value
    with pytest.raises(ConfigError) as caught:
        ExplorationSettings(**{key: value})
    assert str(caught.value).startswith(f"{key} must be") and str(shown) in str(caught.value)
