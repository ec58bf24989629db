"""Tasks that gctd3 simulates, composed of terms.

Stage three of the data flow, shared by every backend. Everything takes arrays with any leading dimensions ``*`` (none
for one robot, ``[N]`` for a batch) and returns new ones; nothing here steps a simulator.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from gctd3.errors import ConfigError, check_kind
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.domain_randomisation import Domain, DomainRandomisation
from gctd3.tasks.feature_table import FeatureTable
from gctd3.tasks.features import NodeFeature
from gctd3.tasks.fitting import check_feature, fitting, fitting_rewards, named
from gctd3.tasks.gait_clock import GaitClock
from gctd3.tasks.ground import ORIGIN, Ground
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.memory import EpisodeMemory, Generator, Memory
from gctd3.tasks.observations import TaskObservations
from gctd3.tasks.outcome import Outcome
from gctd3.tasks.reward import Reward
from gctd3.tasks.sensor_noise import SensorNoise
from gctd3.tasks.state_reader import StateReader
from gctd3.tasks.task import Ability, TaskSettings
from gctd3.tasks.term_checks import called, check_mapping, check_terms, trying
from gctd3.tasks.terminations import MOST_STEPS, TimeLimit
from gctd3.tasks.terms import Command, Randomisation, RobotFacts, Step, Termination
from gctd3.tasks.terrain import Terrain
from gctd3.tasks.trial_step import try_terms


@dataclass(frozen=True)
class Composition(TaskSettings):
    """Hold the settings of a task composed of terms, mappings by name; ``None`` leaves a term out.

    A YAML of such a task names only the terms that it adds to the defaults, changes or leaves out.

    Attributes:
        control_dt: Control period (s).
        features: Features of the nodes, in their order within a node.
        terminations: Terminations that end an episode.
        randomisations: Randomisations of the start of an episode.
        commands: Commands to the robot.
        privileged: Features of the nodes that only critics observe, beside the clocks of the terminations.
        domain_randomisation: Differences between robots in a training; ``None`` for none.
        terrain: The ground; ``None`` for the plane of the robot's file.
    """

    BY_NAME: ClassVar[tuple[str, ...]] = ("features", "terminations", "randomisations", "commands", "privileged")

    control_dt: float = 0.02
    features: Mapping[str, Any] = field(default_factory=dict)
    terminations: Mapping[str, Any] = field(default_factory=dict)
    randomisations: Mapping[str, Any] = field(default_factory=dict)
    commands: Mapping[str, Any] = field(default_factory=dict)
    privileged: Mapping[str, Any] = field(default_factory=dict)
    domain_randomisation: DomainRandomisation | None = None
    terrain: Terrain | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.control_dt <= 1:
            raise ConfigError(f"control_dt must be above 0 s and at most 1 s, got {self.control_dt}.")
        for name, kind in (("terminations", Termination), ("randomisations", Randomisation), ("commands", Command)):
            check_terms(name, getattr(self, name), kind)
        for key in ("features", "privileged"):
            check_mapping(key, getattr(self, key))
            for name, feature in getattr(self, key).items():
                if feature is not None and not isinstance(feature, NodeFeature):
                    raise ConfigError(
                        f"{key}.{name} must be null or a mapping whose _target_ is a NodeFeature, got {feature!r}."
                    )

    def build(self, robot: RobotSettings, reward: Reward | None = None) -> SimulatedTask:
        """Build the task, its robot and its graph; under the paper's reward if ``reward`` is ``None``."""
        loaded = robot.load()
        return SimulatedTask(loaded, Reward() if reward is None else reward, self, robot.graph_of(loaded))


class SimulatedTask(TaskObservations):
    """Define the observations, the reward and the terminations of a simulated robot on any base.

    Args:
        robot: The robot.
        reward: The reward.
        settings: The other terms of the task.
        graph: The robot's graph; its tree if ``None``.

    Attributes:
        ground: The terrain; ``None`` for a plane.
        stage: The robot on the task's ground, which is simulated and drawn; on a plane the robot itself.

    Raises:
        RobotError: If the robot does not meet the requirements of :meth:`.Robot.check_walking`.
        ConfigError: If a term does not fit the robot or another term.
    """

    name = "walk"
    backends: tuple[str, ...] = ("batched", "dm_control")
    abilities: frozenset[Ability] = frozenset(("film", "export", "robustness", "mirror"))

    def __init__(
        self, robot: Robot, reward: Reward, settings: Composition, graph: KinematicGraph | None = None
    ) -> None:
        check_kind("reward", reward, Reward)
        check_kind("settings", settings, Composition)
        if not reward.terms:
            raise ConfigError("reward.terms must hold at least one term, got none.")
        self.robot: Robot = robot
        self.reward, self.settings = reward, settings
        self.control_dt, self.history = settings.control_dt, settings.history
        robot.check_walking()
        self.graph = graph if graph is not None else KinematicGraph.from_robot(robot)
        with trying():
            self._compose()

    def _compose(self) -> None:
        """Take the terms that fit the robot, and run each of them once."""
        robot, settings = self.robot, self.settings
        self.ground = None if settings.terrain is None else Ground(settings.terrain, robot)
        self.stage: Robot = robot if self.ground is None else self.ground.robot
        self.facts = RobotFacts.from_robot(robot, self.graph, self.control_dt, self.ground)
        features = {n: f for n, f in settings.features.items() if f is not None}
        self.table = FeatureTable(features, robot, self.graph)
        self.features = self.table.width
        privileged = {n: f for n, f in settings.privileged.items() if f is not None}
        self.privileged = FeatureTable(privileged, robot, self.graph, "task.privileged") if privileged else None
        sensed = {**named("task.features", features), **named("task.privileged", privileged)}
        for name, one in sensed.items():
            check_feature(name, one, self.facts)
        self.terminations = fitting("task.terminations", settings.terminations, self.facts)
        commands = fitting("task.commands", settings.commands, self.facts)
        self.commands = {n: called(f"task.commands.{n}", one.fitted, self.facts) for n, one in commands.items()}
        self.randomisations = fitting("task.randomisations", settings.randomisations, self.facts)
        self.terms = fitting_rewards(self.reward.terms, self.facts, settings.terminations, self.terminations)
        ends, terms = named("task.terminations", self.terminations), named("reward.terms", self.terms)
        asked, servos = settings.domain_randomisation, self.facts.servos.joints
        self.domain = None if asked is None else Domain(asked, robot, self.table, servos, self.control_dt)
        if self.domain is not None:
            # Each robot of a batch has a model of its own there.
            self.backends = ("batched",)
        noise = SensorNoise(self.table.own_deviations())
        self.memory = EpisodeMemory(
            {**terms, **ends, **sensed}, self.commands, self.facts, self.domain, noise if noise.any else None
        )
        clocks = [feature for feature in features.values() if isinstance(feature, GaitClock)]
        self.gait = clocks[0].pattern(robot) if clocks else None
        self._read = StateReader(robot, self.facts)
        limits = [term.steps for term in self.terminations.values() if isinstance(term, TimeLimit)]
        self.time_limit, self.endless = min(limits, default=MOST_STEPS), not limits
        self.num_counters = try_terms(self)

    def measure(
        self, qpos: np.ndarray, qvel: np.ndarray, sensordata: np.ndarray, spot: Mapping[str, np.ndarray] | None = None
    ) -> Measurement:
        """Return the measurement of a simulator's state.

        Args:
            qpos: Generalised positions, shape ``[*, nq]``.
            qvel: Generalised velocities, shape ``[*, nv]``.
            sensordata: Readings of the sensors, shape ``[*, ns]``.
            spot: Memory, which holds where on the terrain the episodes began; ``None`` for its first lane.
        """
        return self._read(qpos, qvel, sensordata, spot)

    # Episodes.

    def place(
        self, rng: Generator, shape: tuple[int, ...], last: Mapping[str, np.ndarray] | None = None
    ) -> dict[str, np.ndarray]:
        """Draw where on the terrain robots of a shape begin an episode; empty on a plane.

        Args:
            rng: Generator.
            shape: The robots' dimensions.
            last: Memory at the end of their last episodes; ``None`` for none.
        """
        return {} if self.ground is None else self.ground.draw(rng, shape, last)

    def first(self) -> dict[str, np.ndarray]:
        """Return where on the terrain one robot begins on its first lane; empty on a plane."""
        return {} if self.ground is None else self.ground.first(())

    def put(self, qpos: np.ndarray, spot: Mapping[str, np.ndarray]) -> np.ndarray:
        """Move one robot's initial pose ``[nq]`` to where :meth:`place` lets it begin."""
        return qpos if self.ground is None else self.ground.put(qpos, spot[ORIGIN])

    def start(self, rng: Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw the initial pose ``[nq]`` and velocities ``[nv]`` of one robot, at the world's origin."""
        qpos, qvel = self.robot.start_qpos.copy(), np.zeros(self.robot.model.nv)
        for name, randomise in self.randomisations.items():
            qpos, qvel = called(f"task.randomisations.{name}", randomise, rng, self.robot, qpos, qvel)
        return qpos, qvel

    def begin(
        self,
        now: Measurement,
        rng: Generator | None = None,
        last: Mapping[str, np.ndarray] | None = None,
        spot: Mapping[str, np.ndarray] | None = None,
    ) -> Memory:
        """Return the memory at the start of an episode.

        Args:
            now: The first measurement of the episode.
            rng: Generator of commands; a task without commands needs none.
            last: Memory at the end of the robots' last episode, of which lasting arrays are kept; ``None`` for none.
            spot: Where on the terrain they begin, of :meth:`place`; ``None`` for its first lane.
        """
        return self.memory.begin(now, rng, last, spot)

    def advance(
        self,
        before: Memory,
        now: Measurement,
        action: np.ndarray | None = None,
        diverged: np.ndarray | None = None,
        rng: Generator | None = None,
    ) -> tuple[Memory, Outcome]:
        """Return the memory after a control step, and its outcome.

        Args:
            before: The memory before the step.
            now: The measurement after the step.
            action: The action of the step in [-1, 1], shape ``[*, A]``; zeros if ``None``.
            diverged: Whether the simulation failed, shape ``[*]``, which counts as a fall; nowhere if ``None``.
            rng: Generator of commands; a task without commands needs none.
        """
        shape = now.position.shape
        failed = diverged if diverged is not None else np.zeros(shape, dtype=bool)
        taken = action if action is not None else np.zeros((*shape, self.facts.actions))
        after: Memory = {}
        ended: dict[str, np.ndarray] = {}
        # One step for all terms, so that quantities that several of them derive from it are derived once.
        step = Step(now, before, after, taken, failed, self.facts, ended)
        after.update(self.memory.advance(step, rng))
        ended.update({n: called(f"task.terminations.{n}", term, step) for n, term in self.terminations.items()})
        terms = {name: called(f"reward.terms.{name}", term, step) for name, term in self.terms.items()}
        return after, self._outcome(terms, ended, failed)

    def _outcome(self, terms: dict[str, Any], ended: dict[str, Any], diverged: np.ndarray) -> Outcome:
        never = np.zeros(diverged.shape, dtype=bool)

        def any_of(kind: str, value: bool) -> np.ndarray:
            holding = [ended[n] for n, term in self.terminations.items() if getattr(term, kind) is value]
            return np.logical_or.reduce(holding) if holding else never

        terminated = any_of("truncates", False)
        truncated = any_of("truncates", True) & ~terminated
        return Outcome(terms, terminated, truncated, any_of("succeeds", True) & ~terminated, diverged)

    # Variants of the task.

    def with_reward(self, reward: Reward) -> SimulatedTask:
        """Return the same task under another reward."""
        return type(self)(self.robot, reward, self.settings, self.graph)

    def evaluated(self, reward: Reward) -> SimulatedTask:
        """Return the same task as policies are evaluated on it.

        It is under a reward, with commands and terrain without a curriculum, on the robot of the file, and with exact
        sensors.
        """
        given = self.settings
        commands = {n: one if one is None else one.evaluated() for n, one in given.commands.items()}
        features = {n: one if one is None else one.evaluated() for n, one in given.features.items()}
        terrain = None if given.terrain is None else replace(given.terrain, curriculum=False)
        settings = replace(given, commands=commands, features=features, terrain=terrain, domain_randomisation=None)
        return type(self)(self.robot, reward, settings, self.graph)

    def with_commands(self, commands: Mapping[str, Command], steps: int | None = None) -> SimulatedTask:
        """Return the same task with other commands, and another time limit unless ``steps`` (control steps) is None."""
        settings = replace(self.settings, commands=commands)
        if steps is not None:
            ends = {n: e for n, e in self.settings.terminations.items() if not isinstance(e, TimeLimit)}
            settings = replace(settings, terminations={**ends, "time_limit": TimeLimit(steps)})
        return type(self)(self.robot, self.reward, settings, self.graph)

    def on(self, robot: Robot) -> SimulatedTask:
        """Return the same task on a changed robot that has the same graph."""
        return type(self)(robot, self.reward, self.settings, self.graph)

    def on_plane(self) -> SimulatedTask:
        """Return the same task on the plane of the robot's file."""
        settings = replace(self.settings, terrain=None)
        return type(self)(self.robot, self.reward, settings, self.graph) if self.settings.terrain is not None else self

    def without_end(self) -> SimulatedTask:
        """Return the same task with fatal terminations only, after which the robot could not continue."""
        kept = {n: term if term is not None and term.fatal else None for n, term in self.settings.terminations.items()}
        return type(self)(self.robot, self.reward, replace(self.settings, terminations=kept), self.graph)
