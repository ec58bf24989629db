"""Every kernel equals its plain version, values and gradients; with GCTD3_PLAIN=1 a training ends as one without."""

import itertools
from importlib.util import module_from_spec

import pytest
import torch
from running import rows, train
from test_algorithms import build, going_on
from torch import nn
from torch.nn import functional

from gctd3.nn import kernels

EXACT = {"rtol": 1e-12, "atol": 1e-12}


def network(sizes, e=3, shared=True, batch=7):
    weights = [torch.randn(e, o, i, dtype=torch.float64) for i, o in itertools.pairwise(sizes)]
    biases = [torch.randn(e, o, dtype=torch.float64) for o in sizes[1:]]
    x = torch.randn(*(() if shared else (e,)), batch, sizes[0], dtype=torch.float64)
    return x, [p for pair in zip(weights, biases, strict=True) for p in pair]


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("sizes", [(4, 1), (5, 6, 2), (5, 8, 8, 3)], ids=str)
def test_stacked_layers(sizes, shared):
    x, parameters = network(sizes, shared=shared)
    found = []
    for function in (kernels.stacked_layers, kernels.stacked_layers_plain):
        inputs = [value.clone().requires_grad_() for value in (x, *parameters)]
        out = function(*inputs)
        weights = torch.linspace(-1.0, 1.0, out.numel(), dtype=torch.float64).reshape(out.shape)
        found.append([out, *torch.autograd.grad((weights * out.sin()).sum(), inputs)])
    # Each network alone, by PyTorch's own function.
    alone = []
    for k in range(len(parameters[0])):
        y = x if shared else x[k]
        for i in range(0, len(parameters), 2):
            y = functional.linear(torch.relu(y) if i else y, parameters[i][k], parameters[i + 1][k])
        alone.append(y)
    torch.testing.assert_close(found[0][0], torch.stack(alone), **EXACT)
    for fast, plain in zip(*found, strict=True):
        torch.testing.assert_close(fast, plain, **EXACT)
    with torch.no_grad():
        assert torch.equal(kernels.stacked_layers(x, *parameters), found[0][0])


def test_stacked_layers_against_finite_differences():
    x, parameters = network((3, 4, 2), e=2, batch=3)
    inputs = [value.requires_grad_() for value in (x, *parameters)]
    assert torch.autograd.gradcheck(kernels.stacked_layers, inputs)


@pytest.mark.parametrize("trained", [(0,), (1,), (2,), (4,), (0, 3), (1, 2)], ids=str)
def test_stacked_layers_of_which_only_some_are_trained(trained):
    """Only the gradients that are required are computed."""
    x, parameters = network((3, 4, 2))
    found = []
    for function in (kernels.stacked_layers, kernels.stacked_layers_plain):
        inputs = [v.clone().requires_grad_(i in trained) for i, v in enumerate((x, *parameters))]
        function(*inputs).square().sum().backward()
        assert [i for i, value in enumerate(inputs) if value.grad is not None] == list(trained)
        found.append([inputs[i].grad for i in trained])
    for fast, plain in zip(*found, strict=True):
        torch.testing.assert_close(fast, plain, **EXACT)


@pytest.mark.parametrize("weight_decay", [0.0, 0.1])
def test_adam_step(weight_decay):
    group = {"lr": 0.01, "betas": (0.9, 0.99), "eps": 1e-8, "weight_decay": weight_decay}
    shapes, found = [(3, 4), (5,), (2, 2, 2), ()], []
    for step in (kernels.adam_step, kernels.adam_step_plain):
        torch.manual_seed(0)
        parameters = [nn.Parameter(torch.randn(shape, dtype=torch.float64)) for shape in shapes]
        first, second = ([torch.zeros_like(p) for p in parameters] for _ in range(2))
        steps = [torch.zeros(()) for _ in shapes]
        with torch.no_grad():
            for _ in range(5):
                step(parameters, [torch.randn_like(p) for p in parameters], first, second, steps, group)
        assert all(float(count) == 5 for count in steps)
        found.append([*parameters, *first, *second])
    for fast, plain in zip(*found, strict=True):
        torch.testing.assert_close(fast, plain, **EXACT)


def test_a_step_of_adam_by_hand():
    # First step, gradient 2, lr 0.1: mean 0.1 * 2 / (1 - 0.9) = 2, square 0.01 * 4 / (1 - 0.99) = 4,
    # so that the parameter moves by 0.1 * 2 / sqrt(4) = 0.1.
    group = {"lr": 0.1, "betas": (0.9, 0.99), "eps": 0.0, "weight_decay": 0.0}
    for step in (kernels.adam_step, kernels.adam_step_plain):
        parameter = nn.Parameter(torch.tensor([1.0], dtype=torch.float64))
        state = [[torch.zeros(1, dtype=torch.float64)], [torch.zeros(1, dtype=torch.float64)], [torch.zeros(())]]
        with torch.no_grad():
            step([parameter], [torch.tensor([2.0], dtype=torch.float64)], *state, group)
        assert parameter.item() == pytest.approx(0.9, abs=1e-12)


def test_lerp_all():
    sources = [torch.randn(shape) for shape in ((3, 4), (5,), ())]
    fast, plain = ([torch.zeros_like(source) for source in sources] for _ in range(2))
    for _ in range(3):
        kernels.lerp_all(fast, sources, 0.3)
        kernels.lerp_all_plain(plain, sources, 0.3)
    for one, other, source in zip(fast, plain, sources, strict=True):
        assert torch.equal(one, other)
        torch.testing.assert_close(one, (1 - 0.7**3) * source)


@pytest.mark.parametrize("robots, history", [(1, 1), (1, 4), (3, 5)])
def test_stack_frames(robots, history):
    rows = 11
    frames = torch.randn(rows * robots, 2, 3)
    age = torch.randint(history, (rows * robots,), dtype=torch.uint8)
    place = torch.arange(rows * robots)  # also those whose stack reaches around the end of the ring
    back = torch.arange(history - 1, -1, -1)
    fast = kernels.stack_frames(frames, age, place, back, robots)
    assert torch.equal(fast, kernels.stack_frames_plain(frames, age, place, back, robots))
    assert torch.equal(fast[..., -3:], frames)
    # The worked example of FrameBuffer: an episode that begins in row 5, the stack of row 6 is frames 5, 5, 6.
    if history > 1:
        example = torch.arange(8.0).reshape(8, 1, 1)
        ages = torch.tensor([2, 2, 2, 2, 2, 0, 1, 2], dtype=torch.uint8)
        two_back = torch.tensor([2, 1, 0])
        for function in (kernels.stack_frames, kernels.stack_frames_plain):
            stacks = function(example, ages, torch.tensor([6, 5]), two_back, 1)
            assert stacks.flatten(1).tolist() == [[5, 5, 6], [5, 5, 5]]


# The switch.


def test_the_switch_takes_every_plain_version(monkeypatch):
    called = []
    for name in ("stacked_layers", "adam_step", "lerp_all", "stack_frames"):
        monkeypatch.setattr(kernels, f"{name}_plain", lambda *_, name=name: called.append(name))
    x, parameters = network((3, 2))
    assert not kernels.plain()
    with kernels.use_plain():
        assert kernels.plain()
        kernels.stacked_layers(x, *parameters)
        kernels.adam_step([], [], [], [], [], {})
        kernels.lerp_all([], [], 0.5)
        kernels.stack_frames(x, x, x, x, 1)
        with kernels.use_plain(False):
            assert not kernels.plain()
    assert called == ["stacked_layers", "adam_step", "lerp_all", "stack_frames"]
    assert not kernels.plain()


@pytest.mark.parametrize("said, plain", [(None, False), ("", False), ("0", False), ("1", True)])
def test_the_environment_variable(monkeypatch, said, plain):
    """As the module finds it when it is imported: a second copy of it, beside the one that is used."""
    monkeypatch.delenv(kernels.VARIABLE, raising=False)
    if said is not None:
        monkeypatch.setenv(kernels.VARIABLE, said)
    copy = module_from_spec(kernels.__spec__)
    kernels.__spec__.loader.exec_module(copy)
    assert copy is not kernels and copy.plain() is plain


@pytest.mark.parametrize("name", ["td3", "sac", "ddpg"])
def test_updates_without_kernels_end_where_those_with_them_do(name):
    def updated():
        algorithm = build(name)
        assert getattr(algorithm.loss, "stacked", None) in (None, not kernels.plain())
        torch.manual_seed(1)
        for _ in range(6):
            algorithm.update(going_on())
        return algorithm.state_dict()["loss"]

    fast = updated()
    with kernels.use_plain():
        plain = updated()
    assert fast.keys() == plain.keys()
    for key, value in fast.items():
        torch.testing.assert_close(value, plain[key], rtol=1e-4, atol=1e-5)


@pytest.mark.nightly
def test_a_plain_training(finished, tmp_path):
    with kernels.use_plain():
        plain = rows(train(tmp_path / "plain", "algo=gctd3"))
    fast = rows(finished["gctd3"])
    assert [row["updates"] for row in plain] == [row["updates"] for row in fast]
    assert float(plain[0]["return_mean"]) == pytest.approx(float(fast[0]["return_mean"]), rel=1e-2)
