"""Commands are redrawn after their time, by each robot's own clock, and alike from one seed."""

from types import SimpleNamespace

import numpy as np
import pytest
from compositions import walk, walking
from gaits import random_walk, sense

from gctd3.errors import ConfigError
from gctd3.tasks.commands import UniformCommand
from gctd3.tasks.measurement import put_rows
from gctd3.tasks.memory import EpisodeMemory

DT = 0.02


def memory_of(**commands):
    return EpisodeMemory({}, commands, SimpleNamespace(control_dt=DT, ground=None))


def after(memory, before, rng):
    return memory.advance(SimpleNamespace(before=before), rng)


def now(robots):
    return random_walk(np.random.default_rng(0), 1, (robots,))[0]


@pytest.mark.parametrize(
    ("every", "steps"),
    # 0.1 / 0.02 = 5 control steps; never less than one.
    [(0.1, 5), (0.06, 3), (0.02, 1), (0.001, 1), (5.0, 250)],
)
def test_a_command_holds_for_its_time(every, steps):
    memory, rng = memory_of(speed=UniformCommand(every=every)), np.random.default_rng(0)
    state = memory.begin(now(2), rng)
    assert state["command.speed.left"].tolist() == [steps, steps]
    first = state["command.speed"]
    assert first.shape == (2, 1)
    for t in range(1, steps):
        state = after(memory, state, rng)
        np.testing.assert_array_equal(state["command.speed"], first)
        assert state["command.speed.left"].tolist() == [steps - t] * 2
    state = after(memory, state, rng)
    assert (state["command.speed"] != first).all() and state["command.speed.left"].tolist() == [steps] * 2
    assert state["step"].tolist() == [steps] * 2


def test_by_hand():
    """Commands of two numbers for three robots equal the draws of a generator with the same seed, in order."""
    memory = memory_of(place=UniformCommand(every=0.04, low=(-1.0, 2.0), high=(1.0, 3.0)))
    rng, same = np.random.default_rng(7), np.random.default_rng(7)
    state = memory.begin(now(3), rng)
    drawn = [same.uniform((-1.0, 2.0), (1.0, 3.0), (3, 2)) for _ in range(2)]
    for t, index in enumerate([0, 0, 1, 1]):
        np.testing.assert_array_equal(state["command.place"], drawn[index])
        assert state["command.place.left"].tolist() == [2 - t % 2] * 3
        if t < 3:
            state = after(memory, state, rng)
    assert (state["command.place"] >= (-1.0, 2.0)).all() and (state["command.place"] <= (1.0, 3.0)).all()


def test_each_robot_has_its_own_clock():
    """Robot 1, which began anew later, gets its command when its own time is over, and no other robot does."""
    memory, rng = memory_of(speed=UniformCommand(every=0.06)), np.random.default_rng(0)
    state = memory.begin(now(3), rng)
    state = after(memory, state, rng)
    state = put_rows(state, np.array([1]), memory.begin(now(1), rng))
    lefts, changes = [], []
    for _ in range(5):
        before = state["command.speed"]
        state = after(memory, state, rng)
        lefts.append(state["command.speed.left"].tolist())
        changes.append((state["command.speed"] != before)[:, 0].tolist())
    assert lefts == [[1, 2, 1], [3, 1, 3], [2, 3, 2], [1, 2, 1], [3, 1, 3]]
    assert changes == [
        [False, False, False],
        [True, False, True],
        [False, True, False],
        [False, False, False],
        [True, False, True],
    ]


def test_what_others_get_does_not_depend_on_who_is_over():
    """Rows for all robots are drawn whenever one is due, and each due robot gets its own row."""
    memory = memory_of(speed=UniformCommand(every=0.04))
    held = np.array([[0.1], [0.2], [0.3]])
    drawn = np.random.default_rng(3).uniform((0.0,), (1.0,), (3, 1))
    for left in ([1, 5, 5], [5, 1, 5], [1, 1, 1]):
        before = {"step": np.zeros(3, np.int64), "command.speed": held, "command.speed.left": np.array(left)}
        state = after(memory, before, np.random.default_rng(3))
        over = np.array(left) == 1
        np.testing.assert_array_equal(state["command.speed"], np.where(over[:, None], drawn, held))
        assert state["command.speed.left"].tolist() == np.where(over, 2, np.array(left) - 1).tolist()
    # No command is due: nothing is drawn, so that the generator's state stays.
    rng = np.random.default_rng(3)
    after(memory, {**before, "command.speed.left": np.array([2, 3, 4])}, rng)
    assert rng.bit_generator.state == np.random.default_rng(3).bit_generator.state


def test_one_robot_has_no_leading_dimension(robot):
    task = walking(robot, commands={"speed": UniformCommand(every=0.04, low=(0.5,), high=(0.5,))})
    state = task.begin(sense(), np.random.RandomState(0))
    assert state["command.speed"].tolist() == [0.5] and state["command.speed.left"] == 2
    state, _ = task.advance(state, sense(), rng=np.random.RandomState(0))
    assert state["command.speed.left"] == 1


def test_a_command_without_a_generator_is_named(robot):
    task = walking(robot, commands={"speed": UniformCommand()})
    with pytest.raises(ValueError, match="The command 'speed' is drawn at random"):
        task.begin(sense())


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"every": 0.0}, "every must be above 0 s, got 0.0"),
        ({"low": (1.0,), "high": (0.5,)}, "low and high must hold as many numbers, low at most high"),
        ({"low": (0.0, 1.0), "high": (2.0,)}, "low and high must hold as many numbers"),
        ({"low": (), "high": ()}, "low and high must hold as many numbers"),
    ],
)
def test_wrong_commands_are_named(wrong, said):
    with pytest.raises(ConfigError, match=said):
        UniformCommand(**wrong)


def test_a_command_is_nothing_else():
    with pytest.raises(ConfigError, match=r"commands\.speed must be null or .* a Command, got 0\.5"):
        walk(commands={"speed": 0.5})
