"""The report's statistics equal hand arithmetic and rliable, and intervals cover as often as they should."""

import itertools

import numpy as np
import pytest

from gctd3.comparison.statistics import (
    REPETITIONS,
    Interval,
    bootstrap,
    higher,
    improvement,
    interval,
    intervals,
    iqm,
    profile,
)

# Runs of two groups, and what rliable 1.2.0 with arch 7.2.0 says of them: `pip install rliable 'pandas<3'`, then
# np.random.seed(0) before each library.get_interval_estimates(..., reps=2000), of metrics.aggregate_iqm for OURS, and
# of metrics.probability_of_improvement for [OURS, THEIRS], all with shape [R, 1].
OURS, THEIRS = [483.2, 532.1, 595.5, 486.6, 540.2], [551.6, 480.7, 591.4, 500.3]
IQM_OF_OURS, OURS_AHEAD = (519.6333333333333, 485.4666666666667, 574.3666666666667), (0.5, 0.0, 0.9)


def rliable():
    """Return rliable's library and metrics, for what is compared with them where rliable is installed."""
    pytest.importorskip("rliable")
    from rliable import library, metrics

    return library, metrics


def test_statistics_are_those_that_rliable_gave():
    found = interval(OURS)
    assert (found.value, found.low, found.high) == pytest.approx(IQM_OF_OURS, abs=1e-9)
    found = improvement(OURS, THEIRS)
    assert (found.value, found.low, found.high) == pytest.approx(OURS_AHEAD, abs=1e-9)


@pytest.mark.parametrize("count", [1, 3, 4, 5, 8, 10])
def test_iqm_is_rliables(count):
    _, metrics = rliable()
    scores = np.random.default_rng(count).normal(size=(count, 1))
    assert iqm(scores)[0] == pytest.approx(metrics.aggregate_iqm(scores))


@pytest.mark.nightly
@pytest.mark.parametrize("sizes", [(5,), (2,), (5, 4), (3, 7)])
def test_intervals_are_rliables(sizes):
    library, metrics = rliable()
    rng = np.random.default_rng(sum(sizes))
    groups = [rng.normal(500.0, 50.0, size=(size, 1)) for size in sizes]
    function = metrics.aggregate_iqm if len(groups) == 1 else metrics.probability_of_improvement
    state = np.random.get_state()
    np.random.seed(0)
    try:
        point, ends = library.get_interval_estimates(
            {"all": groups if len(groups) > 1 else groups[0]},
            lambda *drawn: np.array([function(*drawn)]),
            reps=REPETITIONS,
        )
    finally:
        np.random.set_state(state)
    ours = bootstrap(iqm if len(groups) == 1 else higher, *groups)
    assert ours[0] == pytest.approx(point["all"]) and ours[1] == pytest.approx(ends["all"])


@pytest.mark.parametrize("runs", [[0.0, 1.0], [0.0, 1.0, 10.0], [0.0, 1.0, 10.0, 100.0]])
def test_intervals_are_those_of_every_draw_there_is(runs):
    """Of R runs there are R^R equally likely draws: the ends lie between their percentiles on both sides of 2.5 %."""
    every = np.sort([iqm(np.array(drawn)) for drawn in itertools.product(runs, repeat=len(runs))])
    found = interval(runs)
    low, high = (np.percentile(every, ends, method="inverted_cdf") for ends in ((1.5, 3.5), (96.5, 98.5)))
    assert low[0] <= found.low <= low[1] and high[0] <= found.high <= high[1]


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
    _, metrics = rliable()
    assert higher(x, y)[0] == pytest.approx(metrics.probability_of_improvement(x, y))


def test_profile_by_hand():
    point, ends = profile([1.0, 2.0, 3.0, 4.0], np.array([0.0, 2.0, 3.5, 9.0]))
    assert point == pytest.approx([1.0, 0.5, 0.25, 0.0])
    assert (ends[0] <= point).all() and (point <= ends[1]).all()


def test_texts_of_intervals():
    assert Interval(1.25, 1.0, 2.0).text(2) == "1.25 [1.00, 2.00]"
    assert Interval(1.25, np.nan, np.nan).text() == "1.2"
    assert interval([]).text() == "undefined"
