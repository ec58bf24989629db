"""Tasks that gctd3 simulates, composed of terms.

Stage three of the data flow, shared by every backend. Everything takes arrays with any leading dimensions ``*`` (none
for one robot, ``[N]`` for a batch) and returns new ones; nothing here steps a simulator.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from array_api_compat import array_namespace

from gctd3.errors import ConfigError, RobotError, check_kind, suggest
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.mirror_check import check_mirror
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.domain_randomisation import NOISE, Domain, DomainRandomisation
from gctd3.tasks.feature_table import FeatureTable
from gctd3.tasks.features import NodeFeature, Sensed
from gctd3.tasks.gait_clock import GaitClock
from gctd3.tasks.ground import ORIGIN, Ground
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.memory import EpisodeMemory, Generator, Memory
from gctd3.tasks.outcome import Outcome
from gctd3.tasks.posture import Posture
from gctd3.tasks.reflection import Reflection
from gctd3.tasks.reward import Reward
from gctd3.tasks.sensor_noise import OWN_NOISE, SensorNoise
from gctd3.tasks.task import Ability, TaskSettings
from gctd3.tasks.term_checks import called, check_mapping, check_terms, reading, trying
from gctd3.tasks.terminations import MOST_STEPS, STEPS, TimeLimit
from gctd3.tasks.terms import Array, Command, Randomisation, RobotFacts, Step, Termination
from gctd3.tasks.terrain import Terrain


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


class SimulatedTask:
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
        self,
        robot: Robot,
        reward: Reward,
        settings: Composition,
        graph: KinematicGraph | None = None,
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

    # Composition.

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
        key = "task.privileged"
        self.privileged = FeatureTable(privileged, robot, self.graph, key) if privileged else None
        for name, one in {**_named("task.features", features), **_named(key, privileged)}.items():
            self._check_feature(name, one)
        self.terminations = self._fitting("task.terminations", settings.terminations)
        commands = self._fitting("task.commands", settings.commands)
        self.commands = {n: called(f"task.commands.{n}", one.fitted, self.facts) for n, one in commands.items()}
        self.randomisations = self._fitting("task.randomisations", settings.randomisations)
        self.terms = self._reward_terms()
        ends = {f"task.terminations.{name}": term for name, term in self.terminations.items()}
        terms = {f"reward.terms.{name}": term for name, term in self.terms.items()}
        sensed = {**_named("task.features", features), **_named(key, privileged)}
        asked = settings.domain_randomisation
        servos = self.facts.servos.joints
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
        self._base = robot.base
        standing = self._base.read(robot.standing_qpos, np.zeros(robot.model.nv))
        self._standing = {name: value for name, (value, _) in standing.items()}
        self._feet = robot.contact_sensors(robot.feet)
        self._foot_velocities = robot.foot_velocity_sensors
        self._shanks = robot.contact_sensors(robot.shanks)
        self._others = robot.contact_sensors(robot.other_contact_bodies)
        self._qpos = np.array([joint.qpos for joint in robot.joints])
        self._qvel = np.array([joint.qvel for joint in robot.joints])
        limits = [term.steps for term in self.terminations.values() if isinstance(term, TimeLimit)]
        self.time_limit, self.endless = min(limits, default=MOST_STEPS), not limits
        self.num_counters = 0
        self._try()

    def _check_feature(self, where: str, feature: NodeFeature) -> None:
        try:
            called(where, feature.check, self.facts)
        except ConfigError as error:
            raise ConfigError(f"{where}.{error}") from error

    def _fitting(self, where: str, terms: Mapping[str, Any]) -> dict[str, Any]:
        given = {name: term for name, term in terms.items() if term is not None}
        return {n: term for n, term in given.items() if called(f"{where}.{n}", term.applies, self.facts)}

    def _reward_terms(self) -> dict[str, Any]:
        """Return the reward terms that apply, without those that read a termination which this task leaves out."""
        fitting, known = self._fitting("reward.terms", self.reward.terms), self.settings.terminations
        for name, term in fitting.items():
            for end in term.reads():
                if end not in known:
                    raise ConfigError(
                        f"reward.terms.{name} reads the termination {end!r}, which the task does not have."
                        f"{suggest(end, known)} Its terminations: {', '.join(known)}."
                    )
        return {n: term for n, term in fitting.items() if all(end in self.terminations for end in term.reads())}

    def _try(self) -> None:
        """Run every term once, on the standing robot, so that one that does not fit is reported early."""
        robot, batch = self.robot, (2,)
        model = robot.model
        zeros = np.zeros((*batch, model.nv)), np.zeros((*batch, model.nsensordata))
        now = self.measure(np.broadcast_to(robot.standing_qpos, (*batch, model.nq)), *zeros)
        rng = np.random.default_rng(0)
        for name, randomise in self.randomisations.items():
            start = robot.start_qpos.copy(), np.zeros(model.nv)
            drawn = called(f"task.randomisations.{name}", randomise, rng, robot, *start)
            shapes = [np.shape(values) for values in drawn] if isinstance(drawn, tuple) else type(drawn).__name__
            if shapes != [(model.nq,), (model.nv,)] or not all(np.isfinite(values).all() for values in drawn):
                raise ConfigError(
                    f"task.randomisations.{name} must return finite qpos [{model.nq}] and qvel [{model.nv}], got "
                    f"{shapes}."
                )
        first = self.begin(now, rng)
        for table in (self.table, *([] if self.privileged is None else [self.privileged])):
            table.check(Sensed(now, first, self.facts))
        nothing = np.zeros((*batch, self.facts.actions)), np.zeros(batch, dtype=bool)
        step = Step(now, first, {}, *nothing, self.facts, {})
        with np.errstate(all="ignore"):
            self.memory.check(first, step)
            step = replace(step, after=self.memory.advance(step, rng))
            ended = {f"task.terminations.{name}": term for name, term in self.terminations.items()}
            held = {where: reading(where, term, step.before, step) for where, term in ended.items()}
            step = replace(step, ended=dict(zip(self.terminations, held.values(), strict=True)))
            rewarded = {f"reward.terms.{name}": term for name, term in self.terms.items()}
            paid = {where: reading(where, term, step.before, step) for where, term in rewarded.items()}
        for values, kinds, asked in ((held, "b", "true or false"), (paid, "fiu", "a finite number")):
            for where, value in values.items():
                given = np.asarray(value)
                if given.shape != batch or given.dtype.kind not in kinds or not np.isfinite(given).all():
                    raise ConfigError(
                        f"{where} must return {asked} for each robot, shape {list(batch)}, got {list(given.shape)} "
                        f"{given.dtype}{'' if np.isfinite(given).all() else ' that is not finite'}."
                    )
        for where, term in ended.items():
            clock = called(where, term.clock, first, self.facts, self.time_limit)
            source, sign = called(where, term.clock_mirror, self.facts)
            length = 0 if clock is None else np.shape(clock)[-1]
            if len(source) != length or len(sign) != length:
                raise ConfigError(
                    f"{where}: clock_mirror must return a source and a sign for each of the {length} numbers of clock, "
                    f"got {len(source)} and {len(sign)}."
                )
        self.num_counters = self.counters(first, now).shape[-1]

    # Measuring.

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
        read = self._base.read(qpos, qvel)
        place = {name: np.asarray(value - self._standing[name]) for name, (value, _) in read.items()}
        if self.ground is not None:
            place = self.ground.relative(place, spot)
        if self.facts.base:
            base = np.stack([np.stack([place[name], read[name][1]], axis=-1) for name in self.facts.base], axis=-2)
            upright = np.cos(place.get("roll", 0.0)) * np.cos(place.get("pitch", 0.0))
            tilt = np.broadcast_to(np.arccos(np.clip(upright, -1.0, 1.0)), qpos.shape[:-1])
        else:
            base, tilt = np.zeros((*qpos.shape[:-1], 0, 2)), np.zeros(qpos.shape[:-1])
        return Measurement(
            position=place["forward"],
            height=place["height"],
            velocity=np.asarray(read["forward"][1]),
            # Indexing would give another memory layout than a checkpoint has, and sums would differ in their last bits.
            angles=qpos.take(self._qpos, axis=-1),
            velocities=qvel.take(self._qvel, axis=-1),
            feet_down=sensordata.take(self._feet, axis=-1) > 0,
            other_down=np.asarray((sensordata.take(self._others, axis=-1) > 0).any(axis=-1)),
            shank_down=np.asarray((sensordata.take(self._shanks, axis=-1) > 0).any(axis=-1)),
            base=base,
            tilt=tilt,
            feet_velocity=self._feet_velocity(sensordata),
        )

    def _feet_velocity(self, sensordata: np.ndarray) -> np.ndarray:
        if self._foot_velocities is None:
            return np.zeros((*sensordata.shape[:-1], 0, 3))
        return np.asarray(sensordata.take(self._foot_velocities, axis=-1) @ self._base.frame.T)

    def node_features(self, now: Measurement, memory: Memory | None = None) -> np.ndarray:
        """Return the features of every node in one frame, ``float32 [*, N, F]``; see :class:`.FeatureTable`."""
        nodes = self.table(Sensed(now, memory or {}, self.facts))
        for noise in (NOISE, OWN_NOISE):
            if memory is not None and noise in memory:
                nodes = nodes + memory[noise]
        return nodes

    @property
    def shown_command(self) -> Callable[[Array], Array] | None:
        """Return a function that reads a commanded velocity from observations; ``None`` for a task without one."""
        return None

    @property
    def shown_velocity(self) -> Callable[[Array], Array] | None:
        """Return a function that reads how a robot moves from counters; ``None`` for a task without commands."""
        return None

    @property
    def levels(self) -> tuple[float, ...] | None:
        """Return the commanded heights of jumps, rising (m); ``None`` for a task without them."""
        return None

    @functools.cached_property
    def posture(self) -> Posture:
        """Return what shows the body's posture in observations."""
        return Posture(self.table, self.history, self.robot.leg_length)

    def phase(self, nodes: Array) -> Array:
        """Return the phase that a task with a clock shows in observations, in periods from an episode's start.

        Args:
            nodes: Observations of the nodes, ``[*, N, F * H]``, of NumPy or PyTorch.

        Returns:
            Phases, ``[*]``.
        """
        xp, foot = array_namespace(nodes), self.robot.feet[0]
        newest = nodes[..., (self.history - 1) * self.features :]
        sine, cosine = (newest[(..., *self.table.place(f"{wave}_{foot}"))] for wave in ("clock_sin", "clock_cos"))
        return xp.atan2(sine, cosine) / (2 * math.pi) - float(self.facts.foot_phases[0])

    def counters(self, memory: Memory, now: Measurement | None = None) -> np.ndarray:
        """Return what only critics observe, ``float32 [*, K]``.

        It is the progress to each time-based termination, and the numbers of the privileged features.

        Args:
            memory: The memory.
            now: The measurement; a task without privileged features needs none.
        """
        parts = [
            called(f"task.terminations.{name}", term.clock, memory, self.facts, self.time_limit)
            for name, term in self.terminations.items()
        ]
        shown = [part for part in parts if part is not None]
        if self.privileged is not None:
            if now is None:
                raise ValueError("Privileged features are measured: counters needs the measurement.")
            shown.append(self.privileged.flat(Sensed(now, memory, self.facts)))
        if not shown:
            return np.zeros((*memory[STEPS].shape, 0), dtype=np.float32)
        return np.concatenate(shown, axis=-1).astype(np.float32)

    def reflection(self) -> Reflection:
        """Return the reflection of observations, actions and counters.

        Raises:
            RobotError: If the robot is not the same on its left and its right, see :func:`.check_mirror`.
        """
        mirrors = [term.clock_mirror(self.facts) for term in self.terminations.values()]
        mirrors += [] if self.privileged is None else [self.privileged.flat_reflection()]
        reflection, verdict = Reflection.of(self.robot, self.table, mirrors), check_mirror(self.robot, self.control_dt)
        if not verdict.symmetric:
            raise RobotError(
                f"{self.robot.path} does not move alike on its left and its right. Set replay.mirror=false, and "
                f"network.equivariant=false if that is on; or mend {verdict.reason}."
            )
        return reflection

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

    def command_ranges(self) -> dict[str, tuple[float, float]]:
        """Return the range of each number of the commands by the name of its reading; empty for a task without."""
        return {}

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


def _named(key: str, terms: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{key}.{name}": term for name, term in terms.items()}
