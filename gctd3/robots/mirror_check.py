"""Whether a robot may be mirrored: decided by its dynamics.

The mirror image of a transition is a transition of the robot if to reflect and then to step is to step and then to
reflect. :func:`check_mirror` decides that in three stages, and names the part that fails.

1. What a file says in so many words has to mirror exactly, to 1e-6: the joints' ranges, damping and friction, and their
   actuators' gears, gains and limits. A joint whose partner turns the other way, or whose actuator has a negative gear,
   has its numbers mirrored with the sign; that is only another convention. Where joints are may differ by what files
   round away, 0.01 mm and 1e-4 rad; rotors by 1 % of a joint's inertia, and the servos' damping, which the compiler may
   have derived from a damping ratio and from masses, by 1 %.
2. Masses need not be equal, since no real robot's are (a trunk's centre of mass lies millimetres off the middle), nor
   need meshes of feet. What such differences may amount to is measured where it counts, in the motion: from 100 random
   states with random actions, over one control step, in the air and on the ground, the two orders of stepping and
   reflecting are compared. Their difference is divided by the motion, which is the change of velocities in that step;
   both are measured in the norm of kinetic energy, so that it matters neither which coordinates, which units nor which
   masses a robot has. This is the residual; it may be at most :data:`MOST_RESIDUAL`.
3. In the air, where nothing but masses may differ, masses have to explain the residual: of a copy of the model whose
   masses, centres of mass and inertias are the means of both sides', it must vanish, up to :data:`MOST_UNEXPLAINED` for
   what is rounded away, and for steps of finite length of a base whose frame is not in the middle.
   So any other difference, a tendon or a closed loop on one side, does not pass unnoticed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gctd3.robots.foot_outlines import outline_difference
from gctd3.robots.ground import ground_height
from gctd3.robots.mirror_differences import exact_differences
from gctd3.robots.mirror_masses import Masses
from gctd3.robots.mirror_messages import joint_pair, percent
from gctd3.robots.mirror_residual import STATES, Residual, measure_residual
from gctd3.robots.model_reflection import ModelReflection
from gctd3.robots.robot import Robot

MOST_RESIDUAL = 0.05  # of the motion of one step: less than what policies are trained to bear by randomised masses
MOST_UNEXPLAINED = 0.01  # of the motion, with the masses of both sides made equal
_ALIKE = 1e-9  # of the robot's mass or extent: masses that need no copy in which they are equal


@dataclass(frozen=True)
class MirrorCheck:
    """Represent the verdict on a robot's mirror.

    Attributes:
        symmetric: Whether mirrored transitions are transitions of the robot.
        residual: Difference between stepping and reflecting in one order and the other, as a part of the motion of one
            step; NaN if it was not measured, since something else is not the same.
        reason: What is not the same on the left and the right, with the part's name and numbers; empty if nothing is.
    """

    symmetric: bool
    residual: float
    reason: str = ""

    def __str__(self) -> str:
        """Return a line that says whether the robot is mirrored, and why."""
        if not self.symmetric:
            return f"mirror: off, for {self.reason}"
        if not self.reason:
            return "mirror: on, the left and the right are equal"
        return f"mirror: on, residual {percent(self.residual)} of the motion of one step, explained by {self.reason}"


def check_mirror(robot: Robot, control_dt: float) -> MirrorCheck:
    """Decide whether a robot may be mirrored, see the module's description; once for each robot and period.

    Args:
        robot: The robot.
        control_dt: Control period (s).
    """
    if control_dt not in robot.mirror_checks:
        robot.mirror_checks[control_dt] = _check(robot, control_dt)
    return robot.mirror_checks[control_dt]


def _check(robot: Robot, control_dt: float) -> MirrorCheck:
    balls = [joint.name for joint in robot.joints if joint.kind == "ball"]
    if balls:
        return MirrorCheck(False, np.nan, f"joint {balls[0]!r}: a ball's rotation has no reflection among the features")
    image = ModelReflection(robot)
    reason = next(exact_differences(image), None)
    if reason is not None:
        return MirrorCheck(False, np.nan, reason)
    masses, shapes = Masses(image), outline_difference(image)
    steps = max(round(control_dt / robot.model.opt.timestep), 1)
    air = measure_residual(image, robot.model, steps, ground=None)
    unexplained = air
    if air.total > MOST_UNEXPLAINED:
        unexplained = measure_residual(image, masses.equalised(), steps, ground=None, states=STATES // 10)
    if unexplained.total > MOST_UNEXPLAINED:
        return MirrorCheck(False, unexplained.total, _unexplained(image, unexplained))
    residual, ground = air, ground_height(robot.model)
    if ground is not None:
        landed = measure_residual(image, robot.model, steps, ground)
        residual = max(air, landed, key=lambda measured: measured.total)
    if residual.total > MOST_RESIDUAL:
        difference = masses.worst if air.total > MOST_RESIDUAL else shapes or "what touches the ground"
        return MirrorCheck(
            False,
            residual.total,
            f"{difference}: the mirror image differs by {percent(residual.total)} of the motion of one step, at most "
            f"{percent(MOST_RESIDUAL)} may be",
        )
    reasons = [masses.worst if masses.largest > _ALIKE else "", shapes]
    return MirrorCheck(True, residual.total, "; ".join(reason for reason in reasons if reason))


def _unexplained(image: ModelReflection, residual: Residual) -> str:
    """Name the joint whose motion differs most."""
    dof = int(residual.parts.argmax())
    joint = next(j for j in reversed(image.joints) if j.qvel <= dof)
    return (
        f"joint {joint_pair(joint, image.partner(joint))}: something beside masses that acts on it is not the same, "
        f"for its mirror image moves otherwise by {percent(residual.total)} of the motion of one step"
    )
