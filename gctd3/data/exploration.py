"""Explore: a rhythmic warm-up, then the policy with noise that differs from robot to robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from gctd3.data.commanded_stepping import CommandedStepping
from gctd3.data.jumping import Jumping
from gctd3.data.motion_search import MotionSearch
from gctd3.data.rhythm import Rhythm
from gctd3.data.settings import ExplorationSettings
from gctd3.data.stepping import Stepping
from gctd3.data.swinging import Swinging
from gctd3.data.trials import Shown, Trials
from gctd3.errors import ConfigError
from gctd3.robots.gait_pattern import GaitPattern
from gctd3.robots.robot import Robot
from gctd3.tasks.posture import Posture
from gctd3.tasks.task import Task


class Explorer(TensorDictModuleBase):
    """Act as the collecting policy: warm-up first, then the actor with noise.

    It reads what the actor reads and ``"is_init"``, and, if gaits evolve in the warm-up, ``"position"`` and
    ``"episode_reward"``, as far as it judges them by these; it writes ``"action"`` ``[robots, A]``.

    Args:
        actor: The policy under training.
        robot: The robot.
        num_robots: Number of robots, over all of which the noise is spread.
        settings: Settings of warm-up and noise.
        control_dt: Control period (s).
        part: Robots that this explorer moves, all by default; other explorers move the rest at the same pace.
        gait: Gait for which the policy observes a clock; feet that step in the warm-up keep to it.
        command: Function that reads the commanded velocity ``[robots, 3]`` from the observed nodes, which feet that
            step in the warm-up follow, or the commanded height ``[robots, 1]`` of a jump; ``None`` for none.
        velocity: Function that reads the velocity ``[robots, 3]`` from what critics observe, by which these feet are
            corrected; ``None`` for none.
        limit: Control steps after which an episode ends though the robot has not fallen; ``None`` for no limit.
        posture: What shows the body's posture in the observed nodes, to which feet that step may answer.
        levels: Commanded heights of jumps, rising (m); ``None`` for a task without them.

    Attributes:
        frames: Control steps of all robots so far.
    """

    frames: Tensor
    warmup: Tensor
    sigma: Tensor
    held: Tensor
    memory: Tensor
    wander: Tensor

    def __init__(
        self,
        actor: TensorDictModuleBase,
        robot: Robot,
        num_robots: int,
        settings: ExplorationSettings,
        control_dt: float = 0.02,
        part: slice = slice(None),
        gait: GaitPattern | None = None,
        command: Callable[[Tensor], Tensor] | None = None,
        velocity: Callable[[Tensor], Tensor] | None = None,
        limit: int | None = None,
        posture: Posture | None = None,
        levels: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        self.num_robots = num_robots
        robots = len(range(num_robots)[part])
        stepping, jumping = settings.warmup == "stepping", settings.warmup == "jumping"
        if jumping and (levels is None or command is None or gait is None):
            raise ConfigError(
                "exploration.warmup must not be jumping for this task: jumps follow a commanded height and a clock, "
                "which policies of task=jump observe."
            )
        if levels is not None and not jumping:
            # Feet that step follow neither a height nor the clock of a jump.
            command, gait = None, None
        # What tells how good a gait is, if gaits evolve.
        self._judged_by: list[str] = []
        if settings.warmup in ("stepping", "swinging", "jumping"):
            judged_by_speed = settings.least_speed is not None and not jumping
            self._judged_by = ["episode_reward", *(["position"] if judged_by_speed else [])]
        elif settings.mutation_share > 0:
            self._judged_by = ["position"]
        self._command = command if stepping or jumping else None
        self._velocity = velocity if self._command is not None and stepping else None
        self._posture = posture if stepping and settings.answers else None
        seen = [*self._judged_by, *(["counters"] if self._velocity is not None else [])]
        self.in_keys = [*actor.in_keys, "is_init", *seen]
        if self._posture is not None and "nodes" not in self.in_keys:
            self.in_keys.append("nodes")
        self.out_keys = ["action"]
        self.actor = actor
        self.settings = settings
        settings.check_robot(robot, control_dt)
        self.rhythm: Rhythm | MotionSearch | None = None
        steps, share = settings.learning_starts // num_robots, settings.mutation_share
        trials = Trials(
            settings.trial,
            control_dt,
            share,
            steps,
            limit,
            settings.least_speed,
            settings.rounds_of(steps * control_dt),
            settings.from_standing,
        )
        if settings.warmup == "rhythmic":
            self.rhythm = Rhythm(robot, robots, settings.frequency, control_dt, share)
        elif settings.warmup == "swinging":
            self.rhythm = Swinging(robot, robots, settings.frequency, trials)
        elif stepping:
            kind = Stepping if command is None else CommandedStepping
            self.rhythm = kind(robot, robots, trials, gait, balances=self._posture is not None)
        elif jumping and gait is not None:
            self.rhythm = Jumping(robot, robots, levels or (), gait.frequency, trials)
        self.register_buffer("frames", torch.zeros((), dtype=torch.int64))
        # Frames of the warm-up.
        self.register_buffer("warmup", torch.tensor(settings.learning_starts))
        self.register_buffer("held", torch.zeros(robots, robot.model.nu))
        low, high = settings.noise if settings.noise is not None else (1.0, 1.0)
        spread = torch.logspace(math.log10(low), math.log10(high), num_robots)
        self.register_buffer("sigma", spread[part, None])
        memory = torch.zeros(num_robots, 1)
        if settings.noise_time > 0:
            memory[1::2] = math.exp(-control_dt / settings.noise_time)
        self.register_buffer("memory", memory[part])
        self.register_buffer("wander", torch.zeros(robots, robot.model.nu))

    @classmethod
    def of_task(
        cls,
        task: Task,
        actor: TensorDictModuleBase,
        num_robots: int,
        settings: ExplorationSettings,
        part: slice = slice(None),
    ) -> Explorer:
        """Build the explorer of a task; see :class:`Explorer` for the arguments."""
        shown = task.shown_command, task.shown_velocity, task.time_limit, task.posture, task.levels
        return cls(actor, task.robot, num_robots, settings, task.control_dt, part, task.gait, *shown)

    @property
    def warming_up(self) -> bool:
        """Return whether the warm-up is still going on: the policy has not acted yet."""
        return int(self.frames) < int(self.warmup)

    @property
    def round_over(self) -> bool:
        """Return whether a round of the warm-up is over, and another one may follow."""
        return self.warming_up and isinstance(self.rhythm, MotionSearch) and self.rhythm.round_over

    @property
    def round_frames(self) -> int:
        """Return the frames of a round of the warm-up."""
        rounds = self.rhythm.rounds if isinstance(self.rhythm, MotionSearch) else 1
        return self.settings.learning_starts // rounds

    @property
    def anew(self) -> Tensor | None:
        """Return which robots had best begin a new episode before the next step of the warm-up, bool ``[robots]``."""
        return self.rhythm.anew if self.warming_up and isinstance(self.rhythm, MotionSearch) else None

    def end_warmup(self) -> None:
        """Let the policy act from the next step on."""
        self.warmup.copy_(self.frames)

    def resume_warmup(self) -> int:
        """Let another round of gaits act from the next step on, if any are left; return the frames that are left."""
        if not isinstance(self.rhythm, MotionSearch) or not (steps := self.rhythm.steps_left):
            return 0
        self.rhythm.go_on()
        self.warmup.copy_(self.frames + self.num_robots * steps)
        return self.num_robots * steps

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the next action of every robot."""
        if self.warming_up:
            tensordict.set("action", self._warmup(tensordict))
        else:
            # Robots are on the CPU; the actor may be elsewhere.
            device = next(self.actor.parameters()).device
            seen = tensordict.select(*self.actor.in_keys).to(device)
            # TorchRL takes a distribution's mode unless told to draw from it.
            with set_exploration_type(ExplorationType.RANDOM):
                tensordict.set("action", self.actor(seen).get("action").to("cpu"))
            if self.settings.noise is not None:
                action = tensordict.get("action")
                noise = self.sigma * self._noise(tensordict.get("is_init").reshape(-1, 1))
                tensordict.set("action", (action + noise).clamp(-1.0, 1.0))
        self.frames += self.num_robots
        return tensordict

    def _noise(self, is_init: Tensor) -> Tensor:
        """Return noise of unit variance; its correlation with the last step's ends with the episode."""
        memory = self.memory * ~is_init
        self.wander = memory * self.wander + (1 - memory**2).sqrt() * torch.randn_like(self.wander)
        return self.wander

    def _warmup(self, tensordict: TensorDictBase) -> Tensor:
        if self.rhythm is not None:
            reached = [tensordict.get(key).reshape(-1) for key in ("is_init", *self._judged_by)]
            # A rhythm without trials asks for nothing that is shown.
            shown = {"shown": self._shown(tensordict)} if isinstance(self.rhythm, MotionSearch) else {}
            action: Tensor = self.rhythm(*reached, **shown)
            return action
        if (int(self.frames) // self.num_robots) % self.settings.hold == 0:
            self.held.uniform_(-1.0, 1.0)
        return self.held.clone()

    def _shown(self, tensordict: TensorDictBase) -> Shown:
        nodes = tensordict.get("nodes", None)
        return Shown(
            command=None if self._command is None else self._command(nodes),
            posture=None if self._posture is None else self._posture(nodes),
            velocity=None if self._velocity is None else self._velocity(tensordict.get("counters")),
        )
