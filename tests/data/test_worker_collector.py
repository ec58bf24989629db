"""Collecting while learning: the batches that workers deliver, and how the collector handles their failures."""

import dataclasses
import threading
from typing import ClassVar

import pytest
import torch
from running import TINY
from tensordict import TensorDict
from workers import ROBOTS, STEPS, tiny_settings

from gctd3.data.exploration import Explorer
from gctd3.data.inline_collector import InlineCollector
from gctd3.data.replay import Replay
from gctd3.data.settings import ProcessSettings
from gctd3.data.worker import Worker
from gctd3.data.worker_collector import WorkerCollector, cut
from gctd3.envs.factory import EnvRecipe
from gctd3.errors import ConfigError, WorkerError


class Near(Worker):
    """Step the robots in the calling thread; fail or hang at the batches that the test chooses."""

    made: ClassVar = []  # jobs, in the order of their beginnings
    faults: ClassVar = {}  # fault by number of the worker and batch

    def __init__(self, job):
        Near.made.append(job)
        self.number, self.batches, self.killed = len(Near.made) - 1, 0, threading.Event()
        self.job, self.weights = job, []
        self.collector = InlineCollector(job.make_env(), job.policy, job.steps)

    def next(self, weights):
        self.batches += 1
        Near.faults.get((self.number, self.batches), lambda worker: None)(self)
        TensorDict.from_module(self.job.policy).data.update_(weights)
        return self.collector.collect()

    def kill(self):
        self.killed.set()

    close = kill


def breaks(worker):
    raise RuntimeError("\nThe worker's node is gone.\nDetails follow.")


def hangs(worker):
    assert worker.killed.wait(30), "nobody noticed"
    raise RuntimeError("killed")


@pytest.fixture
def collector(robot, monkeypatch):
    """Return a function that makes a collector with workers in this process, started one after another."""
    monkeypatch.setattr(Near, "made", [])
    monkeypatch.setattr(Near, "faults", {})
    starting = threading.Lock()

    def launch(job):
        with starting:
            return Near(job)

    def make(*overrides):
        settings = tiny_settings(*overrides)
        setup = settings.setup()
        actor = settings.algo.build(setup.architecture()).actor
        explorer = Explorer(actor, robot, settings.env.num_envs, settings.exploration)
        recipe = EnvRecipe(setup.task, settings.env)
        collect = WorkerCollector(settings.collector, recipe, settings.batch_steps, settings.seed, explorer, launch)
        collect.settings = settings
        return collect

    return make


def assert_continuous(batches):
    """Assert that each next observation is the following step's observation, unless the episode ended."""
    whole = torch.cat(batches, dim=1)
    going = ~whole["next", "done"][:, :-1, 0]
    assert going.any()
    assert torch.equal(whole["next", "nodes"][:, :-1][going], whole["nodes"][:, 1:][going])
    assert torch.equal(whole["step_count"][:, 1:, 0][~going], torch.zeros_like(whole["step_count"][:, 1:, 0][~going]))


# Delivered batches.


def test_all_robots_are_there_and_go_on_from_batch_to_batch(collector):
    collect = collector()
    batches = [collect.collect() for _ in range(8)]
    assert all(batch.batch_size == (ROBOTS, STEPS) for batch in batches)
    assert_continuous(batches)
    assert batches[0]["is_init"][:, 0].all() and collect.replaced == 0
    # The learner's explorer counts delivered frames: the warm-up's length does not depend on the collector.
    assert int(collect.explorer.frames) == 8 * ROBOTS * STEPS
    settings = collect.settings
    assert (
        settings.batch_updates / settings.batch_steps
        == settings.gradient_steps / settings.rollout_steps
        == TINY["gradient_steps"]
    )


@pytest.mark.parametrize(("workers", "robots"), [(1, 1), (2, 5), (3, 64), (7, 7)])
def test_shares_are_even_and_leave_nobody_out(workers, robots):
    shares = ProcessSettings(workers).shares(robots)
    assert [i for share in shares for i in range(robots)[share]] == list(range(robots))
    sizes = [share.stop - share.start for share in shares]
    assert max(sizes) - min(sizes) <= 1 and min(sizes) >= 1


def test_noise_is_spread_over_the_robots_of_all_workers(collector):
    collect = collector("exploration.noise_time=0.1")
    collect.collect()
    (first,), (second,) = (job.policy._explorer for job in sorted(Near.made, key=lambda job: job.share.start))
    for name in ("sigma", "memory"):
        parts = torch.cat([getattr(first, name), getattr(second, name)])
        assert torch.equal(parts, getattr(collect.explorer, name))
    # 0.05 to 0.5 geometrically.
    torch.testing.assert_close(collect.explorer.sigma[:, 0].log10().diff(), torch.full((ROBOTS - 1,), 1 / (ROBOTS - 1)))
    assert first.settings.learning_starts == TINY["exploration.learning_starts"] and first.num_robots == ROBOTS


@pytest.mark.nightly
def test_every_worker_has_a_seed_of_its_own_and_so_has_who_replaces_it(collector):
    Near.faults = {(0, 2): breaks, (1, 3): breaks}
    collect = collector()
    for _ in range(4):
        collect.collect()
    assert len(Near.made) == 4
    assert len({job.seed for job in Near.made}) == 4
    starts = collector("seed=1")
    starts.collect()
    assert len({job.seed for job in Near.made}) == 6


def test_batches_are_collected_with_the_weights_of_their_moment(collector):
    """Without warm-up and noise, actions are the actor's with the weights that the worker was sent."""
    collect = collector("exploration.learning_starts=0", "exploration.noise=null")
    actor, given = collect.explorer.actor, []

    def acted_with(weights, batch):
        with weights.to_module(actor), torch.no_grad():
            return torch.allclose(batch["action"], actor(batch.select("nodes"))["action"], atol=1e-6)

    for call in range(5):
        for parameter in actor.parameters():
            parameter.data.normal_(std=0.1 * (call + 1))
        given.append(TensorDict.from_module(actor).data.clone())
        batch = collect.collect()
        # One batch is held and one under way, so a batch was requested two calls ago; the first call requests all.
        assert acted_with(given[max(0, call - 2)], batch)
        assert call == 0 or not acted_with(given[call], batch)


# Faults.


@pytest.mark.nightly
@pytest.mark.parametrize("fault", [breaks, hangs])
def test_a_worker_that_fails_is_replaced_and_nothing_else_changes(collector, capsys, fault):
    Near.faults = {(0, 3): fault}
    # The first worker to begin is not always number 0.
    collect = collector("collector.timeout=1")
    batches = [collect.collect() for _ in range(6)]
    failed, other = Near.made[0].share, next(job.share for job in Near.made if job.share != Near.made[0].share)
    assert collect.replaced == 1 and len(Near.made) == 3 and Near.made[2].share == failed
    assert all(batch.batch_size == (ROBOTS, STEPS) for batch in batches)
    assert_continuous(batches)
    # Its second batch was held when the third failed: its episodes end there, cut short, and others begin.
    robots = list(range(ROBOTS)[failed])
    ends = batches[1][robots]["next"]
    assert ends["done"][:, -1].all() and (ends["truncated"] ^ ends["terminated"])[:, -1].all()
    assert batches[2][robots]["is_init"][:, 0].all()
    assert not batches[2][list(range(ROBOTS)[other])]["is_init"][:, 0].all()
    error = capsys.readouterr().err
    assert f"another takes its place, and its {len(robots)} robots start anew" in error
    assert ("The worker's node is gone." if fault is breaks else "has delivered nothing for 1 s") in error


def test_a_worker_that_never_lasts_is_given_up(collector, capsys):
    Near.faults = {(number, 1): breaks for number in range(20)}
    collect = collector("collector.max_restarts=2")
    with pytest.raises(WorkerError, match=r"The worker's node is gone.*has failed 3 times in a row"):
        collect.collect()
    assert capsys.readouterr().err.count("another takes its place") == 2
    # The held batches can still be saved, and the collector continues once the cause is gone.
    Near.faults = {}
    assert collect.collect().batch_size == (ROBOTS, STEPS)


def test_failures_between_deliveries_do_not_add_up(collector):
    Near.faults = {(0, 2): breaks, (2, 2): breaks, (3, 2): breaks}
    collect = collector("collector.max_restarts=1")
    for _ in range(8):
        collect.collect()
    assert collect.replaced == 3


def test_what_was_cut_short_bootstraps_and_what_fell_does_not():
    flags = torch.tensor([[False, False], [False, True]])[..., None]
    batch = TensorDict({"next": {"done": flags, "terminated": flags.clone(), "truncated": flags & False}}, [2, 2])
    after = cut(batch)["next"]
    assert after["done"][..., 0].tolist() == [[False, True], [False, True]]
    assert after["terminated"][..., 0].tolist() == [[False, False], [False, True]]
    assert after["truncated"][..., 0].tolist() == [[False, True], [False, False]]
    assert not batch["next", "truncated"].any(), "what the replay holds already must not change"


def test_replay_never_joins_the_frames_of_two_episodes(collector):
    """After a fault, every drawn stack and next frame belongs to one episode of one robot."""
    Near.faults = {(0, 3): breaks, (2, 4): breaks}
    collect = collector("replay.n_step=3", "replay.mirror=false", "replay.batch_size=500")
    replay = Replay(collect.settings.replay, gamma=0.99)
    seen = []
    for _ in range(9):
        seen.append(collect.collect())
        replay.extend(seen[-1])
    assert collect.replaced == 2
    whole = torch.cat(seen, dim=1)
    stacks = {tuple(stack.flatten().tolist()) for stack in whole["nodes"].flatten(0, 1)}
    following = {tuple(stack.flatten().tolist()) for stack in whole["next", "nodes"].flatten(0, 1)}
    drawn = replay.sample()
    assert {tuple(stack.flatten().tolist()) for stack in drawn["nodes"]} <= stacks
    assert {tuple(stack.flatten().tolist()) for stack in drawn["next", "nodes"]} <= following


# Resuming.


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_what_was_not_delivered_is_kept_and_its_episodes_end(collector, workers):
    collect = collector()
    before = [collect.collect() for _ in range(3)]
    state = collect.state_dict()
    again = collector(f"collector.workers={workers}")
    again.explorer.load_state_dict(collect.explorer.state_dict())
    again.load_state_dict(state)
    after = [again.collect() for _ in range(3)]
    assert_continuous([*before, *after])
    assert after[0]["next", "done"][:, -1].all() and after[1]["is_init"][:, 0].all()
    assert torch.equal(after[0]["nodes"], collect.collect()["nodes"])


def test_a_run_that_has_delivered_nothing_goes_on_from_its_beginning(collector):
    collect = collector()
    assert collect.state_dict() == {"held": None}
    collect.load_state_dict({"held": None})
    assert collect.collect()["is_init"][:, 0].all()


def test_another_explorer_is_followed_by_other_workers_from_their_beginnings(collector, robot):
    collect = collector()
    before = [collect.collect() for _ in range(3)]
    settings = collect.settings
    other = Explorer(collect.explorer.actor, robot, ROBOTS, settings.exploration)
    collect.follow(other)
    after = [collect.collect() for _ in range(2)]
    assert after[0]["is_init"][:, 0].all() and not torch.equal(after[0]["nodes"], before[0]["nodes"])
    assert_continuous(after)
    assert int(other.frames) == 2 * ROBOTS * STEPS and len(Near.made) == 4
    assert len({job.seed for job in Near.made}) == 4


# Settings.


def test_more_workers_than_robots_are_refused():
    settings = tiny_settings("collector.workers=6")
    with pytest.raises(ConfigError, match=r"collector.workers must be at most env.num_envs = 5, got 6"):
        settings.check_here()
    assert dataclasses.replace(settings.collector, workers=5).check_here(ROBOTS) is None


@pytest.mark.parametrize("key", ["workers", "cpus", "chunk", "timeout", "start_within"])
def test_settings_out_of_range(key):
    with pytest.raises(ConfigError, match=rf"collector.{key} must be .* got 0"):
        tiny_settings(f"collector.{key}=0")
