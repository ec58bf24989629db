"""The standing and the initial pose of a robot: the pose that its MJCF names, else the reference pose on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.floating_base import Base
from gctd3.robots.geometry import lowest_point
from gctd3.robots.mjcf import colliding_geoms, named_pose, standing_pose

MOST_DROP = 0.05  # m: from how far above standing an episode may begin


def find_standing(base: Base, feet: Sequence[int]) -> np.ndarray:
    """Find the standing pose: the one that the MJCF names, else the reference pose with the lowest foot on the ground.

    Args:
        base: The robot's base.
        feet: Indices of the bodies that may touch the ground.

    Returns:
        Shape ``[nq]``; the reference pose itself where the ground is not level, or the base has no height.
    """
    pose, height = standing_pose(base.model), base.height
    if named_pose(base.model) is None and height is not None:
        ground = ground_height(base.model)
        lowest = _lowest(base.model, feet, pose)
        if ground is not None and np.isfinite(lowest):
            pose[height.qpos] -= height.sign * (lowest - ground)
    return pose


def find_start(base: Base, standing: np.ndarray) -> np.ndarray:
    """Find the initial pose: the reference pose if a small drop above standing, else the standing pose. Shape ``[nq]``.

    Args:
        base: The robot's base.
        standing: The standing pose, shape ``[nq]``.
    """
    height, reference = base.height, base.model.qpos0.copy()
    if height is None:
        return standing.copy()
    drop = height.sign * (reference - standing)[height.qpos]
    same = np.allclose(np.delete(reference, height.qpos), np.delete(standing, height.qpos), rtol=0.0, atol=1e-6)
    return reference if same and 0.0 <= drop <= MOST_DROP else standing.copy()


def check_standing(base: Base, feet: Sequence[int], file: Path) -> None:
    """Check that the pose that the MJCF names is on the ground: heights are relative to it, and episodes begin in it.

    Args:
        base: The robot's base.
        feet: Indices of the bodies that may touch the ground.
        file: Path of the MJCF, for messages.

    Raises:
        RobotError: If its lowest foot is far above or below the ground.
    """
    named, ground = named_pose(base.model), ground_height(base.model)
    if named is None or ground is None:
        return
    name, pose = named
    lowest = _lowest(base.model, feet, pose)
    if np.isfinite(lowest) and abs(lowest - ground) > MOST_DROP:
        raise RobotError(
            f"{file}: the {name} must stand on the ground, which is at z = {ground:.4g} m, but its lowest foot ends at "
            f"z = {lowest:.4g} m: {'lower' if lowest > ground else 'raise'} it by {abs(lowest - ground):.4g} m, or "
            "leave it out, and the robot stands in its reference pose."
        )


def ground_height(model: mujoco.MjModel) -> float | None:
    """Find the height of the ground (m): a static level plane, or the top of a static level box; ``None`` without one.

    The ground is the highest geom that the contact sensors refer to; without such sensors the highest plane.
    """
    data, types = mujoco.MjData(model), mujoco.mjtGeom
    mujoco.mj_kinematics(model, data)
    contact = model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT
    grounds = model.sensor_refid[contact & (model.sensor_reftype == mujoco.mjtObj.mjOBJ_GEOM)]
    planes = np.flatnonzero(model.geom_type == types.mjGEOM_PLANE)
    thickness = {int(types.mjGEOM_PLANE): 0.0, int(types.mjGEOM_BOX): 1.0}
    heights = [
        float(data.geom_xpos[geom, 2] + thickness[int(model.geom_type[geom])] * model.geom_size[geom, 2])
        for geom in (grounds if len(grounds) else planes)
        if int(model.geom_type[geom]) in thickness
        and model.body_weldid[model.geom_bodyid[geom]] == 0
        and data.geom_xmat[geom, 8] > 1.0 - 1e-9
    ]
    return max(heights, default=None)


def _lowest(model: mujoco.MjModel, feet: Sequence[int], qpos: np.ndarray) -> float:
    """Compute the height of the lowest point of the feet (m); infinite if they have no geom."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return lowest_point(model, data, [geom for foot in feet for geom in colliding_geoms(model, foot)])
