"""Every environment of gctd3's passes the checkers of Gymnasium and of Stable-Baselines3, without a warning."""

import inspect

import gymnasium
import numpy as np
import pytest
from gymnasium.utils import env_checker
from gymnasium.utils.passive_env_checker import check_action_space, check_observation_space
from gymnasium.vector import AutoresetMode

import gctd3

# Warnings are errors here, as in all tests.
IDS = [name for name in gymnasium.registry if name.startswith(f"{gctd3.__name__}/")]
# Those of Gymnasium's checks that take a vector environment; the others ask for a single `bool` or `float`.
VECTOR_CHECKS = (
    env_checker.check_seed_deprecation,
    env_checker.check_reset_return_info_deprecation,
    env_checker.check_reset_return_type,
    env_checker.check_reset_seed_determinism,
    env_checker.check_reset_options,
)
VECTORS = [
    pytest.param({}, id="batched"),
    pytest.param({"autoreset_mode": AutoresetMode.DISABLED}, id="batched_no_autoreset"),
    pytest.param({"vectorization_mode": "sync"}, id="sync"),
]


def test_there_are_environments():
    assert "gctd3/Biped-v0" in IDS


def test_the_checks_of_vector_environments_are_all_but_those_of_single_numbers():
    named = {name for name, _ in inspect.getmembers(env_checker, inspect.isfunction) if name.startswith("check_")}
    # The spaces are checked too; what is left reads one robot's `terminated`, and is the whole check itself.
    spaces = {"check_space_limit", "check_action_space", "check_observation_space", "check_returned_data_not_reused"}
    assert (
        named - {check.__name__ for check in VECTOR_CHECKS} - spaces
        == {
            "check_env",
            "check_obs",
            "check_step_determinism",
        }
        & named
    )


@pytest.mark.parametrize("name", IDS)
def test_gymnasium(name):
    env = gymnasium.make(name).unwrapped
    # Without a spec the checker leaves out what it makes anew, and of a nondeterministic one it asks less.
    assert env.spec is not None and not env.spec.nondeterministic
    env_checker.check_env(env)


@pytest.mark.parametrize("name", IDS)
def test_stable_baselines3(name):
    check = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gymnasium.make(name).unwrapped
    spaces = check._check_unsupported_spaces(env, env.observation_space, env.action_space)
    assert spaces is False, "the checker would leave out the returned values"
    check.check_env(env, warn=True, skip_render_check=False)


@pytest.mark.parametrize("how", VECTORS)
@pytest.mark.parametrize("name", IDS)
def test_vector_environments(name, how):
    env = gymnasium.make_vec(name, num_envs=3, **how)
    for space in (env.single_action_space, env.action_space):
        check_action_space(space)
        env_checker.check_space_limit(space, "action")
    for space in (env.single_observation_space, env.observation_space):
        check_observation_space(space)
        env_checker.check_space_limit(space, "observation")
    for check in VECTOR_CHECKS:
        # Gymnasium's own vector environments keep no generator besides those of their parts, which this one looks at.
        if check is not env_checker.check_reset_seed_determinism or "vectorization_mode" not in how:
            check(env)
    # Of several robots this check would ask whether an array is true.
    env_checker.check_returned_data_not_reused(gymnasium.make_vec(name, num_envs=1, **how))
    assert env.metadata["autoreset_mode"] in AutoresetMode
    env.close()


@pytest.mark.parametrize("how", VECTORS)
@pytest.mark.parametrize("name", IDS)
def test_steps_of_vector_environments(name, how):
    """What the checkers ask of a single environment's steps, asked of arrays: types, shapes, spaces, determinism."""
    env = gymnasium.make_vec(name, num_envs=3, **how)
    env.action_space.seed(1)
    actions = [env.action_space.sample() for _ in range(30)]
    runs = []
    for _ in range(2):
        observation, _ = env.reset(seed=7)
        run = [observation]
        for action in actions:
            observation, reward, terminated, truncated, info = env.step(action)
            assert observation in env.observation_space and observation.dtype == env.observation_space.dtype
            for values, dtype in ((reward, np.float64), (terminated, np.bool_), (truncated, np.bool_)):
                assert values.shape == (3,) and values.dtype == dtype
            assert np.isfinite(reward).all() and isinstance(info, dict)
            run += [observation, reward, terminated]
            if (terminated | truncated).any():
                break
        runs.append(run)
    assert env_checker.data_equivalence(*runs, exact=True)
    env.close()


@pytest.mark.parametrize("name", IDS)
def test_robots_of_unseeded_environments_start_differently(name):
    starts = [gymnasium.make(name).reset()[0] for _ in range(2)]
    assert not np.array_equal(*starts)
    starts = gymnasium.make_vec(name, num_envs=2, vectorization_mode="sync").reset()[0]
    assert not np.array_equal(*starts)


@pytest.mark.parametrize("name", IDS)
def test_stable_baselines3_steps_all_robots_at_once(name):
    """Its checker takes no ``VecEnv``; what it does with a single environment, done with all: look for NaN."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import VecCheckNan

    from gctd3.sb3 import BatchedVecEnv

    env = VecCheckNan(BatchedVecEnv(name, num_envs=3, threads=1))
    env.seed(0)
    env.reset()
    for _ in range(30):
        observation, *_ = env.step(np.stack([env.action_space.sample() for _ in range(3)]))
        for i in range(3):
            assert {key: values[i] for key, values in observation.items()} in env.observation_space
