"""Terrain under every backend: batched, dm_control and Gymnasium step the same robots on the same ground."""

from dataclasses import replace

import gymnasium
import mujoco
import numpy as np
import pytest
import torch
from suite_robots import why_not
from torchrl.envs.utils import check_env_specs

from gctd3.envs.factory import build_env
from gctd3.envs.gym import BipedVectorEnv
from gctd3.envs.settings import EnvSettings
from gctd3.envs.simulation import Simulation
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.domain_randomisation import DomainRandomisation
from gctd3.tasks.ground import LANE, ORIGIN
from gctd3.tasks.height_scan import HeightScan
from gctd3.tasks.terrain import Terrain
from gctd3.tasks.terrain_edge import TerrainEdge
from gctd3.tasks.terrain_kinds import Boxes, RoughGround, Stairs
from gctd3.tasks.walk import WalkSettings, paper_terminations

KINDS = {"rough": RoughGround(), "stairs": Stairs(), "boxes": Boxes()}
TERRAIN = Terrain(kinds=KINDS, levels=2, length=6.0, behind=1.0, width=2.0, flat=0.3, climb=3.0)


def settings_of(**changes):
    base = WalkSettings()
    features = {**base.features, "scan": HeightScan(noise=0.0)}
    ends = {**paper_terminations(), "edge": TerrainEdge()}
    return replace(base, features=features, terminations=ends, terrain=TERRAIN, **changes)


@pytest.fixture(scope="module", params=["biped", "quadruped"])
def task(request):
    return settings_of().build(RobotSettings(request.param))


@pytest.mark.dm_control
def test_both_backends_are_equal_to_the_bit(task):
    """From one state with one sequence of actions, over falls and new starts: observations, rewards and ends."""
    if why_not():
        pytest.skip(why_not())
    from gctd3.envs import dmc

    env, simulation = dmc.load(task, random=0), Simulation(task, 1, threads=1)
    rng, lanes = np.random.default_rng(0), set()
    step = env.reset()
    for _ in range(120):
        if step.first():
            mujoco.mj_getState(
                task.stage.model,
                env.physics.data.ptr,
                simulation.state[0],
                mujoco.mjtState.mjSTATE_FULLPHYSICS.value,
            )
            simulation.memory = {name: np.asarray(value)[None] for name, value in env.task._memory.items()}
            simulation.now = task.measure(
                simulation.qpos, simulation.qvel, env.physics.data.sensordata[None], simulation.memory
            )
            lanes.add(int(simulation.memory[LANE][0]))
        nodes = task.node_features(simulation.now, simulation.memory)[0]
        np.testing.assert_array_equal(nodes, step.observation["nodes"])
        np.testing.assert_array_equal(simulation.now.position.astype(np.float32), step.observation["position"])
        if step.last():
            step = env.reset()
            continue
        action = rng.uniform(-1.0, 1.0, task.facts.actions)
        outcome, step = simulation.step(action[None]), env.step(action)
        assert float(outcome.reward[0]) == step.reward
        assert bool((outcome.terminated | outcome.truncated)[0]) == step.last()
    assert len(lanes) > 1


def test_torchrl_takes_it(task):
    check_env_specs(build_env(task, EnvSettings(num_envs=3, threads=1), 0))


def test_equal_seeds_begin_at_equal_places_whatever_the_number_of_threads(task):
    states = []
    for threads in (1, 2):
        simulation = Simulation(task, 6, seed=4, threads=threads)
        simulation.reset(np.ones(6, dtype=bool))
        simulation.step(np.full((6, task.facts.actions), 0.1))
        states.append((simulation.state, simulation.memory[ORIGIN]))
    for one, other in zip(*states, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_checkpoint_holds_where_robots_are(task):
    """Restored into a new simulation, the next steps and the next starts are the same ones."""
    first, second = (Simulation(task, 4, seed=seed, threads=1) for seed in (1, 2))
    first.reset(np.ones(4, dtype=bool))
    first.step(np.zeros((4, task.facts.actions)))
    second.load_state_dict(first.state_dict())
    for _ in range(3):
        for one in (first, second):
            one.step(np.full((4, task.facts.actions), 0.3))
            one.reset(np.array([True, False, False, True]))
        np.testing.assert_array_equal(first.state, second.state)
        np.testing.assert_array_equal(
            task.node_features(first.now, first.memory), task.node_features(second.now, second.memory)
        )


def test_robots_that_differ_walk_on_terrain_too():
    """Each model of the domain randomisation has the terrain, with friction of its own."""
    domain = DomainRandomisation(frictions=(0.5, 0.9), masses=(0.8, 1.2), models=3)
    task = settings_of(domain_randomisation=domain).build(RobotSettings("quadruped"))
    simulation = Simulation(task, 6, threads=1)
    simulation.reset(np.ones(6, dtype=bool))
    plain = task.stage.model
    lanes = np.flatnonzero((plain.geom_bodyid == 0) & (plain.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD))
    factors = [model.geom_friction[lanes, 0] / plain.geom_friction[lanes, 0] for model in simulation._variants]
    assert len(lanes) == 2 and all(np.ptp(f) == 0 and 0.5 <= f[0] <= 0.9 for f in factors)
    assert np.isfinite(simulation.step(np.zeros((6, task.facts.actions))).reward).all()


def test_gymnasium_takes_it_by_the_command_lines_words():
    envs = BipedVectorEnv(
        3, "quadruped", overrides=["terrain=stairs", "sight=policy", "task.terrain.levels=1"], threads=1
    )
    observation, _ = envs.reset(seed=0)
    assert envs.simulation.task.ground.names == ("stairs",)
    assert envs.observation_space.contains(observation)
    again, _ = envs.reset(seed=0)
    np.testing.assert_array_equal(observation, again)
    observation, reward, *_ = envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
    assert np.isfinite(observation).all() and np.isfinite(reward).all()
    one = gymnasium.make("gctd3/Biped-v0", robot="biped", task=settings_of(), disable_env_checker=True)
    assert torch.tensor(one.reset(seed=1)[0]).isfinite().all()
