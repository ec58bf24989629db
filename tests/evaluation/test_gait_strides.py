"""Strides, symmetry, periodicity and stability of made-up gaits whose numbers are known."""

import math

import numpy as np
import pytest
from contacts import signal, square

from gctd3.evaluation.gait_metrics import (
    DROPPED,
    circular_mean,
    duty_factor,
    floquet_multipliers,
    is_periodic,
    mean_stride,
    phase_offset,
    regularity,
    shifted_rms,
    stride_lag,
    stride_variation,
    strides,
    swing_clearance,
    symmetry_index,
    touchdowns,
)

# Strides.


def test_strides_by_hand():
    contact = signal("..####....####....####....####..")
    assert touchdowns(contact).tolist() == [2, 10, 18, 26]
    assert strides(contact, drop=0).tolist() == [[2, 10], [10, 18], [18, 26]]
    assert strides(contact).tolist() == [[18, 26]] and DROPPED == 2
    assert strides(signal("..####......"), drop=0).shape == (0, 2)
    assert strides(np.zeros(5, dtype=bool)).shape == (0, 2)


def test_variation_of_stride_times_by_hand():
    # Periods 8, 10, 12: mean 10, deviations -2, 0, 2, standard deviation sqrt(8 / 3).
    assert stride_variation(np.array([[0, 8], [8, 18], [18, 30]])) == pytest.approx(math.sqrt(8 / 3) / 10)
    assert math.isnan(stride_variation(np.array([[0, 8]])))


def test_which_gaits_are_periodic():
    even = strides(square(25, 300), drop=0)
    limping = np.array([[0, 10], [10, 40], [40, 50], [50, 80]])  # periods 10, 30, 10, 30: variation 0.5
    assert is_periodic([even, even])
    assert not is_periodic([even, even[:2]])
    assert not is_periodic([even, limping])
    assert not is_periodic([])


@pytest.mark.parametrize("duty", [0.4, 0.6, 0.8])
def test_duty_factor_of_a_square_wave(duty):
    contact = square(50, 600, duty)
    contact[touchdowns(contact) + 3] = False  # a bounce, which counts as contact
    assert duty_factor(contact, strides(contact)) == pytest.approx(duty)
    assert math.isnan(duty_factor(contact, np.zeros((0, 2), dtype=int)))


@pytest.mark.parametrize("lag, expected", [(25, 0.5), (0, 0.0), (10, 0.2), (40, 0.8)])
def test_phase_offset_of_a_shifted_foot(lag, expected):
    right, left = square(50, 800), square(50, 800, shift=-lag)
    assert phase_offset(strides(right), touchdowns(left)) == pytest.approx(expected)


def test_phase_offset_is_a_circular_mean():
    # Phases 0.9 and 0.1 of strides of 10 samples: their mean is 0, not 0.5.
    assert phase_offset(np.array([[0, 10], [10, 20]]), np.array([9, 11])) == pytest.approx(0.0)
    assert math.isnan(phase_offset(np.array([[0, 10]]), np.array([30])))


@pytest.mark.parametrize(
    ("phases", "mean"),
    [([0.98, 0.02, 0.97, 0.03], 0.0), ([0.9, 0.2], 0.05), ([0.4, 0.6, math.nan], 0.5), ([0.3], 0.3)],
)
def test_phases_go_round(phases, mean):
    assert circular_mean(phases) == pytest.approx(mean)
    assert math.isnan(circular_mean([math.nan]))


def test_clearance_in_the_middle_of_a_swing():
    #         0123456789012345
    contact = signal("####.....####.....")
    height = np.zeros(18)
    height[4:9] = [0.01, 0.03, 0.05, 0.02, 0.01]  # the middle of samples 4 to 8 is 6
    height[13:] = 0.5  # a swing without an end
    assert swing_clearance(height, contact) == pytest.approx(0.05)
    assert math.isnan(swing_clearance(height, np.ones(18, dtype=bool)))


# Symmetry.


def test_symmetry_index_by_hand():
    assert symmetry_index(1.2, 0.8) == pytest.approx(40.0)  # 0.4 over 1.0
    assert symmetry_index(0.8, 1.2) == pytest.approx(-40.0)
    assert symmetry_index(0.5, 0.5) == 0.0
    assert math.isnan(symmetry_index(0.0, 0.0))


def test_the_mean_stride_of_a_sine_is_a_sine():
    steps = np.array([[0, 50], [50, 100], [100, 150]])
    found = mean_stride(np.sin(2 * np.pi * np.arange(200) / 50), steps)
    assert found == pytest.approx(np.sin(2 * np.pi * np.arange(100) / 100), abs=2e-3)


def test_shifted_rms_of_legs_that_take_turns_and_of_legs_that_do_not():
    time = np.arange(400)
    steps = np.array([[k, k + 50] for k in range(50, 300, 50)])
    right = 0.3 * np.sin(2 * np.pi * time / 50) + 0.1 * np.cos(4 * np.pi * time / 50)
    turns = np.roll(right, 25)
    assert shifted_rms(right, turns, steps) == pytest.approx(0.0, abs=1e-12)
    # 0.05 rad more all the time.
    assert shifted_rms(right, turns + 0.05, steps) == pytest.approx(0.05)
    # In phase: sin against -sin, so the difference is 2 A sin, of RMS sqrt(2) A.
    sine = 0.3 * np.sin(2 * np.pi * time / 50)
    assert shifted_rms(sine, sine, steps) == pytest.approx(0.3 * math.sqrt(2), rel=2e-3)
    assert math.isnan(shifted_rms(sine, sine, np.zeros((0, 2), dtype=int)))


# Periodicity and stability.


def test_regularity_of_a_sine_at_its_period_and_at_half_of_it():
    waves = np.stack([np.sin(2 * np.pi * np.arange(500) / 50), np.cos(2 * np.pi * np.arange(500) / 25)], axis=1)
    assert regularity(waves, 50) == pytest.approx(1.0)
    assert regularity(waves[:, :1], 25) == pytest.approx(-1.0)
    assert abs(regularity(np.random.default_rng(0).normal(size=(5000, 2)), 50)) < 0.05
    assert math.isnan(regularity(waves, 251))
    assert math.isnan(regularity(np.ones((100, 2)), 10))


def test_the_stride_of_joints_is_found_without_contacts():
    time = np.arange(500)
    right, left = np.sin(2 * np.pi * time / 44), -np.sin(2 * np.pi * time / 44)
    assert stride_lag(np.stack([right, left], axis=1)) == 44
    # Steps that limp: the second of two is smaller, so that only both together repeat.
    limp = np.abs(right) * np.where(right > 0, 1.0, 0.4)
    assert stride_lag(limp[:, None]) == 44
    assert stride_lag(np.random.default_rng(0).normal(size=(300, 4))) is None
    assert stride_lag(np.linspace(0, 1, 100)[:, None]) is None
    assert stride_lag(np.ones((100, 2))) is None


def touchdown_states(matrix, episodes, count, noise, rng):
    made = []
    for _ in range(episodes):
        state, states = rng.normal(size=len(matrix)), []
        for _ in range(count):
            states.append(np.add(state, [0.7, -0.3, 2.0]))  # the cycle's own state
            state = matrix @ state + noise * rng.normal(size=len(matrix))
        made.append(np.array(states))
    return made


def test_multipliers_of_a_known_touchdown_map():
    rng = np.random.default_rng(0)
    turn = rng.normal(size=(3, 3))
    matrix = turn @ np.diag([0.8, -0.5, 0.1]) @ np.linalg.inv(turn)
    found = floquet_multipliers(touchdown_states(matrix, 200, 12, 0.05, rng))
    assert found == pytest.approx(np.array([0.8, -0.5, 0.1]), abs=0.02)


def test_multipliers_do_not_depend_on_units():
    rng = np.random.default_rng(1)
    states = touchdown_states(np.diag([0.9, 0.4, -0.2]), 50, 12, 0.05, rng)
    scaled = [section * [1000.0, 1.0, 0.01] for section in states]
    assert floquet_multipliers(scaled) == pytest.approx(floquet_multipliers(states))


def test_multipliers_of_an_unstable_and_of_a_repeating_gait():
    rng = np.random.default_rng(2)
    growing = floquet_multipliers(touchdown_states(np.diag([1.2, 0.3, 0.1]), 100, 10, 0.01, rng))
    assert abs(growing[0]) == pytest.approx(1.2, abs=0.02)
    assert floquet_multipliers([np.ones((30, 3))]) == pytest.approx(0.0)
    assert floquet_multipliers([rng.normal(size=(9, 3))]) is None  # 8 pairs, 9 are needed
    assert floquet_multipliers([]) is None
