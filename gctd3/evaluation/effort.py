"""Effort of a gait: energy, speed, slip, smoothness.

NumPy in, floats out; units and sources stand in each docstring. :mod:`.gait_metrics` has the gait itself.
"""

from __future__ import annotations

import numpy as np

from gctd3.evaluation.gait_metrics import debounce

# m/s^2; here too, since this file needs NumPy alone.
GRAVITY = 9.81


def mechanical_work(torque: np.ndarray, speed: np.ndarray, dt: float) -> tuple[float, float]:
    """Compute work of all joints (J): ``sum |tau w| dt``, braking counted as driving, and ``sum max(tau w, 0) dt``.

    Args:
        torque: Torque of each joint at each sample, shape ``[*, J]`` (N m).
        speed: Velocity of the same joints, shape ``[*, J]`` (rad/s).
        dt: Time between samples (s).
    """
    power = torque * speed
    return float(np.abs(power).sum() * dt), float(np.maximum(power, 0.0).sum() * dt)


def cost_of_transport(work: float, mass: float, distance: float, gravity: float = GRAVITY) -> float:
    """Compute the cost of transport ``E / (m g d)``, without unit (Torricelli et al. 2015).

    People walk at about 0.2, of metabolic energy. NaN if the robot did not move forward.

    Args:
        work: ``E`` (J), either of :func:`mechanical_work`.
        mass: ``m``, mass of the robot (kg).
        distance: ``d``, distance walked (m).
        gravity: ``g`` (m/s^2).
    """
    return float(work / (mass * gravity * distance)) if distance > 0 else float("nan")


def froude_number(velocity: float, leg: float, gravity: float = GRAVITY) -> float:
    """Compute the Froude number ``v^2 / (g L)``, without unit (Alexander 1984).

    It is equal for animals of any size that move alike; walking ends at 1.

    Args:
        velocity: ``v`` (m/s).
        leg: ``L``, height of the hip above the ground when standing (m).
        gravity: ``g`` (m/s^2).
    """
    return float(velocity**2 / (gravity * leg))


def slip_speed(speed: np.ndarray, contact: np.ndarray) -> float:
    """Compute the mean horizontal speed of a foot's sole over the ground while it is down (m/s); 0 without slip.

    The first and the last sample of a contact are left out, in which the foot is landing or lifting off. NaN if no
    samples remain.

    Args:
        speed: Horizontal speed of the sole's lowest point, shape ``[T]`` (m/s).
        contact: Contact of the foot, shape ``[T]``.
    """
    clean = debounce(contact)
    inside = clean[1:-1] & clean[:-2] & clean[2:]
    return float(speed[1:-1][inside].mean()) if inside.any() else float("nan")


def action_rate(action: np.ndarray, dt: float) -> float:
    """Compute the RMS of the first difference of actions ``[T, A]`` over ``dt`` (1/s; actions have no unit)."""
    return _rms_difference(action, dt, 1)


def action_jerk(action: np.ndarray, dt: float) -> float:
    """Compute the RMS of the third difference of actions ``[T, A]`` over ``dt^3`` (1/s^3); Flash & Hogan 1985."""
    return _rms_difference(action, dt, 3)


def action_smoothness(action: np.ndarray, dt: float) -> float:
    """Compute ``2 / (n f_s) sum_i M_i f_i`` over the spectrum of actions ``[T, A]``, mean over ``A``; lower: smoother.

    ``M_i`` is the amplitude at frequency ``f_i`` of ``n`` up to half the sampling frequency ``f_s = 1 / dt``, about the
    mean action (Mysore et al. 2021, CAPS). A sine of amplitude ``M`` and frequency ``f`` has ``2 M f / (n f_s)``.
    """
    steps = len(action)
    if steps < 2:
        return float("nan")
    amplitude = np.abs(np.fft.rfft(action - action.mean(axis=0), axis=0))[1:] * (2.0 / steps)
    frequency = np.fft.rfftfreq(steps, dt)[1:, None]
    return float((2.0 * dt / len(frequency) * (amplitude * frequency).sum(axis=0)).mean())


def _rms_difference(action: np.ndarray, dt: float, order: int) -> float:
    difference = np.diff(action, n=order, axis=0)
    return float(np.sqrt(np.mean(np.square(difference))) / dt**order) if difference.size else float("nan")
