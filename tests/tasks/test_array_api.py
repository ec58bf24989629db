"""Terms give the same numbers on arrays of NumPy and on tensors of PyTorch, for one robot and for many."""

import inspect
import itertools
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from compositions import walking
from own_terms import FollowSpeed, MissedSpeed

from gctd3.robots.robot import Robot
from gctd3.tasks import motor_terms, reward_terms, terminations, velocity_terms
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.terminations import STEPS
from gctd3.tasks.terms import RewardTerm, Step, Termination


def of(module, kind):
    """Return every term of a kind that a module defines."""
    found = [item for _, item in inspect.getmembers(module, inspect.isclass) if item.__module__ == module.__name__]
    return [item for item in found if issubclass(item, kind) and not inspect.isabstract(item)]


# The shipped terms, with limits that are reached within a few steps.
SOONER = {"LongContact": {"steps": 2}, "StuckHip": {"steps": 3}, "TimeLimit": {"steps": 8}, "SwingTime": {"most": 0.02}}
SOONER["SwingTime"]["least"], SOONER["Survive"] = 0.02, {"steps": 9}
REWARDS = {
    kind.__name__: kind(**SOONER.get(kind.__name__, {}))
    for module in (reward_terms, motor_terms, velocity_terms)
    for kind in of(module, RewardTerm)
}
ENDS = {kind.__name__: kind(**SOONER.get(kind.__name__, {})) for kind in of(terminations, Termination)}
# The custom terms of the tests, written like a user's.
REWARDS["FollowSpeed"], ENDS["MissedSpeed"] = FollowSpeed(), MissedSpeed(steps=2)
CONSTANT = {"Living"}


def test_there_is_something_to_test():
    assert {"ForwardVelocity", "Progress", "SwingTime", "OffLine"} <= set(REWARDS) and len(REWARDS) >= 13
    assert {"Fall", "LongContact", "StuckHip", "Finish", "TimeLimit"} <= set(ENDS)


@pytest.fixture(scope="module", params=["biped", "quadruped"])
def facts(request):
    # As if the feet's velocities were measured, so that every term applies.
    return replace(walking(Robot.from_mjcf(request.param)).facts, foot_velocities=True)


def measurements(facts, shape, steps=40):
    """Draw random measurements that cross every threshold now and then."""
    rng = np.random.default_rng(0)
    return [
        Measurement(
            position=np.asarray(rng.uniform(0.0, 18.0, shape)),
            height=np.asarray(rng.uniform(-0.12, 0.1, shape)),
            velocity=np.asarray(rng.uniform(-1.0, 2.0, shape)),
            angles=rng.uniform(-1.0, 1.0, (*shape, facts.joints)),
            velocities=rng.uniform(-7.0, 7.0, (*shape, facts.joints)),
            feet_down=rng.uniform(size=(*shape, facts.feet)) < 0.6,
            other_down=np.asarray(rng.uniform(size=shape) < 0.1),
            shank_down=np.asarray(rng.uniform(size=shape) < 0.1),
            base=rng.uniform(-0.5, 0.5, (*shape, len(facts.base), 2)),
            tilt=np.asarray(rng.uniform(0.0, 1.0, shape)),
            feet_velocity=rng.uniform(-1.0, 1.0, (*shape, facts.feet, 3)),
        )
        for _ in range(steps)
    ]


def played(facts, seen, convert):
    """Return the memory, terminations and rewards of every step, in the library that ``convert`` converts to."""
    rng, shape = np.random.default_rng(1), seen[0].position.shape
    rewards = {name: term for name, term in REWARDS.items() if term.applies(facts)}
    asked = {one.name: one for term in (*rewards.values(), *ENDS.values()) for one in term.remembers()}
    taken = [Measurement(**{f.name: convert(getattr(now, f.name)) for f in fields(now)}) for now in seen]
    command = {"command.speed": convert(rng.uniform(0.0, 1.0, (*shape, 1)))}
    command["command.velocity"] = convert(np.zeros((*shape, 3)))  # to stand
    memory = {name: one.begin(taken[0], facts) for name, one in asked.items()}
    memory |= {STEPS: convert(np.zeros(shape, dtype=np.int64)), **command}
    found = [{"memory": memory}]
    for now in taken[1:]:
        action = convert(rng.uniform(-1.0, 1.0, (*shape, facts.actions)))
        diverged = convert(np.asarray(rng.uniform(size=shape) < 0.1))
        step = Step(now, memory, {}, action, diverged, facts, {})
        after = {name: one.update(memory[name], step) for name, one in asked.items()}
        memory = {**after, STEPS: memory[STEPS] + 1, **command}
        step = replace(step, after=memory)
        ends = {name: term(step) for name, term in ENDS.items()}
        clocks = {name: term.clock(memory, facts, 100) for name, term in ENDS.items()}
        step = replace(step, ended={**ends, "fall": ends["Fall"]})
        pays = {name: term(step) for name, term in rewards.items()}
        shown = {name: clock for name, clock in clocks.items() if clock is not None}
        found.append({"memory": memory, "ends": ends, "clocks": shown, "pays": pays})
    return found


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_numpy_and_torch_agree(facts, shape):
    seen = measurements(facts, shape)
    ours, theirs = played(facts, seen, np.asarray), played(facts, seen, lambda values: torch.as_tensor(values))
    values = {}
    for here, there in zip(ours, theirs, strict=True):
        for part in here:
            assert here[part].keys() == there[part].keys()
            for name, value in here[part].items():
                tensor, where = there[part][name], f"{part} {name}"
                assert isinstance(tensor, torch.Tensor), where
                assert np.shape(value) == tuple(tensor.shape), where
                # Booleans and counts keep their kind of type.
                assert np.asarray(value).dtype.kind == tensor.numpy().dtype.kind, where
                np.testing.assert_allclose(tensor.numpy(), value, rtol=0, atol=1e-6, err_msg=where)
                values.setdefault((part, name), []).append(np.asarray(value))
    # The values are not equal merely because nothing happened.
    for (part, name), found in values.items():
        if part in ("ends", "pays") and name not in CONSTANT:
            assert np.stack(found).std() > 0, f"{part} {name}"
            assert part == "pays" or np.shape(found[0]) == shape


def test_what_is_remembered_is_left_as_it_was(facts):
    """No array of the memory changes in place: the next step may still read it."""
    seen = measurements(facts, (3,))
    for convert in (np.array, torch.tensor):
        memories = [step["memory"] for step in played(facts, seen, convert)]
        again = [step["memory"] for step in played(facts, seen, convert)]
        for one, other in zip(memories, again, strict=True):
            for name in one:
                assert (one[name] == other[name]).all(), name
        for before, after in itertools.pairwise(memories):
            for name in set(before) - {"command.speed", "command.velocity"}:
                assert before[name] is not after[name], name
