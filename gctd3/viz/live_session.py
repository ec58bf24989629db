"""One robot under a policy, a control step at a time; it can be pushed and changed while it walks."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings
from gctd3.envs.simulation import Simulation
from gctd3.robots.mjcf import bodies_below, body_name, colliding_geoms
from gctd3.robots.robot import Robot
from gctd3.tasks.memory import target_of
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.terminations import MOST_STEPS
from gctd3.tasks.velocity_command import NAME, SWAY, VELOCITY, velocities
from gctd3.tasks.velocity_features import COMMANDS
from gctd3.viz.terrain_view import ray_points

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS.value


def foot_geoms(robot: Robot) -> list[int]:
    """Return the indices of the feet's colliding geoms."""
    bodies = {body_name(robot.model, body): body for body in bodies_below(robot.model, robot.base.root)}
    return [geom for foot in robot.feet for geom in colliding_geoms(robot.model, bodies[foot])]


@dataclass(frozen=True)
class Moment:
    """Hold the measurements of a walk after a control step, or at the start.

    Attributes:
        qpos: Generalised positions, shape ``[nq]``.
        time: Time since the start (s).
        position: Distance walked (m).
        velocity: Forward velocity (m/s).
        height: Body height from standing (m).
        reward: Reward of the step.
        total: Return so far.
        angles: Angles of ``robot.joints``, shape ``[J]`` (rad).
        feet_down: Whether each foot touches the ground, shape ``[feet]``.
        done: Whether the episode has ended.
        success: Whether it ended at the finish.
        command: Commanded velocity forward, to the left and turning, shape ``[3]`` (m/s, m/s, rad/s), on its way to
            the one that was drawn or steered; ``None`` for a task without it.
        moved: The robot's velocities of the same kind, averaged over half a second, shape ``[3]``; ``None`` for a task
            without commands.
        rays: Where the rays of height scans meet the terrain, shape ``[K, 3]`` (m, in the world).
    """

    qpos: np.ndarray
    time: float
    position: float
    velocity: float
    height: float
    reward: float
    total: float
    angles: np.ndarray
    feet_down: np.ndarray
    done: bool = False
    success: bool = False
    command: np.ndarray | None = None
    moved: np.ndarray | None = None
    rays: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))


class LiveWalk:
    """Simulate a walk of one robot.

    Args:
        policy: Policy that reads ``"nodes"`` and writes ``"action"``; a stochastic one acts by its mode.
        task: The robot's task, with the reward that is counted; :attr:`friction` and :attr:`payload` change the model
            of its robot.
        seed: Seed of the start.

    Attributes:
        data: The simulator's state for drawing, contacts included; :meth:`show` fills it.
        now: The last moment.
    """

    def __init__(
        self,
        policy: TensorDictModuleBase,
        task: SimulatedTask,
        seed: int,
    ) -> None:
        self.policy, self.task, self.robot, self.control_dt = policy, task, task.stage, task.control_dt
        robot = task.stage
        # TorchRL seeds the global generator along with the environment's: a fork keeps that out of a training.
        with torch.random.fork_rng(devices=[]):
            self._env = build_env(task, EnvSettings(num_envs=1, threads=1), seed)
        self.data = mujoco.MjData(robot.model)
        self._root = robot.base.root
        ground = [g for g in range(robot.model.ngeom) if robot.model.geom_bodyid[g] == 0]
        self._rubbing, self._mass = ground + foot_geoms(robot), float(robot.model.body_mass[self._root])
        # A commanded velocity is steered; the height of a jump is drawn with the episode.
        steered = {name: span for name, span in task.command_ranges().items() if name in COMMANDS}
        self._box = np.array(list(steered.values())).reshape(-1, 2)
        self._axes = [COMMANDS.index(name) for name in steered]
        self._steered: np.ndarray | None = None
        self._moved: np.ndarray | None = None
        self.reset(seed)

    @property
    def simulation(self) -> Simulation:
        """Return the simulation of the walk."""
        simulation: Simulation = self._env.base_env.simulation
        return simulation

    def reset(self, seed: int) -> Moment:
        """Begin a new episode; equal seeds give equal starts."""
        with torch.random.fork_rng(devices=[]):
            self._env.set_seed(seed)
            self._state = self._env.reset()
        if self._steered is not None:
            self._order(self._steered)
        self._moved = None
        self.now = self._moment(0.0, 0.0, 0.0, done=False, success=False)
        return self.now

    def step(self) -> Moment:
        """Take one control step.

        Raises:
            NumericalError: If an action of the policy is not finite.
        """
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            state = self._env.step(self.policy(self._state))
        after = state["next"]
        reward, before = float(after["reward"]), self.now
        ends = {"done": bool(after["done"]), "success": bool(after["success"])}
        self.now = self._moment(before.time + self.control_dt, reward, before.total + reward, **ends)
        self._state = step_mdp(state)
        return self.now

    @property
    def ranges(self) -> dict[int, tuple[float, float]]:
        """Return the range of each axis along which the robot can be steered, by its place in a command."""
        return {axis: (float(low), float(high)) for axis, (low, high) in zip(self._axes, self._box, strict=True)}

    @property
    def asked(self) -> np.ndarray | None:
        """Return the command that was steered or drawn last, shape ``[3]`` (m/s, m/s, rad/s); ``None`` without one."""
        memory = self.simulation.memory
        found = memory.get(target_of(VELOCITY), memory.get(VELOCITY))
        return None if found is None else found[0].copy()

    def steer(self, command: np.ndarray) -> None:
        """Set the commanded velocity ``[3]`` (m/s, m/s, rad/s), within the training's ranges.

        From the next step on the command approaches it by as much a second as in the training.
        """
        wanted = np.zeros(3)
        for axis, (low, high) in self.ranges.items():
            wanted[axis] = np.clip(command[axis], low, high)
        self._steered = wanted
        self._order(wanted)

    def _order(self, command: np.ndarray) -> None:
        simulation = self.simulation
        # It holds until the next one, whatever the task draws.
        approached = self.task.commands[NAME].slew_rates is not None
        held = {target_of(VELOCITY) if approached else VELOCITY: command[None]}
        simulation.memory = {**simulation.memory, **held, f"{VELOCITY}.left": np.array([MOST_STEPS])}

    def _average(self) -> np.ndarray | None:
        """Return the robot's velocities, averaged over half a second: a body sways with every step."""
        if VELOCITY not in self.simulation.memory:
            return None
        here = np.asarray(velocities(self.simulation.now, self.simulation.task.facts))[0]
        share = 1.0 - np.exp(-self.control_dt / SWAY)
        self._moved = here if self._moved is None else self._moved + share * (here - self._moved)
        return self._moved

    def _moment(self, time: float, reward: float, total: float, *, done: bool, success: bool) -> Moment:
        here = self.simulation.now
        return Moment(
            qpos=self.simulation.qpos[0].copy(),
            time=time,
            position=float(here.position[0]),
            velocity=float(here.velocity[0]),
            height=float(here.height[0]),
            reward=reward,
            total=total,
            angles=here.angles[0].copy(),
            feet_down=here.feet_down[0].copy(),
            done=done,
            success=success,
            command=self.simulation.memory[VELOCITY][0].copy() if VELOCITY in self.simulation.memory else None,
            moved=self._average(),
            rays=ray_points(self.task, here, self.simulation.memory),
        )

    def show(self) -> mujoco.MjData:
        """Return :attr:`data` with the present state, its contacts computed."""
        mujoco.mj_setState(self.robot.model, self.data, self.simulation.state[0], _FULL)
        mujoco.mj_forward(self.robot.model, self.data)
        return self.data

    @property
    def speed(self) -> float:
        """Return the speed of the whole robot's centre of mass (m/s)."""
        data = self.show()
        mujoco.mj_subtreeVel(self.robot.model, data)
        return float(np.linalg.norm(data.subtree_linvel[self._root]))

    def push(self, forward: float, side: float = 0.0) -> None:
        """Apply an impulse to the root body's centre of mass; every joint is free to yield to it.

        Args:
            forward: Impulse along the forward axis (N s).
            side: Impulse to the left (N s); without effect on a base that cannot move there.
        """
        model, data = self.robot.model, self.show()
        impulse = np.array([forward, side, 0.0]) @ self.robot.base.frame
        pushed, change = np.zeros(model.nv), np.zeros((1, model.nv))
        mujoco.mj_applyFT(model, data, impulse, np.zeros(3), data.xipos[self._root], self._root, pushed)
        # M dv = J^T p: the change of velocity by an instantaneous impulse.
        mujoco.mj_solveM(model, data, change, pushed[None])
        first = 1 + model.nq
        self.simulation.state[0, first : first + model.nv] += change[0]

    @property
    def friction(self) -> float:
        """Return the sliding friction of the ground and the feet (dimensionless)."""
        return float(self.robot.model.geom_friction[self._rubbing, 0].max())

    @friction.setter
    def friction(self, value: float) -> None:
        """Set the sliding friction of the ground and the feet."""
        # MuJoCo takes the larger of two geoms' frictions.
        self.robot.model.geom_friction[self._rubbing, 0] = value

    @property
    def payload(self) -> float:
        """Return the mass that the root body carries at its centre of mass, besides its own (kg)."""
        return float(self.robot.model.body_mass[self._root]) - self._mass

    @payload.setter
    def payload(self, value: float) -> None:
        """Put a mass on the root body, in place of the one before."""
        self.robot.model.body_mass[self._root] = self._mass + value
        # Updates the constants that MuJoCo derives from masses; it needs data to work in.
        mujoco.mj_setConst(self.robot.model, mujoco.MjData(self.robot.model))
