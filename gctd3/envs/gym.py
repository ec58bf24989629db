"""Simulated tasks for Gymnasium: ``import gctd3; gymnasium.make("gctd3/Biped-v0")``, and ``gymnasium.make_vec``.

``gctd3/Biped-v0`` is the walking task, ``gctd3/Velocity-v0`` the task of following a commanded velocity.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from gctd3.envs.options import task_of
from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError, check_kind
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.reward import Reward
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.task import TaskSettings, check_backend
from gctd3.tasks.velocity_command import VELOCITY, velocities
from gctd3.tasks.walk import WalkSettings


def _spaces(task: SimulatedTask, history: int) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    shape = (task.graph.num_nodes, task.features * history)
    actions = task.facts.actions
    return (
        gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32),
        gymnasium.spaces.Box(-1.0, 1.0, (actions,), np.float32),
    )


class BipedVectorEnv(VectorEnv):
    """Step N robots at once, as a Gymnasium vector environment.

    A robot whose episode ended is reset by the next step, whose action it ignores (Gymnasium's ``NEXT_STEP``).

    Args:
        num_envs: Number of robots simulated side by side.
        robot: A shipped robot, or the path of an MJCF file.
        history: Number of frames stacked into an observation; the task's by default.
        reward: The reward; the paper's by default.
        threads: Threads of the simulation; all cores if ``None``.
        task: The other settings of the task; the paper's walk by default.

    Observation: ``float32 [num_envs, N, F * history]``, oldest frame first. Action: ``[num_envs, A]`` in [-1, 1].
    Info: ``success``, ``position`` (m) and the reward's terms, each ``[num_envs]``.
    """

    def __init__(
        self,
        num_envs: int = 1,
        robot: str = "biped",
        history: int | None = None,
        reward: Reward | None = None,
        threads: int | None = None,
        task: TaskSettings | None = None,
    ) -> None:
        settings = WalkSettings() if task is None else task
        check_kind("task", settings, TaskSettings)
        asked = settings.build(RobotSettings(robot), reward)
        check_backend(asked, "batched")
        self._start(cast(SimulatedTask, asked), num_envs, settings.history if history is None else history, threads)

    def _start(self, one: SimulatedTask, num_envs: int, history: int, threads: int | None) -> None:
        if history < 1:
            raise ConfigError(f"history must be at least 1, got {history}.")
        self.simulation = Simulation(one, num_envs, threads=threads)
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
        self.single_observation_space, self.single_action_space = _spaces(one, history)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        nodes = (one.graph.num_nodes, one.features * history)
        self._stack: np.ndarray = np.zeros((num_envs, *nodes), dtype=np.float32)
        self._ended = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode on every robot."""
        if isinstance(seed, (list, tuple)):
            seed = seed[0]
        if seed is not None:
            self.simulation.rng = np.random.default_rng(seed)
        everyone = np.ones(self.num_envs, dtype=bool)
        self._begin(everyone)
        self._ended = ~everyone
        return self._stack.copy(), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one control step of every robot, or start a new episode where the last one ended."""
        begins = self._ended
        outcome = self.simulation.step(np.asarray(actions, dtype=np.float64))
        frame = self._frame()
        self._stack = np.concatenate([self._stack[..., frame.shape[-1] :], frame], axis=-1)
        reward = np.where(begins, 0.0, outcome.reward)
        terminated, truncated = outcome.terminated & ~begins, outcome.truncated & ~begins
        if begins.any():
            self._begin(begins)
        self._ended = terminated | truncated
        info = {
            "success": outcome.success & ~begins,
            "position": self.simulation.now.position.copy(),
            **{f"reward_{name}": np.where(begins, 0.0, value) for name, value in outcome.terms.items()},
        }
        return self._stack.copy(), reward, terminated, truncated, info

    def _frame(self) -> np.ndarray:
        return self.simulation.task.node_features(self.simulation.now, self.simulation.memory)

    def _begin(self, mask: np.ndarray) -> None:
        self.simulation.reset(mask)
        frame = self._frame()
        repeated = np.tile(frame, (1, 1, self._stack.shape[-1] // frame.shape[-1]))
        self._stack = np.where(mask[:, None, None], repeated, self._stack)


class VelocityVectorEnv(BipedVectorEnv):
    """Step N robots that follow commanded velocities, as a Gymnasium vector environment; see :class:`BipedVectorEnv`.

    Args:
        num_envs: Number of robots simulated side by side.
        robot: An option of the commands, such as ``go2``, or the path of an MJCF or URDF file.
        history: Number of frames stacked into an observation; the task's by default.
        threads: Threads of the simulation; all cores if ``None``.
        curriculum: Whether commands begin straight ahead and their box widens; ``False`` for the whole box, as in
            evaluations.
        overrides: Further settings of a command line, such as ``task.commands.velocity.forward=[0,1]``.

    Info holds ``command`` and ``moved`` too: the commanded velocity forward, to the left and turning, and the robot's,
    each ``[num_envs, 3]`` (m/s, m/s, rad/s).

    Raises:
        ConfigError: If a setting is wrong.
        RobotError: If the robot cannot be used.
    """

    def __init__(
        self,
        num_envs: int = 1,
        robot: str = "quadruped",
        history: int | None = None,
        threads: int | None = None,
        curriculum: bool = True,
        overrides: Sequence[str] = (),
    ) -> None:
        asked = task_of("velocity", robot, overrides)
        check_backend(asked, "batched")
        one = cast(SimulatedTask, asked)
        one = one if curriculum else one.evaluated(one.reward)
        self._start(one, num_envs, one.history if history is None else history, threads)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one control step of every robot, or start a new episode where the last one ended."""
        observation, reward, terminated, truncated, info = super().step(actions)
        simulation = self.simulation
        info["command"] = simulation.memory[VELOCITY].copy()
        info["moved"] = np.asarray(velocities(simulation.now, simulation.task.facts))
        return observation, reward, terminated, truncated, info


class BipedEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Provide one robot as a Gymnasium environment; see :class:`BipedVectorEnv` for observation, action and info.

    Args:
        robot: A shipped robot, or the path of an MJCF file.
        history: Number of frames stacked into an observation; the task's by default.
        reward: The reward; the paper's by default.
        task: The other settings of the task; the paper's walk by default.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's name and type

    def __init__(
        self,
        robot: str = "biped",
        history: int | None = None,
        reward: Reward | None = None,
        task: TaskSettings | None = None,
    ) -> None:
        self._wrap(BipedVectorEnv(1, robot, history, reward, threads=1, task=task))

    def _wrap(self, one: BipedVectorEnv) -> None:
        self._one = one
        self.observation_space = self._one.single_observation_space
        self.action_space = self._one.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        observation, info = self._one.reset(seed=seed)
        return observation[0], info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take one control step, or start a new episode where the last one ended."""
        observation, reward, terminated, truncated, info = self._one.step(np.asarray(action)[None])
        scalars = {name: value[0].item() if value.ndim == 1 else value[0] for name, value in info.items()}
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), scalars


class VelocityEnv(BipedEnv):
    """Provide one robot that follows commanded velocities; see :class:`VelocityVectorEnv` for arguments and info."""

    def __init__(
        self,
        robot: str = "quadruped",
        history: int | None = None,
        curriculum: bool = True,
        overrides: Sequence[str] = (),
    ) -> None:
        self._wrap(VelocityVectorEnv(1, robot, history, 1, curriculum, overrides))
