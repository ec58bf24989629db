"""Closed loops of a robot: poses and velocities that its equality constraints allow."""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np

from gctd3.robots.mjcf import driven_joints

_ROUNDS, _CLOSED = 50, 1e-10  # m or rad
_DRIVEN = 1e-3  # how readily a driven joint gives way, beside one that nothing drives


def close_loops(
    model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, joints: Collection[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest pose ``[nq]`` and velocities ``[nv]`` that the model's equality constraints allow.

    Joints that nothing drives give way, then driven ones; all others stay (Gauss and Newton's method).

    Args:
        model: The model.
        qpos: A pose, shape ``[nq]``.
        qvel: Velocities, shape ``[nv]``.
        joints: Indices of the joints that may give way.
    """
    if model.neq == 0:
        return qpos, qvel
    data, moved = mujoco.MjData(model), qpos.copy()
    driven, ease = set(driven_joints(model)), np.zeros(model.nv)
    for joint in joints:
        start = int(model.jnt_dofadr[joint])
        ease[start : start + {0: 6, 1: 3}.get(int(model.jnt_type[joint]), 1)] = _DRIVEN if joint in driven else 1.0
    for _ in range(_ROUNDS):
        gap, jacobian = _equalities(model, data, moved)
        if not gap.size or np.abs(gap).max() < _CLOSED:
            break
        mujoco.mj_integratePos(model, moved, -_least(jacobian, gap, ease), 1.0)
    gap, jacobian = _equalities(model, data, moved)
    if not gap.size:
        return qpos, qvel
    return moved, qvel - _least(jacobian, jacobian @ qvel, ease)


def _least(jacobian: np.ndarray, wanted: np.ndarray, ease: np.ndarray) -> np.ndarray:
    """Return the smallest change, weighed by ``ease``, that the Jacobian maps to the wanted one."""
    return np.asarray(ease * (np.linalg.pinv(jacobian * ease, rcond=1e-8) @ wanted))


def _equalities(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far each active equality constraint is open, shape ``[K]``, and its Jacobian, shape ``[K, nv]``."""
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    rows = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    if not mujoco.mj_isSparse(model):
        return data.efc_pos[rows].copy(), data.efc_J.reshape(-1, model.nv)[rows].copy()
    dense = np.zeros((len(rows), model.nv))
    for i, row in enumerate(rows):
        start, count = int(data.efc_J_rowadr[row]), int(data.efc_J_rownnz[row])
        dense[i, data.efc_J_colind[start : start + count]] = data.efc_J[start : start + count]
    return data.efc_pos[rows].copy(), dense
