"""Numbers and rotations of a model, freed of what depends on how its MJCF spells them."""

from __future__ import annotations

import mujoco
import numpy as np

DIGITS = 9
# Where a row's numbers are cut. Written numbers are short decimals, which are far from it, so that a last bit that
# differs does not change the result.
CUT = 0.3183098861837907


def rounded(values: np.ndarray, digits: int = DIGITS) -> tuple[np.ndarray, np.ndarray]:
    """Return each row in units of the last of ``digits`` digits of its largest number.

    Args:
        values: Shape ``[*]`` or ``[*, K]``; each number of a shape ``[n]`` is a row of its own.
        digits: Number of digits.

    Returns:
        The power of ten of each row's last digit, and the numbers in units of it, whole.
    """
    rows = np.asarray(values, dtype=np.float64)
    rows = rows[..., None] if rows.ndim < 2 else rows
    rows = np.where(np.isfinite(rows), rows, np.sign(np.nan_to_num(rows)) * 1e300)
    largest = np.abs(rows).max(axis=-1, initial=0.0, keepdims=True)
    # A largest number of 0.9999999999 is 1 with an error of rounding.
    safe = np.where(largest > 1e-290, largest * (1 + 1e-12), 1.0)
    exponents = np.floor(np.log10(safe)).astype(np.int64) - digits + 1
    whole = np.floor(rows / 10.0 ** exponents.astype(np.float64) + CUT).astype(np.int64)
    return np.where(largest > 1e-290, exponents, 0), whole


def turns(quaternions: np.ndarray) -> np.ndarray:
    """Return quaternions with the sign that makes the first component that counts positive. Shape ``[n, 4]``."""
    return positive(np.asarray(quaternions, dtype=np.float64))


def positive(rows: np.ndarray) -> np.ndarray:
    """Return rows with the sign that makes the first component that counts positive. Shape ``[n, K]``."""
    counting = np.abs(rows) > 1e-6
    first = np.argmax(counting, axis=-1)
    signs = np.sign(np.take_along_axis(rows, first[:, None], axis=-1))
    return np.asarray(rows * np.where(signs == 0, 1.0, signs))


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """Return the rotation matrices of quaternions ``[n, 4]``. Shape ``[n, 3, 3]``."""
    rows = np.zeros((len(quaternions), 9))
    for matrix, quaternion in zip(rows, np.asarray(quaternions, dtype=np.float64), strict=True):
        mujoco.mju_quat2Mat(matrix, quaternion)
    return rows.reshape(-1, 3, 3)
