"""Pushes, payload and friction of a live walk have the effects that mechanics predicts."""

import mujoco
import numpy as np
import pytest
import torch
from compositions import walking
from tensordict.nn import TensorDictModule

from gctd3.robots.robot import Robot
from gctd3.viz.live_session import LiveWalk


def live(name="biped", endless=False, **settings):
    """Make a walk that stands: every servo in the middle of its range, but the biped's at straight legs."""
    robot = Robot.from_mjcf(name)
    low, high = robot.action_range.T
    still = torch.tensor(-(high + low) / (high - low) if name == "biped" else 0 * low, dtype=torch.float32)
    stand = TensorDictModule(lambda nodes: still.expand(*nodes.shape[:-2], -1), ["nodes"], ["action"])
    task = walking(robot, **settings)
    return LiveWalk(stand, task.without_end() if endless else task, seed=5)


def momentum(walk):
    """Return the whole robot's momentum, shape [3] (kg m/s)."""
    model, data = walk.robot.model, walk.show()
    mujoco.mj_subtreeVel(model, data)
    root = model.body(walk.robot.root).id
    return data.subtree_linvel[root] * model.body_subtreemass[root]


@pytest.mark.parametrize(
    "name, push, felt",
    [("biped", (3.0, 0.0), (3.0, 0.0)), ("biped", (0.0, 3.0), (0.0, 0.0)), ("quadruped", (-2.0, 5.0), (-2.0, 5.0))],
)
def test_a_push_adds_its_impulse_to_the_momentum(name, push, felt):
    walk = live(name)
    before = momentum(walk)
    walk.push(*push)
    np.testing.assert_allclose(momentum(walk) - before, [*felt, 0.0], atol=1e-9)
    # The robot keeps this momentum: in the air nothing stops it.
    assert walk.step().velocity * felt[0] >= 0.0


def test_a_payload_is_mass_and_can_be_taken_off():
    walk = live()
    mass = mujoco.mj_getTotalmass(walk.robot.model)
    walk.payload = 4.5
    assert walk.payload == 4.5 and mujoco.mj_getTotalmass(walk.robot.model) == pytest.approx(mass + 4.5)
    # The payload has inertia, so the same push moves the robot less.
    walk.push(3.0)
    heavy = momentum(walk)[0] / (mass + 4.5)
    walk.payload = 0.0
    walk.reset(5)
    before = momentum(walk)[0]
    walk.push(3.0)
    assert momentum(walk)[0] - before == pytest.approx(3.0)
    assert heavy < momentum(walk)[0] / mass


def test_friction_is_that_of_the_contacts():
    walk = live(endless=True)
    for _ in range(20):
        walk.step()
    for friction in (0.2, 1.3):
        walk.friction = friction
        contacts = walk.show().contact
        assert walk.friction == friction and len(contacts.friction) > 0
        np.testing.assert_allclose(contacts.friction[:, 0], friction)


def test_only_a_fall_ends_an_endless_walk():
    walk = live()
    while not walk.step().done:
        pass
    # 40 steps on a foot are allowed, and it takes a few to land.
    assert 0.8 < walk.now.time < 1.0 and not walk.now.success
    walk = live(endless=True)
    assert not any(walk.step().done for _ in range(200))
    assert live(endless=True, fall_height=0.5).step().done


def test_equal_seeds_equal_starts():
    walk = live()
    first = walk.reset(7).qpos
    walk.step()
    assert (walk.reset(8).qpos != first).any() and (walk.reset(7).qpos == first).all()
    assert walk.now.time == walk.now.total == 0.0


def test_it_keeps_out_of_the_callers_random_numbers():
    state = torch.get_rng_state()
    live().step()
    assert torch.equal(torch.get_rng_state(), state)
