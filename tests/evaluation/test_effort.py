"""Energy, speed, slip and smoothness of made-up motions whose numbers are known."""

import math

import numpy as np
import pytest

from gctd3.evaluation.effort import (
    action_jerk,
    action_rate,
    action_smoothness,
    cost_of_transport,
    froude_number,
    mechanical_work,
    slip_speed,
)


def test_work_by_hand():
    # Powers 6 and -4 W, then 2 and 0 W, for 0.5 s each: 12 W and 8 W in all.
    torque, speed = np.array([[2.0, -4.0], [1.0, 5.0]]), np.array([[3.0, 1.0], [2.0, 0.0]])
    assert mechanical_work(torque, speed, 0.5) == pytest.approx((6.0, 4.0))


def test_cost_of_transport_by_hand():
    # 98.1 J carry 5 kg over 10 m: 98.1 / (5 * 9.81 * 10).
    assert cost_of_transport(98.1, 5.0, 10.0) == pytest.approx(0.2)
    assert cost_of_transport(10.0, 5.0, 2.0, gravity=1.0) == pytest.approx(1.0)
    assert math.isnan(cost_of_transport(10.0, 5.0, 0.0))


def test_froude_number_by_hand():
    assert froude_number(2.0, 0.5, gravity=8.0) == pytest.approx(1.0)
    assert froude_number(1.2, 0.9) == pytest.approx(1.44 / (9.81 * 0.9))


def test_slip_leaves_out_landing_and_leaving():
    contact = np.array([0, 0, 0, 1, 1, 1, 1, 1, 0, 0, 0], dtype=bool)
    speed = np.array([9.0, 9, 9, 5, 0.1, 0.2, 0.3, 7, 9, 9, 9])
    assert slip_speed(speed, contact) == pytest.approx(0.2)
    assert math.isnan(slip_speed(speed, np.zeros(11, dtype=bool)))


def test_differences_of_polynomials():
    time = np.arange(50)[:, None] * 0.02
    assert action_rate(3.0 * time, 0.02) == pytest.approx(3.0)
    # The third difference of t^3 over dt^3 is 3! = 6.
    assert action_jerk(time**3, 0.02) == pytest.approx(6.0)
    assert action_jerk(2.0 * time**2 - time, 0.02) == pytest.approx(0.0, abs=1e-6)
    assert math.isnan(action_jerk(time[:3], 0.02))


@pytest.mark.parametrize("amplitude, cycles", [(0.5, 4), (0.25, 10)])
def test_smoothness_of_a_sine(amplitude, cycles):
    # 100 samples at 50 Hz, 50 frequencies above zero; a sine of c cycles has c / 2 Hz.
    time = np.arange(100) * 0.02
    wave = amplitude * np.sin(2 * np.pi * cycles / 2 * time)
    expected = 2 * amplitude * (cycles / 2) / (50 * 50)
    assert action_smoothness(np.stack([wave, wave + 0.3], axis=1), 0.02) == pytest.approx(expected)
    assert action_smoothness(np.full((100, 2), 0.4), 0.02) == pytest.approx(0.0, abs=1e-12)
