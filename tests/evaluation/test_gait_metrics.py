"""Gait metrics on made-up gaits whose numbers are known."""

import math

import numpy as np
import pytest
from contacts import signal, square
from hypothesis import given
from hypothesis import strategies as st

from gctd3.evaluation.gait_metrics import correlation, debounce, stride_frequency, support_fractions, touchdowns

DT = 0.02


def marks(contact):
    return "".join("#" if down else "." for down in contact)


# Correlation.


@pytest.mark.parametrize("shift, expected", [(0.0, 1.0), (0.5, -1.0), (0.25, 0.0), (1 / 6, 0.5)])
def test_correlation_of_sines_is_the_cosine_of_their_shift(shift, expected):
    cycles = np.arange(200) / 50  # four whole periods
    left, right = np.sin(2 * np.pi * cycles), np.sin(2 * np.pi * (cycles + shift))
    assert correlation(left, right) == pytest.approx(expected, abs=1e-12)
    # Neither offset nor amplitude matters, the sign of a signal does.
    assert correlation(3.0 * left - 0.4, 0.2 * right + 5.0) == pytest.approx(expected, abs=1e-12)
    assert correlation(-left, right) == pytest.approx(-expected, abs=1e-12)


def test_correlation_by_hand():
    # Deviations (-1, 0, 1) and (-2, -1, 3): products 2 + 0 + 3 = 5, sizes sqrt(2) and sqrt(14).
    assert correlation(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 5.0])) == pytest.approx(5 / math.sqrt(28))


@pytest.mark.parametrize("constant", [0.0, 0.25, 0.1])
def test_correlation_with_a_constant_is_undefined(constant):
    wave = np.sin(np.arange(50.0))
    assert math.isnan(correlation(wave, np.full(50, constant)))
    assert math.isnan(correlation(np.full(50, constant), wave))


# Support.


def test_support_fractions_by_hand():
    right, left = signal("##### ....."), signal("###.. ..###")
    # none: 5, 6; one: 3, 4, 7, 8, 9; both: 0, 1, 2.
    assert support_fractions(np.stack([right, left], axis=1)) == pytest.approx((0.2, 0.5, 0.3))


def test_support_fractions_count_more_than_two_feet_as_more():
    feet = np.stack([signal("##."), signal("##."), signal("#.#")], axis=1)
    assert support_fractions(feet) == pytest.approx((0.0, 1 / 3, 2 / 3))


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=30))
def test_support_fractions_sum_to_one(contacts):
    assert sum(support_fractions(np.array(contacts))) == pytest.approx(1.0)


# Touchdowns.


@pytest.mark.parametrize(
    "noisy, clean",
    [
        ("....####....", "....####...."),
        ("..##.####...", "..#######..."),  # a bounce of one sample
        ("..##..###...", "..#######..."),  # of two
        ("..##...##...", "............"),  # three samples up are a step, and touches of two samples are noise
        ("..###...##..", "..###......."),
        ("..#.....####", "........####"),  # a scuff
        ("##....######", "##....######"),  # the lengths of the first and the last stretch are unknown
        ("######....##", "######....##"),
        ("#.####.....#", "######.....#"),
        ("............", "............"),
        ("############", "############"),
    ],
)
def test_debounce_by_hand(noisy, clean):
    contact = signal(noisy)
    assert marks(debounce(contact)) == clean
    assert marks(contact) == noisy  # the input is unchanged


def test_debounce_by_other_lengths():
    assert marks(debounce(signal("..##.####..."), gap=0, touch=0)) == "..##.####..."
    assert marks(debounce(signal("###....####.#."), gap=4)) == "#############."
    assert marks(debounce(signal("...####.....#"), touch=4)) == "............#"
    assert marks(debounce(signal("...####....#####..."), gap=4)) == "...#############..."
    assert marks(debounce(signal("...####.....####..."), gap=4)) == "...####.....####..."


def test_touchdowns_by_hand():
    assert touchdowns(signal("...####....####..")).tolist() == [3, 11]
    assert touchdowns(signal("####....####")).tolist() == [8]  # it does not begin with a touchdown
    assert touchdowns(signal("...##.###....####")).tolist() == [3, 13]  # a bounce is not a second touchdown
    assert touchdowns(signal(".....")).tolist() == []


# Strides.


@pytest.mark.parametrize("period", [20, 25, 40])
def test_stride_frequency_of_a_known_period(period):
    feet = np.stack([square(period, 10 * period), square(period, 10 * period, shift=period // 2)], axis=1)
    assert stride_frequency(feet, DT) == pytest.approx(1.0 / (period * DT))
    assert stride_frequency(feet, DT / 2) == pytest.approx(2.0 / (period * DT))


def test_chatter_does_not_make_strides():
    feet = np.stack([square(25, 500), square(25, 500, shift=12)], axis=1)
    rng = np.random.default_rng(0)
    for foot in feet.T:
        for touchdown in touchdowns(foot):
            if rng.random() < 0.5:
                foot[touchdown + 2] = False  # a bounce of one sample, two samples in
            if rng.random() < 0.3:
                foot[touchdown - 5] = True  # a scuff of one sample, before
    assert (np.diff(np.flatnonzero(np.diff(feet[:, 0].astype(int)) == 1)) < 25).any()
    assert stride_frequency(feet, DT) == pytest.approx(1.0 / (25 * DT))


def test_one_long_stride_does_not_change_the_median():
    # Touchdowns at 5, 25, 45, 85, 105, 125: periods 20, 20, 40, 20, 20.
    foot = np.zeros(140, dtype=bool)
    for touchdown in (5, 25, 45, 85, 105, 125):
        foot[touchdown : touchdown + 10] = True
    assert stride_frequency(foot[:, None], DT) == pytest.approx(1.0 / (20 * DT))


def test_feet_are_pooled():
    # Right: periods of 20 and 20; left: of 30. Median 20.
    right, left = np.zeros(80, dtype=bool), np.zeros(80, dtype=bool)
    for touchdown in (5, 25, 45):
        right[touchdown : touchdown + 10] = True
    for touchdown in (10, 40):
        left[touchdown : touchdown + 10] = True
    assert stride_frequency(np.stack([right, left], axis=1), DT) == pytest.approx(1.0 / (20 * DT))


@pytest.mark.parametrize(
    "feet",
    [
        np.zeros((50, 2), dtype=bool),
        np.ones((50, 2), dtype=bool),
        square(20, 50)[:, None],  # down from the start, touchdowns at 20 and 40: one stride
        np.zeros((0, 2), dtype=bool),
        np.zeros((50, 0), dtype=bool),
    ],
    ids=["in the air", "standing", "one stride", "no time", "no feet"],
)
def test_fewer_than_two_strides_have_no_frequency(feet):
    assert math.isnan(stride_frequency(feet, DT))
