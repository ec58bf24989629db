"""A physics engine with one robot on a flat ground, and the servos of a policy's contract."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np

from gctd3.deploy.contract import Contract
from gctd3.robots.description import describe_robot
from gctd3.robots.links import Links
from gctd3.robots.mjcf import bodies_below, body_name, colliding_geoms
from gctd3.robots.robot import Robot
from gctd3.robots.unsaid import Format

_DYNAMICS = re.compile(r"<dynamics [^>]*/>|<dynamics>.*?</dynamics>", re.DOTALL)
FASTEST = 1e3  # rad/s or m/s of a joint: above it the simulation has exploded, and engines may end the process


@dataclass(frozen=True)
class Pose:
    """Hold the state of a robot's base: a frame of its root body that moves freely.

    Attributes:
        place: Origin in the world, shape ``[3]`` (m).
        turn: Orientation, shape ``[3, 3]``.
        velocity: Velocity of the origin in the world, shape ``[3]`` (m/s).
        rate: Angular velocity in the world, shape ``[3]`` (rad/s).
    """

    place: np.ndarray
    turn: np.ndarray
    velocity: np.ndarray
    rate: np.ndarray


class Engine(ABC):
    """Simulate one robot on a flat ground by steps of one control period.

    Attributes:
        torque: Torque of each servo at each step of the physics in the last control period, shape ``[substeps, A]``
            (N m).
        exploded: Whether a joint has become faster than any robot's since the last reset; the engine then stands still.
    """

    name: ClassVar[str]
    torque: np.ndarray
    exploded = False

    @abstractmethod
    def reset(self, qpos: np.ndarray, qvel: np.ndarray, above: float = 0.0) -> None:
        """Put the robot into a state of MuJoCo's, and ``above`` (m) higher; servos rest."""

    @abstractmethod
    def advance(self, desired: np.ndarray) -> None:
        """Simulate a control period with desired angles ``[A]`` (rad) at the servos."""

    @abstractmethod
    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the state as MuJoCo's ``qpos [nq]`` and ``qvel [nv]``."""

    @abstractmethod
    def touching(self) -> frozenset[str]:
        """Return the names of the bodies that touch the ground."""


class OtherEngine(Engine):
    """Simulate a robot in an engine that reads its URDF, or SDF; a subclass speaks to the engine.

    Servos are explicit: ``tau = clip(kp (desired - angle) - kd velocity)`` from the contract at every step, less the
    joint's own damping. As the engine knows no armature, it is added to the inertia of the links below, about all axes.

    Args:
        robot: The robot.
        contract: Contract of the policy.
        timestep: Time step of the physics (s).
        armature: Whether links have their joints' armature.
        folder: Folder for the robot's file.

    Attributes:
        form: Format of the robot's file.
    """

    form: ClassVar[Format] = "urdf"

    def __init__(self, robot: Robot, contract: Contract, timestep: float, armature: bool, folder: Path) -> None:
        self.robot, self.timestep, model = robot, timestep, robot.model
        self.substeps = round(1.0 / (contract.control_rate_hz * timestep))
        share = 1.0 if armature else 0.0
        self.links = Links.of(robot, share)
        self.file = folder / f"robot.{self.form}"
        description = describe_robot(robot, self.form, "robot", share)
        # Damping and friction are put on here: engines that read them do not agree on what they are.
        replace(description, text=_DYNAMICS.sub("", description.text)).write(self.file)
        joints = [joint for joint in self.links.joints if joint.id >= 0]
        self.joints = tuple(joint.name for joint in joints)
        ids = np.array([joint.id for joint in joints])
        self._qpos, self._qvel = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
        self._damping, self.friction = model.dof_damping[self._qvel], model.dof_frictionloss[self._qvel]
        self._spring, self._rest = model.jnt_stiffness[ids], model.qpos_spring[self._qpos]
        self.free = robot.base.free
        servos = contract.servos
        self._driven = np.array([self.joints.index(servo.joint) for servo in servos])
        self._kp, self._kd = np.array([[s.kp_nm_per_rad, s.kd_nm_s_per_rad] for s in servos]).T
        self._effort = np.array([np.inf if s.effort_nm is None else s.effort_nm for s in servos])
        self._time = np.array([s.time_constant_s for s in servos])
        self._filtered: np.ndarray | None = None
        self.exploded = False
        self.open()

    @abstractmethod
    def open(self) -> None:
        """Load the robot's file, the ground, their friction; joints have neither motors nor damping of the engine's."""

    @abstractmethod
    def put(self, angles: np.ndarray, rates: np.ndarray, base: Pose | None) -> None:
        """Put joints ``[J]`` (rad, m) with their velocities, and a free base, where they are asked for."""

    @abstractmethod
    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the joints' angles (rad, m) and velocities, each ``[J]``."""

    @abstractmethod
    def read_base(self) -> Pose:
        """Return the state of a free base."""

    @abstractmethod
    def step(self, torque: np.ndarray) -> None:
        """Take a step of the physics with torques (forces) ``[J]`` at the joints (N m, N)."""

    def reset(self, qpos: np.ndarray, qvel: np.ndarray, above: float = 0.0) -> None:
        """Put the robot into a state of MuJoCo's, and ``above`` (m) higher."""
        angles, rates = qpos[self._qpos].copy(), qvel[self._qvel].copy()
        base = None
        if self.free is not None:
            q, v = self.free.qpos, self.free.qvel
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, qpos[q + 3 : q + 7])
            rotation = turn.reshape(3, 3)
            # MuJoCo's angular velocity is in the body's frame.
            place, rate = qpos[q : q + 3] + np.array([0.0, 0.0, above]), rotation @ qvel[v + 3 : v + 6]
            base = Pose(place, rotation, qvel[v : v + 3].copy(), rate)
        elif above and self.robot.base.height is not None:
            height = self.robot.base.height
            angles[list(self._qpos).index(height.qpos)] += above * height.sign
        self._filtered, self.exploded = None, False
        self.put(angles, rates, base)

    def advance(self, desired: np.ndarray) -> None:
        """Simulate a control period with desired angles ``[A]`` (rad) at the servos."""
        driven, torques = self._driven, np.zeros((self.substeps, len(self._driven)))
        for i in range(self.substeps):
            angles, rates = self.read()
            self.exploded = self.exploded or not float(np.abs(rates).max(initial=0.0)) < FASTEST
            if self.exploded:
                break
            goal = self._filter(desired, angles[driven])
            servo = self._kp * (goal - angles[driven]) - self._kd * rates[driven]
            torques[i] = np.minimum(np.maximum(servo, -self._effort), self._effort)
            force = -self._damping * rates - self._spring * (angles - self._rest)
            force[driven] += torques[i]
            self.step(force)
        self.torque = torques

    def _filter(self, desired: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Return the desired angles after the servos' filters, which begin at the joints' angles."""
        if not self._time.any():
            return desired
        if self._filtered is None:
            self._filtered = angles.copy()
        share = -np.expm1(-self.timestep / np.maximum(self._time, 1e-9))
        self._filtered = self._filtered + share * (desired - self._filtered)
        return self._filtered

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the state as MuJoCo's ``qpos [nq]`` and ``qvel [nv]``."""
        model = self.robot.model
        qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
        qpos[self._qpos], qvel[self._qvel] = self.read()
        if self.free is not None:
            q, v, base = self.free.qpos, self.free.qvel, self.read_base()
            quaternion = np.full(4, np.nan)
            if np.isfinite(base.turn).all():
                mujoco.mju_mat2Quat(quaternion, base.turn.ravel())
            qpos[q : q + 3], qpos[q + 3 : q + 7] = base.place, quaternion
            qvel[v : v + 3], qvel[v + 3 : v + 6] = base.velocity, base.turn.T @ base.rate
        return qpos, qvel


def ground_friction(robot: Robot) -> dict[str, float]:
    """Return the sliding friction of each body that can collide on the ground, as MuJoCo combines the two: the larger.

    Of two surfaces of other priorities MuJoCo takes that of the higher one.
    """
    model = robot.model
    inside = set(bodies_below(model, robot.base.root))
    floors = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) not in inside]
    floors = [g for g in floors if model.geom_contype[g] or model.geom_conaffinity[g]]

    def pair(geom: int, floor: int) -> float:
        one, other = (float(model.geom_friction[g, 0]) for g in (geom, floor))
        first, second = int(model.geom_priority[geom]), int(model.geom_priority[floor])
        return max(one, other) if first == second else one if first > second else other

    result = {}
    for body in sorted(inside):
        own: Iterable[int] = colliding_geoms(model, body)
        values = [pair(geom, floor) for geom in own for floor in floors] or [
            float(model.geom_friction[geom, 0]) for geom in own
        ]
        if values:
            result[body_name(model, body)] = max(values)
    return result
