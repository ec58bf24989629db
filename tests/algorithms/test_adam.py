"""Our Adam takes PyTorch's steps, keeps PyTorch's state, and survives what happens to an optimiser in a training."""

import copy

import pytest
import torch
from torch import nn

from gctd3.algorithms.adam import Adam


def parameters():
    torch.manual_seed(0)
    return [nn.Parameter(torch.randn(shape)) for shape in ((3, 4), (3,), (2, 5, 3), ())]


def descend(optimizers, sets, steps):
    for step in range(steps):
        for optimizer, those in zip(optimizers, sets, strict=True):
            optimizer.zero_grad()
            assert all(p.grad is None for p in those)
            sum((p * (i + step)).sin().sum() for i, p in enumerate(those)).backward()
            optimizer.step()


def check_same(optimizers, sets):
    for one, other in zip(*sets, strict=True):
        assert torch.equal(one, other)
        ours, theirs = (optimizer.state[p] for optimizer, p in zip(optimizers, (one, other), strict=True))
        assert ours.keys() == theirs.keys()
        assert all(torch.equal(ours[key], theirs[key]) for key in ours)


@pytest.fixture
def pair():
    sets = parameters(), parameters()
    return (Adam(sets[0], lr=0.01), torch.optim.Adam(sets[1], lr=0.01, fused=True)), sets


def test_steps_and_state_are_pytorchs(pair):
    optimizers, sets = pair
    descend(optimizers, sets, 5)
    check_same(optimizers, sets)


def test_a_learning_rate_that_changes_is_followed(pair):
    optimizers, sets = pair
    schedules = [torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.5) for optimizer in optimizers]
    for _ in range(3):
        descend(optimizers, sets, 2)
        for schedule in schedules:
            schedule.step()
    check_same(optimizers, sets)


def test_a_restored_state_goes_on_from_there(pair):
    optimizers, sets = pair
    descend(optimizers, sets, 3)
    saved = copy.deepcopy(optimizers[0].state_dict())
    values = [p.detach().clone() for p in sets[0]]
    descend(optimizers, sets, 4)
    # Load the state into PyTorch's Adam and into ours, which has taken other steps since.
    for optimizer, those in zip(optimizers, sets, strict=True):
        for parameter, value in zip(those, values, strict=True):
            parameter.data.copy_(value)
        optimizer.load_state_dict(copy.deepcopy(saved))
    descend(optimizers, sets, 2)
    check_same(optimizers, sets)
    (steps,) = {float(state["step"]) for state in optimizers[0].state.values()}
    assert steps == 5


def test_gradients_that_are_zeroed_in_place_are_kept(pair):
    optimizers, sets = pair
    descend(optimizers, sets, 2)
    optimizers[0].zero_grad(set_to_none=False)
    assert all(p.grad is not None and not p.grad.any() for p in sets[0])


def test_what_never_gets_a_gradient_stays(pair):
    optimizers, sets = pair
    for optimizer, those in zip(optimizers, sets, strict=True):
        for _ in range(3):
            optimizer.zero_grad()
            those[0].square().sum().backward()
            optimizer.step()
    assert all(torch.equal(one, other) for one, other in zip(*sets, strict=True))
    assert torch.equal(sets[0][1], parameters()[1])


@pytest.mark.parametrize(
    "turns", [[(0,), (0, 1), (1,), (0, 1, 2, 3)], [(0, 1, 2), (0,), (0, 1, 2)], [(), (1,), (1, 3)]], ids=str
)
def test_gradients_that_come_and_go(pair, turns):
    """Parameters whose gradients come late, or only sometimes, take PyTorch's steps whenever they have one."""
    optimizers, sets = pair
    for turn in turns:
        for optimizer, those in zip(optimizers, sets, strict=True):
            for _ in range(2):
                optimizer.zero_grad()
                if turn:
                    sum(those[i].square().sum() for i in turn).backward()
                optimizer.step()
    check_same(optimizers, sets)
