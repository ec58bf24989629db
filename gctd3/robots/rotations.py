"""Rotations as matrices and as quaternions (w, x, y, z), by MuJoCo's conversions."""

from __future__ import annotations

import mujoco
import numpy as np


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Compute the matrix ``[3, 3]`` of a quaternion ``[4]`` of any length but 0."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion / np.linalg.norm(quaternion))
    return matrix.reshape(3, 3)


def rotation_quaternion(matrix: np.ndarray) -> np.ndarray:
    """Compute the quaternion ``[4]`` of a rotation's matrix ``[3, 3]``."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(matrix).reshape(9))
    return quaternion
