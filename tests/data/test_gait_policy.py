"""The fittest gait as a policy: by the clock, the command and the posture that are observed."""

from dataclasses import replace

import numpy as np
import torch
from tensordict import TensorDict

from gctd3.data.exploration import Explorer
from gctd3.data.gait_policy import ByClock, fittest_gait
from gctd3.data.settings import ExplorationSettings
from gctd3.data.trials import Shown
from gctd3.envs.simulation import Simulation
from gctd3.nn import make_actor
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.gait_clock import PHASES, GaitClock
from gctd3.tasks.velocity import VelocitySettings
from gctd3.tasks.velocity_command import VELOCITY
from gctd3.tasks.velocity_features import velocity_features

ROBOTS = 4


def test_it_acts_by_what_is_observed():
    """Whatever the time: the action at the phase, command and posture that the observations show, a step later."""
    settings = VelocitySettings(features={**velocity_features(), "clock": GaitClock(frequency=2.0)}, history=2)
    task = settings.build(RobotSettings("quadruped", action_scale=0.5))
    torch.manual_seed(0)
    exploration = ExplorationSettings(warmup="stepping", learning_starts=400, gait_time=0.04, mutation_share=0.8)
    explorer = Explorer.of_task(task, make_actor(task.graph), ROBOTS, exploration)
    gait = explorer.rhythm
    assert fittest_gait(gait, task) is None
    nothing, command = torch.zeros(ROBOTS, dtype=torch.bool), torch.tensor([[0.5, 0.1, -0.3]]).expand(ROBOTS, 3)
    for step in range(4):
        gait(nothing, 0.1 * step * torch.rand(ROBOTS), shown=Shown(command, torch.zeros(ROBOTS, 6)))
    policy = fittest_gait(gait, task)
    assert isinstance(policy, ByClock)

    simulation = Simulation(task, ROBOTS, threads=1)
    simulation.reset(np.ones(ROBOTS, dtype=bool))
    phases = (task.facts.foot_phases + 0.3) % 1.0
    memory = {**simulation.memory, VELOCITY: command.numpy().astype(float), PHASES: np.tile(phases, (ROBOTS, 1))}
    nodes = torch.from_numpy(task.node_features(simulation.now, memory))
    seen = TensorDict({"nodes": torch.cat([torch.zeros_like(nodes), nodes], dim=-1)}, [ROBOTS])
    posture, phase = task.posture(seen["nodes"]), torch.full((ROBOTS,), 0.3 + 0.02 * 2.0)
    expected = gait.act(gait._fittest(ROBOTS), phase, Shown(command, posture)).clamp(-1.0, 1.0)
    torch.testing.assert_close(policy(seen)["action"], expected, rtol=1e-4, atol=1e-4)
    # A body that tilts is answered.
    level = gait.act(gait._fittest(ROBOTS), phase, Shown(command, posture.nan_to_num() * 0.0)).clamp(-1.0, 1.0)
    tilted = gait.act(gait._fittest(ROBOTS), phase, Shown(command, 0.2 + posture.nan_to_num() * 0.0)).clamp(-1.0, 1.0)
    assert not torch.allclose(level, tilted, atol=1e-3)
    # Without a clock the phase is not known.
    assert fittest_gait(gait, replace(settings, features=velocity_features()).build(RobotSettings("quadruped"))) is None
