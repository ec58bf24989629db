"""The walking task on random measurements: many robots at once, and in the mirror."""

from dataclasses import fields, replace

import numpy as np
import pytest
from gaits import LEFT, RIGHT, random_walk, values, walk
from hypothesis import given
from hypothesis import strategies as st

from gctd3.tasks.reward import Endings, Reward
from gctd3.tasks.step_records import Measurement, Progress, put
from gctd3.tasks.walk import WalkingTask

SHAPED = Reward(antiphase=0.3, single_support=0.2, overspeed=0.5, short_swing=2.0, long_swing=2.0)
SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS)
def test_a_batch_is_its_robots_one_by_one(robot, seed):
    task, n = WalkingTask(robot, SHAPED, Endings(contact_steps=3, hip_steps=3, time_limit=8)), 3
    steps = random_walk(np.random.default_rng(seed), 10, (n,))
    batch_progress, batch_outcomes = walk(task, *steps)
    for i in range(n):
        rows = [Measurement(*(getattr(now, f.name)[i] for f in fields(now))) for now in steps]
        progress, outcomes = walk(task, *rows)
        np.testing.assert_array_equal(task.node_features(steps[-1])[i], task.node_features(rows[-1]))
        np.testing.assert_array_equal(task.counters(batch_progress)[i], task.counters(progress))
        for name in (f.name for f in fields(Progress)):
            np.testing.assert_array_equal(getattr(batch_progress, name)[i], getattr(progress, name), err_msg=name)
        for many, one in zip(batch_outcomes, outcomes, strict=True):
            assert [term[i] for term in many.terms.values()] == pytest.approx(values(one))
            for name in ("terminated", "truncated", "success"):
                assert getattr(many, name)[i] == getattr(one, name), name


@given(SEEDS)
def test_a_mirrored_walk_is_worth_the_same(robot, graph, seed):
    task = WalkingTask(robot, SHAPED, Endings(contact_steps=3, hip_steps=3))
    steps = random_walk(np.random.default_rng(seed), 10, ())
    left_first = [3, 4, 5, 0, 1, 2]
    order = {"angles": left_first, "velocities": left_first, "feet_down": [LEFT, RIGHT]}
    mirrored = [replace(now, **{k: getattr(now, k)[o] for k, o in order.items()}) for now in steps]
    progress, outcomes = walk(task, *steps)
    other_progress, other_outcomes = walk(task, *mirrored)
    np.testing.assert_array_equal(task.counters(other_progress), task.counters(progress)[[1, 0, 3, 2]])
    swapped = task.node_features(steps[-1])[list(graph.mirror)]
    swapped[-1] = swapped[-1, ::-1]
    np.testing.assert_array_equal(task.node_features(mirrored[-1]), swapped)
    for here, there in zip(outcomes, other_outcomes, strict=True):
        assert values(here) == pytest.approx(values(there))
        assert here.terminated == there.terminated


def test_put_replaces_the_chosen_robots_and_leaves_the_original(task):
    first, second = random_walk(np.random.default_rng(0), 2, (3,))
    old, _ = task.advance(task.begin(first), second)
    before = {f.name: getattr(old, f.name).copy() for f in fields(Progress)}
    (one,) = random_walk(np.random.default_rng(1), 1, (1,))
    new = task.begin(one)
    merged = put(old, np.array([1]), new)
    for name in (f.name for f in fields(Progress)):
        np.testing.assert_array_equal(getattr(old, name), before[name], err_msg=name)
        np.testing.assert_array_equal(getattr(merged, name)[[1]], getattr(new, name), err_msg=name)
        np.testing.assert_array_equal(getattr(merged, name)[[0, 2]], getattr(old, name)[[0, 2]], err_msg=name)
