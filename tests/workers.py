"""Make settings of a few workers, and check the duties of every kind of worker."""

import copy

import torch
from hydra import compose, initialize_config_module
from running import TINY
from tensordict import TensorDict
from torch import nn

from gctd3.config.build import build
from gctd3.data.exploration import Explorer
from gctd3.data.worker import Job, Policy
from gctd3.envs.factory import EnvRecipe

ROBOTS, STEPS = 5, 4


def tiny_settings(*overrides):
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        few = {**TINY, "env.num_envs": ROBOTS, "collector.chunk": STEPS, "collector.workers": 2}
        return build(compose("config", ["collector=process", *[f"{k}={v}" for k, v in few.items()], *overrides]))


def check_that_it_acts_with_the_weights_that_it_is_sent(start, robot):
    """Check that a worker, made by ``start`` from a job, acts with the weights it is sent; return its last weights."""
    settings = tiny_settings("exploration.learning_starts=0", "exploration.noise=null")
    actor = settings.algo.build(settings.setup().architecture()).actor
    share = slice(2, 5)
    explorer = Explorer(copy.deepcopy(actor).requires_grad_(False), robot, 5, settings.exploration, part=share)
    recipe = EnvRecipe(settings.setup().task, settings.env)
    worker, seen = start(Job(share, 7, 1, settings.batch_steps, recipe, Policy(explorer))), []
    for scale in (0.1, 1.0):
        for parameter in actor.parameters():
            parameter.data.normal_(std=scale)
        weights = TensorDict.from_module(nn.ModuleDict({"actor": actor})).data.clone()
        batch = worker.next(weights)
        assert batch.batch_size == (3, settings.batch_steps)
        with torch.no_grad():
            torch.testing.assert_close(batch["action"], actor(batch.select("nodes"))["action"])
        seen.append(batch)
    # The second goes on where the first ended, and has not overwritten it.
    going = ~seen[0]["next", "done"][:, -1, 0]
    assert going.any()
    assert torch.equal(seen[0]["next", "nodes"][going, -1], seen[1]["nodes"][going, 0])
    return worker, weights
