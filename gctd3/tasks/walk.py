"""The walking task as array functions: what the robot senses, what a step is worth, when an episode ends.

Stage three of the data flow, shared by every backend. All functions take arrays with any leading dimensions ``*``
(none for one robot, ``[N]`` for a batch) and return new ones; nothing here steps a simulator.
"""

from __future__ import annotations

import numpy as np

from gctd3.robots.graph import KinematicGraph
from gctd3.robots.nodes import foot_slots
from gctd3.robots.robot import Robot
from gctd3.tasks.reward import Endings, Reward
from gctd3.tasks.step_records import Measurement, Outcome, Progress

FEATURES = 2  # of a node in one frame


class WalkingTask:
    """Walk forward as far as the finish: senses a robot on whatever base, and judges each step.

    Args:
        robot: The robot.
        reward: The reward's weights.
        endings: The endings' thresholds.
        control_dt: Control period (s).

    Raises:
        RobotError: If the robot lacks what walking asks for, see :meth:`.Robot.check_walking`.
    """

    def __init__(
        self,
        robot: Robot,
        reward: Reward | None = None,
        endings: Endings | None = None,
        control_dt: float = 0.02,
    ) -> None:
        self.robot = robot
        self.control_dt = control_dt
        self.reward = reward if reward is not None else Reward()
        self.endings = endings if endings is not None else Endings()
        robot.check_walking()
        graph = KinematicGraph.from_robot(robot)
        names = [joint.name for joint in robot.joints]
        self.nodes = graph.nodes
        self.hips = np.array([names.index(leg[0].name) for leg in robot.legs])
        self._qpos = np.array([joint.qpos for joint in robot.joints])
        self._qvel = np.array([joint.qvel for joint in robot.joints])
        self._joint_nodes = np.array([i for i, kind in enumerate(graph.kinds) if kind == "hinge"])
        self._joint_of_node = np.array([names.index(graph.nodes[i]) for i in self._joint_nodes])
        self._foot_node, self._foot_feature = foot_slots(robot).T
        self._pairs = np.array([(i, k) for i, k in enumerate(robot.mirror_feet) if i < k], dtype=np.int64).reshape(
            -1, 2
        )
        self._feet = robot.contact_sensors(robot.feet)
        self._others = robot.contact_sensors(robot.other_contact_bodies)
        self._base, self._extra = robot.base, robot.base.extra
        standing = self._base.read(robot.standing_qpos, np.zeros(robot.model.nv))
        self._standing = {name: value for name, (value, _) in standing.items()}

    def measure(self, qpos: np.ndarray, qvel: np.ndarray, sensordata: np.ndarray) -> Measurement:
        """Read the simulator: ``qpos [*, nq]``, ``qvel [*, nv]``, ``sensordata [*, ns]``."""
        read = self._base.read(qpos, qvel)
        place = {name: np.asarray(value - self._standing[name]) for name, (value, _) in read.items()}
        if self._extra:
            base = np.stack([np.stack([place[name], read[name][1]], axis=-1) for name in self._extra], axis=-2)
            upright = np.cos(place.get("roll", 0.0)) * np.cos(place.get("pitch", 0.0))
            tilt = np.broadcast_to(np.arccos(np.clip(upright, -1.0, 1.0)), qpos.shape[:-1])
        else:
            base, tilt = np.zeros((*qpos.shape[:-1], 0, FEATURES)), np.zeros(qpos.shape[:-1])
        return Measurement(
            position=place["forward"],
            height=place["height"],
            velocity=np.asarray(read["forward"][1]),
            angles=qpos[..., self._qpos],
            velocities=qvel[..., self._qvel],
            feet_down=sensordata[..., self._feet] > 0,
            other_down=np.asarray((sensordata[..., self._others] > 0).any(axis=-1)),
            base=base,
            tilt=tilt,
        )

    def node_features(self, now: Measurement) -> np.ndarray:
        """The state of every node in one frame (section 2.3), shape ``[*, N, 2]``.

        Root: height (m), forward velocity (m/s). Base: a coordinate (rad or m) and its rate. Joint: angle (rad),
        velocity (rad/s). Ground: the contacts of its feet, 0 where it has but one.
        """
        features = np.zeros((*now.position.shape, len(self.nodes), FEATURES), dtype=np.float32)
        features[..., 0, 0] = now.height
        features[..., 0, 1] = now.velocity
        features[..., 1 : 1 + now.base.shape[-2], :] = now.base
        features[..., self._joint_nodes, 0] = now.angles[..., self._joint_of_node]
        features[..., self._joint_nodes, 1] = now.velocities[..., self._joint_of_node]
        features[..., self._foot_node, self._foot_feature] = now.feet_down
        return features

    @property
    def num_counters(self) -> int:
        """Length of :meth:`counters`."""
        return 2 * len(self.robot.feet)

    def counters(self, progress: Progress) -> np.ndarray:
        """How near each time-based ending is, shape ``[*, 2 * feet]``: what a critic may see and a policy may not.

        Per foot, contact time over its limit, or minus its time in the air; per hip, time on one side over its limit,
        with the side's sign.
        """
        contact = (progress.contact_steps - progress.air_steps) / (
            self.endings.contact_steps or self.endings.time_limit
        )
        hip = progress.hip_steps / (self.endings.hip_steps or self.endings.time_limit)
        return np.concatenate([contact, np.where(progress.hip_positive, hip, -hip)], axis=-1).astype(np.float32)

    def begin(self, now: Measurement) -> Progress:
        """The memory of an episode that starts with this measurement: every stack repeats it."""
        shape = now.position.shape
        reward = self.reward
        feet = np.zeros((*shape, len(self.robot.feet)), dtype=np.int64)
        return Progress(
            step=np.zeros(shape, dtype=np.int64),
            positions=np.repeat(now.position[..., None], reward.progress_steps + 1, axis=-1),
            heights=np.repeat(now.height[..., None], reward.frames, axis=-1),
            feet_down=np.repeat(now.feet_down[..., None, :], reward.frames, axis=-2),
            contact_steps=feet,
            air_steps=feet,
            hip_steps=feet,
            hip_positive=now.angles[..., self.hips] >= 0.0,
        )

    def advance(
        self, before: Progress, now: Measurement, diverged: np.ndarray | None = None
    ) -> tuple[Progress, Outcome]:
        """One control step: the memory after it, and its outcome.

        Args:
            before: The memory before the step.
            now: What is measured after it.
            diverged: Whether the simulation failed, shape ``[*]``, which counts as a fall; nowhere if ``None``.
        """
        hip_positive = now.angles[..., self.hips] >= 0.0
        after = Progress(
            step=before.step + 1,
            positions=_push(before.positions, now.position, axis=-1),
            heights=_push(before.heights, now.height, axis=-1),
            feet_down=_push(before.feet_down, now.feet_down, axis=-2),
            contact_steps=np.where(now.feet_down, before.contact_steps + 1, 0),
            air_steps=np.where(now.feet_down, 0, before.air_steps + 1),
            hip_steps=np.where(hip_positive == before.hip_positive, before.hip_steps + 1, 1),
            hip_positive=hip_positive,
        )
        failed = diverged if diverged is not None else np.zeros(now.position.shape, dtype=bool)
        return after, self._outcome(before, after, now, failed)

    def _outcome(self, before: Progress, after: Progress, now: Measurement, diverged: np.ndarray) -> Outcome:
        w, end = self.reward, self.endings
        fell = (now.height < end.fall_height) | now.other_down | diverged
        if end.fall_tilt is not None:
            fell = fell | (now.tilt > end.fall_tilt)
        long_contact = _longer_than(after.contact_steps, end.contact_steps)
        stuck_hip = _longer_than(after.hip_steps, end.hip_steps)

        feet = after.feet_down.sum(axis=-1)
        target = np.where(feet == 1, w.height_single, w.height_double)
        off_height = np.where(feet > 0, np.abs(after.heights - target), 0.0).sum(axis=-1)
        in_flight = np.maximum((feet == 0).sum(axis=-1) - w.flight_free, 0)
        terms = {
            "velocity": np.minimum(now.velocity, w.target_velocity),
            "progress": w.progress * (after.positions[..., -1] - after.positions[..., 0]),
            "height": -w.height * off_height,
            "flight": -w.flight * in_flight,
            "living": np.full(now.velocity.shape, -w.living),
            "fall": -w.fall * fell,
            "long_contact": -w.long_contact * long_contact,
            "stuck_hip": -w.stuck_hip * stuck_hip,
        }
        if w.antiphase:
            hips = now.angles[..., self.hips] * self.robot.hip_signs
            terms["antiphase"] = -w.antiphase * np.abs(hips[..., self._pairs].sum(axis=-1)).sum(axis=-1)
        if w.single_support:
            terms["single_support"] = w.single_support * (feet[..., -1] == 1)
        if w.overspeed:
            terms["overspeed"] = -w.overspeed * np.maximum(now.velocity - w.overspeed_from, 0.0)
        if w.short_swing or w.long_swing:
            in_air = before.air_steps * self.control_dt
            short, long = np.maximum(w.swing_least - in_air, 0.0), np.maximum(in_air - w.swing_most, 0.0)
            touchdown = now.feet_down & (before.air_steps > 0)
            cost = w.short_swing * short + w.long_swing * long
            terms["swing"] = -np.where(touchdown, cost, 0.0).sum(axis=-1)
        if w.tilt:
            terms["tilt"] = -w.tilt * now.tilt
        for name, weight in (("yaw", w.heading), ("side", w.off_line)):
            if weight and name in self._extra:
                terms[name] = -weight * np.abs(now.base[..., self._extra.index(name), 0])

        terminated = fell | long_contact | stuck_hip
        success = (now.position >= end.finish) & ~terminated
        truncated = (success | (after.step >= end.time_limit)) & ~terminated
        return Outcome(terms, terminated, truncated, success, diverged)


def _push(stack: np.ndarray, newest: np.ndarray, axis: int) -> np.ndarray:
    keep = [slice(None)] * stack.ndim
    keep[axis] = slice(1, None)
    return np.concatenate([stack[tuple(keep)], np.expand_dims(newest, axis)], axis=axis)


def _longer_than(steps: np.ndarray, limit: int | None) -> np.ndarray:
    if limit is None:
        return np.zeros(steps.shape[:-1], dtype=bool)
    return np.asarray((steps > limit).any(axis=-1))
