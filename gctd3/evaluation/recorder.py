"""Motion of robots during evaluation, at the resolution of the physics: servo forces, soles, joints, actions."""

from __future__ import annotations

from dataclasses import dataclass, fields

import mujoco
import numpy as np

from gctd3.envs.simulation import Simulation
from gctd3.evaluation.effort import mechanical_work
from gctd3.robots.geometry import geom_points, lowest_point
from gctd3.robots.mjcf import colliding_geoms
from gctd3.robots.robot import Robot
from gctd3.tasks.ground import Ground


@dataclass(frozen=True)
class Motion:
    """Hold the motion of one robot in one episode of ``T`` control steps; every row is the state after a step.

    Attributes:
        action: Actions, shape ``[T, A]``, in [-1, 1].
        angles: Angles of ``robot.joints``, shape ``[T, J]`` (rad).
        velocities: Velocities of the same joints, shape ``[T, J]`` (rad/s).
        velocity: Forward velocity, shape ``[T]`` (m/s).
        state: All coordinates but the forward position, and all velocities, shape ``[T, nq - 1 + nv]``.
        work: Work of all servos in the control step, absolute and positive, shape ``[T, 2]`` (J).
        saturated: Share of its physics steps in which each servo was at its force limit, shape ``[T, A]``.
        sole_height: Height of each foot's lowest point above its height when standing, shape ``[T, feet]`` (m).
        sole_speed: Horizontal speed of that point, shape ``[T, feet]`` (m/s).
    """

    action: np.ndarray
    angles: np.ndarray
    velocities: np.ndarray
    velocity: np.ndarray
    state: np.ndarray
    work: np.ndarray
    saturated: np.ndarray
    sole_height: np.ndarray
    sole_speed: np.ndarray

    def since(self, step: int) -> Motion:
        """Return the motion from a control step on."""
        return Motion(**{field.name: getattr(self, field.name)[step:] for field in fields(self)})


class Servos:
    """Compute the forces of a robot's position servos as MuJoCo does: ``clip(g u + b0 + b1 l + b2 v)``.

    ``u`` is the desired angle, ``l`` and ``v`` are length and velocity of the actuator: gear times joint angle (rad)
    and joint velocity (rad/s). The force is clipped to the servo's own range and to that of its joint over the gear,
    so that it is what the joint gets.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        joints = model.actuator_trnid[:, 0]
        self.qpos, self.qvel = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.gear, self.gain = model.actuator_gear[:, 0], model.actuator_gainprm[:, 0]
        self.bias = model.actuator_biasprm[:, :3].T
        limited, free = model.actuator_forcelimited.astype(bool)[:, None], np.array([-np.inf, np.inf])
        own = np.where(limited, model.actuator_forcerange, free)
        at_joint = np.where(model.jnt_actfrclimited[joints].astype(bool)[:, None], model.jnt_actfrcrange[joints], free)
        with np.errstate(divide="ignore", invalid="ignore"):  # a gear of 0 drives nothing, and is limited by nothing
            of_joint = np.where(self.gear[:, None] == 0.0, free, np.sort(at_joint / self.gear[:, None], axis=1))
        self.low, self.high = np.maximum(own[:, 0], of_joint[:, 0]), np.minimum(own[:, 1], of_joint[:, 1])
        # A servo that filters its input has the filter's state in place of the input.
        self.filtered = model.actuator_dyntype != mujoco.mjtDyn.mjDYN_NONE
        self.act = np.where(self.filtered, model.actuator_actadr + model.actuator_actnum - 1, 0)

    def force(self, qpos: np.ndarray, qvel: np.ndarray, control: np.ndarray) -> np.ndarray:
        """Compute servo forces ``[*, A]`` (N m) from ``qpos [*, nq]``, ``qvel [*, nv]`` and inputs ``[*, A]``."""
        b0, b1, b2 = self.bias
        length, velocity = qpos[..., self.qpos] * self.gear, qvel[..., self.qvel] * self.gear
        wanted = self.gain * control + b0 + b1 * length + b2 * velocity
        return np.asarray(np.clip(wanted, self.low, self.high))

    def saturated(self, force: np.ndarray) -> np.ndarray:
        """Tell which servo forces ``[*, A]`` (N m) are at their limits."""
        close = 1.0 - 1e-9
        low = np.where(self.low < 0.0, self.low * close, self.low)
        return np.asarray((force <= low) | (force >= np.where(self.high > 0.0, self.high * close, self.high)))


class Recorder:
    """Record the motion of the robots of a simulation, from after a reset.

    Args:
        robot: The robot model that they share.
        simulation: The simulation that steps them.
    """

    def __init__(self, robot: Robot, simulation: Simulation) -> None:
        self.robot, self.simulation = robot, simulation
        self.servos = Servos(robot.model)
        self._rows: list[tuple[np.ndarray, ...]] = []

    def add(self, action: np.ndarray) -> None:
        """Record the control step that was just made with ``action [N, A]``."""
        simulation, servos, model = self.simulation, self.servos, self.robot.model
        states = simulation.trail()
        qpos, rest = states[..., 1 : 1 + model.nq], 1 + model.nq
        qvel, act = states[..., rest : rest + model.nv], states[..., rest + model.nv : rest + model.nv + model.na]
        control = np.broadcast_to(simulation.desired(action)[:, None], (*states.shape[:2], action.shape[-1]))
        if servos.filtered.any():
            control = np.where(servos.filtered, act[..., servos.act], control)
        begin = servos.force(qpos[:, :-1], qvel[:, :-1], control[:, :-1])
        # MuJoCo's implicit integrator applies the force of the velocity at the step's end; the mean of both velocities
        # makes its product with the force the energy that the step brings.
        force = servos.force(qpos[:, :-1], qvel[:, 1:], control[:, :-1])
        speed = (qvel[:, :-1, servos.qvel] + qvel[:, 1:, servos.qvel]) / 2 * servos.gear
        dt = model.opt.timestep
        work = np.array([mechanical_work(f, w, dt) for f, w in zip(force, speed, strict=True)])
        saturated = servos.saturated(begin).mean(axis=1)
        self._rows.append((action.copy(), qpos[:, -1].copy(), qvel[:, -1].copy(), work, saturated))

    def motions(self, steps: list[int]) -> list[Motion]:
        """Return the motion of each robot in its first control steps, whose number ``steps`` gives."""
        columns = [np.stack(column, axis=1) for column in zip(*self._rows, strict=True)]
        return [self._motion(*(column[i, :count] for column in columns)) for i, count in enumerate(steps)]

    def _motion(
        self, action: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, work: np.ndarray, saturated: np.ndarray
    ) -> Motion:
        robot = self.robot
        task = self.simulation.task
        height, speed = soles(robot, qpos, task.control_dt, task.ground)
        return Motion(
            action=action,
            angles=qpos[:, [joint.qpos for joint in robot.joints]],
            velocities=qvel[:, [joint.qvel for joint in robot.joints]],
            velocity=np.asarray(robot.base.read(qpos, qvel)["forward"][1]),
            state=np.concatenate([np.delete(qpos, robot.forward, axis=1), qvel], axis=1),
            work=work,
            saturated=saturated,
            sole_height=height,
            sole_speed=speed,
        )


def soles(robot: Robot, qpos: np.ndarray, dt: float, terrain: Ground | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Compute the height of each foot's lowest point above the ground (m), and its horizontal speed (m/s).

    The ground is where the foot is when the robot stands, and on terrain what is below the point. The point is fixed to
    the foot, and its speed is the distance that it goes to the next sample over ``dt``; a foot that rolls over its edge
    does not slip.

    Args:
        robot: The robot.
        qpos: Poses, shape ``[T, nq]``.
        dt: Time between the samples (s).
        terrain: The terrain; ``None`` for a plane.

    Returns:
        Heights (m) and speeds (m/s), each of shape ``[T, feet]``.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    feet = list(robot.foot_bodies)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(model, data)
    local, ground = [], []
    for foot in feet:
        clouds = [geom_points(model, data, geom) for geom in colliding_geoms(model, foot)]
        points = np.concatenate(clouds) if clouds else data.xpos[[foot]]
        local.append((points - data.xpos[foot]) @ data.xmat[foot].reshape(3, 3))
        ground.append(points[:, 2].min())
    place, turn = np.empty((len(qpos), len(feet), 3)), np.empty((len(qpos), len(feet), 3, 3))
    for t, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        place[t], turn[t] = data.xpos[feet], data.xmat[feet].reshape(-1, 3, 3)
    height, speed = np.empty(place.shape[:2]), np.zeros(place.shape[:2])
    for i, points in enumerate(local):
        above = place[:, i, None, 2] + np.einsum("tk,pk->tp", turn[:, i, 2], points)
        lowest = above.argmin(axis=1)
        height[:, i] = above.min(axis=1) - ground[i]
        now = place[:, i] + np.einsum("tjk,tk->tj", turn[:, i], points[lowest])
        if terrain is not None:
            height[:, i] -= terrain.height(now @ robot.base.frame[:2].T)
        later = place[1:, i] + np.einsum("tjk,tk->tj", turn[1:, i], points[lowest[:-1]])
        speed[:-1, i] = np.linalg.norm((later - now[:-1])[:, :2], axis=1) / dt
    if len(qpos) > 1:
        speed[-1] = speed[-2]  # the last sample has no successor
    return height, speed


def standing_height(robot: Robot) -> float:
    """Return the height of the body's origin above the lowest point of the feet in the standing pose (m)."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(model, data)
    geoms = [geom for foot in robot.foot_bodies for geom in colliding_geoms(model, foot)]
    return float(data.xpos[robot.base.root, 2]) - lowest_point(model, data, geoms)


def total_mass(robot: Robot) -> float:
    """Return the total mass of a robot (kg)."""
    return float(robot.model.body_subtreemass[robot.base.root])
