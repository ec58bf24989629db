"""The walking task on random measurements gives the same numbers for many robots at once, and in the mirror."""

from dataclasses import fields, replace

import numpy as np
import pytest
from compositions import reward, walking
from gaits import LEFT, RIGHT, random_walk, values, walk
from hypothesis import given
from hypothesis import strategies as st

from gctd3.tasks.measurement import Measurement, put_rows

SHAPED = reward(antiphase=0.3, single_support=0.2, overspeed=0.5, swing=2.0)
SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS)
def test_a_batch_is_its_robots_one_by_one(robot, seed):
    task, n = walking(robot, SHAPED, contact_steps=3, hip_steps=3, time_limit=8), 3
    steps = random_walk(np.random.default_rng(seed), 10, (n,))
    batch_memory, batch_outcomes = walk(task, *steps)
    for i in range(n):
        rows = [Measurement(*(getattr(now, f.name)[i] for f in fields(now))) for now in steps]
        memory, outcomes = walk(task, *rows)
        np.testing.assert_array_equal(task.node_features(steps[-1])[i], task.node_features(rows[-1]))
        np.testing.assert_array_equal(task.counters(batch_memory)[i], task.counters(memory))
        assert batch_memory.keys() == memory.keys()
        for name, values_of_all in batch_memory.items():
            np.testing.assert_array_equal(values_of_all[i], memory[name], err_msg=name)
        for many, one in zip(batch_outcomes, outcomes, strict=True):
            assert [term[i] for term in many.terms.values()] == pytest.approx(values(one))
            for name in ("terminated", "truncated", "success"):
                assert getattr(many, name)[i] == getattr(one, name), name


@pytest.mark.nightly
@given(SEEDS)
def test_a_mirrored_walk_is_worth_the_same(robot, graph, seed):
    task = walking(robot, SHAPED, contact_steps=3, hip_steps=3)
    steps = random_walk(np.random.default_rng(seed), 10, ())
    left_first = [3, 4, 5, 0, 1, 2]
    order = {"angles": left_first, "velocities": left_first, "feet_down": [LEFT, RIGHT]}
    mirrored = [replace(now, **{k: getattr(now, k)[o] for k, o in order.items()}) for now in steps]
    memory, outcomes = walk(task, *steps)
    other_memory, other_outcomes = walk(task, *mirrored)
    np.testing.assert_array_equal(task.counters(other_memory), task.counters(memory)[[1, 0, 3, 2]])
    swapped = task.node_features(steps[-1])[list(graph.mirror)]
    swapped[-1] = swapped[-1, ::-1]
    np.testing.assert_array_equal(task.node_features(mirrored[-1]), swapped)
    for here, there in zip(outcomes, other_outcomes, strict=True):
        assert values(here) == pytest.approx(values(there))
        assert here.terminated == there.terminated


def test_put_replaces_the_chosen_robots_and_leaves_the_original(task):
    first, second = random_walk(np.random.default_rng(0), 2, (3,))
    old, _ = task.advance(task.begin(first), second)
    before = {name: values.copy() for name, values in old.items()}
    (one,) = random_walk(np.random.default_rng(1), 1, (1,))
    new = task.begin(one)
    merged = put_rows(old, np.array([1]), new)
    for name in old:
        np.testing.assert_array_equal(old[name], before[name], err_msg=name)
        np.testing.assert_array_equal(merged[name][[1]], new[name], err_msg=name)
        np.testing.assert_array_equal(merged[name][[0, 2]], old[name][[0, 2]], err_msg=name)
