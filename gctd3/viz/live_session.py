"""One robot under a policy, a control step at a time; it can be pushed and changed while it walks."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
from gctd3.tasks.reward import Endings, Reward

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
_FOREVER = 10**9  # control steps


def foot_geoms(robot: Robot) -> list[int]:
    """Indices of the feet's geoms that collide."""
    bodies = {body_name(robot.model, body): body for body in bodies_below(robot.model, robot.base.root)}
    return [geom for foot in robot.feet for geom in colliding_geoms(robot.model, bodies[foot])]


@dataclass(frozen=True)
class Moment:
    """What there is to see after a control step, or at the start.

    Attributes:
        qpos: Shape ``[nq]``.
        time: Since the start (s).
        position: Distance walked (m).
        velocity: Forward (m/s).
        height: Of the body, from standing (m).
        reward: Of the step.
        total: Return so far.
        angles: Of ``robot.joints``, shape ``[J]`` (rad).
        feet_down: Whether each foot touches the ground, shape ``[feet]``.
        done: Whether the episode has ended.
        success: Whether it ended at the finish.
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


def endless(endings: Endings) -> Endings:
    """The same endings, but only a fall ends the episode."""
    return replace(endings, contact_steps=None, hip_steps=None, finish=float("inf"), time_limit=_FOREVER)


class LiveWalk:
    """A walk of one robot, under the paper's reward unless another is given.

    Args:
        policy: Reads ``"nodes"``, writes ``"action"``; its mode is taken if it is stochastic.
        robot: The robot; :attr:`friction` and :attr:`payload` change its model.
        settings: How it is simulated; always one robot on the batched backend.
        seed: Of the start.
        reward: That is counted.

    Attributes:
        data: The simulator's state for those who draw it, contacts included; :meth:`show` fills it.
        now: The last moment.
    """

    def __init__(
        self,
        policy: TensorDictModuleBase,
        robot: Robot,
        settings: EnvSettings,
        seed: int,
        reward: Reward | None = None,
    ) -> None:
        self.policy, self.robot, self.control_dt = policy, robot, settings.control_dt
        one, reward = settings.judging(1, threads=1), reward if reward is not None else Reward()
        # TorchRL seeds the global generator along with the environment's: a fork keeps that out of a training.
        with torch.random.fork_rng(devices=[]):
            self._env = build_env(robot, one, reward, seed)
        self.data = mujoco.MjData(robot.model)
        self._root = robot.base.root
        ground = [g for g in range(robot.model.ngeom) if robot.model.geom_bodyid[g] == 0]
        self._rubbing, self._mass = ground + foot_geoms(robot), float(robot.model.body_mass[self._root])
        self.reset(seed)

    @property
    def simulation(self) -> Simulation:
        """In which it walks."""
        simulation: Simulation = self._env.base_env.simulation
        return simulation

    def reset(self, seed: int) -> Moment:
        """Begin a new episode; equal seeds, equal starts."""
        with torch.random.fork_rng(devices=[]):
            self._env.set_seed(seed)
            self._state = self._env.reset()
        self.now = self._moment(0.0, 0.0, 0.0, done=False, success=False)
        return self.now

    def step(self) -> Moment:
        """One control step.

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
        )

    def show(self) -> mujoco.MjData:
        """:attr:`data` with the present state, its contacts computed."""
        mujoco.mj_setState(self.robot.model, self.data, self.simulation.state[0], _FULL)
        mujoco.mj_forward(self.robot.model, self.data)
        return self.data

    def push(self, forward: float, side: float = 0.0) -> None:
        """Give the root body's centre of mass an impulse; every joint is free to yield to it.

        Args:
            forward: Along the forward axis (N s).
            side: To the left (N s); a base that cannot move there feels nothing.
        """
        model, data = self.robot.model, self.show()
        impulse = np.array([forward, side, 0.0]) @ self.robot.base.frame
        pushed, change = np.zeros(model.nv), np.zeros((1, model.nv))
        mujoco.mj_applyFT(model, data, impulse, np.zeros(3), data.xipos[self._root], self._root, pushed)
        # M dv = J^T p: what a force gives that acts for no time.
        mujoco.mj_solveM(model, data, change, pushed[None])
        first = 1 + model.nq
        self.simulation.state[0, first : first + model.nv] += change[0]

    @property
    def friction(self) -> float:
        """Sliding friction of the ground and the feet (dimensionless)."""
        return float(self.robot.model.geom_friction[self._rubbing, 0].max())

    @friction.setter
    def friction(self, value: float) -> None:
        """Set that of the ground and of the feet."""
        # MuJoCo takes the larger of two geoms' frictions.
        self.robot.model.geom_friction[self._rubbing, 0] = value

    @property
    def payload(self) -> float:
        """Mass that the root body carries at its centre of mass, besides its own (kg)."""
        return float(self.robot.model.body_mass[self._root]) - self._mass

    @payload.setter
    def payload(self, value: float) -> None:
        """Put a mass on the root body, in place of the one before."""
        self.robot.model.body_mass[self._root] = self._mass + value
        # What MuJoCo derives from masses; it wants data to work in.
        mujoco.mj_setConst(self.robot.model, mujoco.MjData(self.robot.model))
