"""The report's statistics equal hand arithmetic and rliable, and intervals cover as often as they should."""

import numpy as np
import pytest

pytest.importorskip("rliable")
from rliable import metrics

from gctd3.comparison.statistics import Interval, higher, improvement, interval, intervals, iqm, profile


@pytest.mark.parametrize("count", [1, 3, 4, 5, 8, 10])
def test_iqm_is_rliables(count):
    scores = np.random.default_rng(count).normal(size=(count, 1))
    assert iqm(scores)[0] == pytest.approx(metrics.aggregate_iqm(scores))


def test_iqm_by_hand():
    # Of eight values the lowest two and the highest two are left out: (3 + 4 + 5 + 6) / 4.
    assert interval([1, 2, 3, 4, 5, 6, 700, 800]).value == pytest.approx(4.5)
    assert interval([5.0, np.nan]).value == 5.0 and np.isnan(interval([5.0]).low)
    assert np.isnan(interval([]).value)


def test_an_interval_holds_most_of_what_repetition_gives():
    rng, inside = np.random.default_rng(0), 0
    for _ in range(20):
        found = interval(rng.normal(10.0, 2.0, size=10).tolist())
        inside += found.low <= 10.0 <= found.high
    assert 15 <= inside <= 20


def test_numbers_of_a_run_stay_together():
    scores = np.random.default_rng(1).normal(size=(6, 1))
    point, ends = intervals(np.repeat(scores, 4, axis=1))
    assert np.ptp(point) == 0 and (np.ptp(ends, axis=1) == 0).all()
    state = np.random.get_state()[1].copy()
    again = intervals(np.repeat(scores, 4, axis=1))
    assert (again[1] == ends).all() and (np.random.get_state()[1] == state).all()


def test_probability_of_improvement_by_hand():
    # Of the pairs (1, 2) (1, 0) (3, 2) (3, 0) three are won.
    found = improvement([1.0, 3.0], [2.0, 0.0])
    assert found.value == 0.75 and 0.0 <= found.low <= 0.75 <= found.high <= 1.0
    assert improvement([1.0, 1.0], [1.0, 1.0]).value == 0.5
    x, y = np.random.default_rng(2).normal(size=(2, 7, 1))
    assert higher(x, y)[0] == pytest.approx(metrics.probability_of_improvement(x, y))


def test_profile_by_hand():
    point, ends = profile([1.0, 2.0, 3.0, 4.0], np.array([0.0, 2.0, 3.5, 9.0]))
    assert point == pytest.approx([1.0, 0.5, 0.25, 0.0])
    assert (ends[0] <= point).all() and (point <= ends[1]).all()


def test_texts_of_intervals():
    assert Interval(1.25, 1.0, 2.0).text(2) == "1.25 [1.00, 2.00]"
    assert Interval(1.25, np.nan, np.nan).text() == "1.2"
    assert interval([]).text() == "undefined"
