"""Simulated tasks for Gymnasium: ``import gctd3; gymnasium.make("gctd3/Biped-v0")``, and ``gymnasium.make_vec``.

``gctd3/Biped-v0`` is the walking task, ``gctd3/Velocity-v0`` the task of following a commanded velocity.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, get_args

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from gctd3.envs.asked import AnyRobot, ask_simulated
from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError, suggest
from gctd3.tasks.reward import Reward
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.task import TaskSettings
from gctd3.tasks.terminations import TimeLimit
from gctd3.tasks.velocity import VelocitySettings, VelocityTask
from gctd3.tasks.velocity_command import NAME, VELOCITY, velocities

OPTIONS = ("control_dt", "feet", "forward", "terminations", "overrides")  # besides an environment's own arguments

Shape = Literal["flat", "nodes"]
# The largest position and velocity that MuJoCo simulates: beyond it, it resets the robot, which ends the episode.
LARGEST = mujoco.mjMAXVAL


def node_box(*shape: int) -> gymnasium.spaces.Box:
    """Return the space of features of nodes, ``float32`` of this shape."""
    return gymnasium.spaces.Box(-LARGEST, LARGEST, shape, np.float32)


def _limit(steps: int) -> TimeLimit:
    try:
        return TimeLimit(steps)
    except ConfigError as error:
        raise ConfigError(f"max_episode_{error}") from error


class BipedVectorEnv(VectorEnv):
    """Step N robots at once, as a Gymnasium vector environment.

    A robot whose episode ended is reset by the next step, whose action it ignores (Gymnasium's ``NEXT_STEP``), or with
    ``autoreset_mode=DISABLED`` by ``reset(options={"reset_mask": mask})`` for a mask ``[num_envs]`` of robots.

    Args:
        num_envs: Number of robots simulated side by side.
        robot: What ``robot=`` of the command line takes, or a robot or a model in memory; see :func:`.ask`.
        history: Number of frames stacked into an observation; the task's by default.
        reward: The reward, or the name of an option of ``reward=``; the paper's by default.
        threads: Threads of the simulation; all cores if ``None``.
        task: The settings of the task, or the name of an option of ``task=``; the robot's own by default.
        max_episode_steps: Control steps after which an episode is truncated, besides the task's own time limit.
        observation: ``flat`` for the nodes' features side by side, ``nodes`` for a row for each node.
        autoreset_mode: ``NEXT_STEP`` or ``DISABLED``, of Gymnasium's :class:`~gymnasium.vector.AutoresetMode`.
        asked: Other arguments of :func:`.ask`: ``control_dt``, ``feet``, ``forward``, ``terminations``, ``overrides``.

    Attributes:
        graph: The robot's graph, with a node for each row of ``nodes``.

    Observation: ``float32 [num_envs, N * F * history]``, or ``[num_envs, N, F * history]``; of every node the oldest
    frame first. Action: ``[num_envs, A]`` in [-1, 1]. Info: ``success``, ``position`` (m) and the reward's terms, each
    ``[num_envs]``.

    Raises:
        ConfigError: If an argument has another value than these.
    """

    def __init__(
        self,
        num_envs: int = 1,
        robot: AnyRobot = "biped",
        history: int | None = None,
        reward: Reward | str | None = None,
        threads: int | None = None,
        task: TaskSettings | str | None = None,
        max_episode_steps: int | None = None,
        observation: Shape = "flat",
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        **asked: Any,  # noqa: ANN401 - of `ask`
    ) -> None:
        if observation not in get_args(Shape):
            raise ConfigError(f"observation must be one of {', '.join(get_args(Shape))}, got {observation!r}.")
        if autoreset_mode not in (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED):
            raise ConfigError(f"autoreset_mode must be NEXT_STEP or DISABLED, got {autoreset_mode}.")
        if max_episode_steps is not None:
            limit = {"max_episode_steps": _limit(max_episode_steps)}
            asked["terminations"] = {**(asked.get("terminations") or {}), **limit}
        if unknown := [name for name in asked if name not in OPTIONS]:
            raise ConfigError(f"Unknown argument {unknown[0]!r}.{suggest(unknown[0], OPTIONS)} {', '.join(OPTIONS)}.")
        one = self._build(robot, task=task, reward=reward, history=history, **asked)
        history = one.history
        self.simulation = Simulation(one, num_envs, threads=threads)
        self.num_envs, self.graph = num_envs, one.graph
        self.metadata = {"autoreset_mode": autoreset_mode, "render_modes": []}
        nodes = (one.graph.num_nodes, one.features * history)
        self.single_observation_space = node_box(*nodes) if observation == "nodes" else node_box(nodes[0] * nodes[1])
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (one.facts.actions,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._stack: np.ndarray = np.zeros((num_envs, *nodes), dtype=np.float32)
        self._ended = np.zeros(num_envs, dtype=bool)

    def _build(self, robot: AnyRobot, **asked: Any) -> SimulatedTask:  # noqa: ANN401 - of `ask`
        return ask_simulated(robot, **asked)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode on every robot, or on those of ``options["reset_mask"]``, a mask ``[num_envs]``.

        Raises:
            ConfigError: If the mask is not one.
        """
        if isinstance(seed, (list, tuple)):
            seed = seed[0]
        super().reset(seed=seed)
        self.simulation.rng = self.np_random
        begins = np.ones(self.num_envs, dtype=bool)
        if options is not None and "reset_mask" in options:
            begins = np.asarray(options["reset_mask"])
            if begins.shape != (self.num_envs,) or begins.dtype != bool:
                raise ConfigError(
                    f"reset_mask must be a mask of {self.num_envs} robots, got {begins.dtype} {list(begins.shape)}."
                )
        self._begin(begins)
        self._ended = self._ended & ~begins
        return self._observation(), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one control step of every robot, or start a new episode where the last one ended.

        Raises:
            ConfigError: If a robot's episode has ended and ``autoreset_mode`` is ``DISABLED``.
        """
        begins = self._ended
        if begins.any() and self.metadata["autoreset_mode"] is AutoresetMode.DISABLED:
            ended = ", ".join(map(str, np.flatnonzero(begins)))
            raise ConfigError(f"The episode of robot {ended} has ended: reset(options={{'reset_mask': mask}}) first.")
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
        return self._observation(), reward, terminated, truncated, info

    def _observation(self) -> np.ndarray:
        return self._stack.reshape(self.observation_space.shape).copy()

    def _frame(self) -> np.ndarray:
        return self.simulation.task.node_features(self.simulation.now, self.simulation.memory)

    def _begin(self, mask: np.ndarray) -> None:
        self.simulation.reset(mask)
        frame = self._frame()
        repeated = np.tile(frame, (1, 1, self._stack.shape[-1] // frame.shape[-1]))
        self._stack = np.where(mask[:, None, None], repeated, self._stack)


class VelocityVectorEnv(BipedVectorEnv):
    """Step N robots that follow commanded velocities, as a Gymnasium vector environment.

    Info holds ``command`` and ``moved`` too: the commanded velocity forward, to the left and turning, and the robot's,
    each ``[num_envs, 3]`` (m/s, m/s, rad/s).

    Args:
        num_envs: Number of robots simulated side by side.
        robot: As for :class:`BipedVectorEnv`.
        curriculum: Whether commands begin straight ahead and their box widens, if ``task.commands.velocity.begin`` says
            so; ``False`` for the task as it is evaluated.
        settings: Other arguments of :class:`BipedVectorEnv`, but for ``task``; the reward is by default that of
            ``task=velocity``, as the robot's own settings change it.

    Raises:
        ConfigError: If an argument is wrong.
        RobotError: If the robot cannot be used.
    """

    def __init__(
        self,
        num_envs: int = 1,
        robot: AnyRobot = "quadruped",
        curriculum: bool = True,
        **settings: Any,  # noqa: ANN401 - of `BipedVectorEnv`
    ) -> None:
        self._curriculum = curriculum
        super().__init__(num_envs, robot, **settings)

    def _build(self, robot: AnyRobot, **asked: Any) -> SimulatedTask:  # noqa: ANN401 - of `ask`
        if asked["task"] is None:
            asked["task"] = NAME if isinstance(robot, (str, Path)) else VelocitySettings()
        one = super()._build(robot, **asked)
        if not isinstance(one, VelocityTask):
            raise ConfigError(f"task must be one of commanded velocities, got {one.name!r}.")
        return one if self._curriculum else one.evaluated(one.reward)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one control step of every robot, or start a new episode where the last one ended; see the base class."""
        observation, reward, terminated, truncated, info = super().step(actions)
        simulation = self.simulation
        info["command"] = simulation.memory[VELOCITY].copy()
        info["moved"] = np.asarray(velocities(simulation.now, simulation.task.facts))
        return observation, reward, terminated, truncated, info


class BipedEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Provide one robot as a Gymnasium environment; see :class:`BipedVectorEnv` for observation, action and info.

    Args:
        robot: What ``robot=`` of the command line takes, or a robot or a model in memory; see :func:`.ask`.
        history: Number of frames stacked into an observation; the task's by default.
        reward: The reward, or the name of an option of ``reward=``; the paper's by default.
        task: The settings of the task, or the name of an option of ``task=``; the robot's own by default.
        observation: ``flat`` for the nodes' features side by side, ``nodes`` for a row for each node.
        asked: Other arguments of :func:`.ask`: ``control_dt``, ``feet``, ``forward``, ``terminations``, ``overrides``.

    Attributes:
        graph: The robot's graph, with a node for each row of ``nodes``.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's name and type

    def __init__(
        self,
        robot: AnyRobot = "biped",
        history: int | None = None,
        reward: Reward | str | None = None,
        task: TaskSettings | str | None = None,
        observation: Shape = "flat",
        **asked: Any,  # noqa: ANN401 - of `ask`
    ) -> None:
        self._wrap(BipedVectorEnv(1, robot, history, reward, 1, task, observation=observation, **asked))

    def _wrap(self, one: BipedVectorEnv) -> None:
        self._one, self.graph = one, one.graph
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
        robot: AnyRobot = "quadruped",
        curriculum: bool = True,
        **settings: Any,  # noqa: ANN401 - of `BipedVectorEnv`
    ) -> None:
        self._wrap(VelocityVectorEnv(1, robot, curriculum, threads=1, **settings))
