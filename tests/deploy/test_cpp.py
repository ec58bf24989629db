"""A policy exported as a C++ header, compiled by g++, gives ONNX's actions and the runtime's commands."""

import re
import shutil

import numpy as np
import pytest
import torch
from running import command
from small_policies import (
    HOLD,
    RATE,
    answers,
    compiled,
    following_contract,
    slewing_contract,
    small_contract,
    small_model,
    ticking_contract,
    write_policy,
)

import gctd3
from gctd3 import KinematicGraph
from gctd3.deploy import Policy
from gctd3.deploy.contract import parse_contract
from gctd3.deploy.cpp_policy import to_cpp
from gctd3.deploy.export import Deterministic, to_onnx, traced
from gctd3.errors import ContractError, ReadingError
from gctd3.nn import Network
from gctd3.tasks.reflection import Reflection

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")
needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="There is no g++.")


def difference(model, contract, folder, states):
    header = folder / "policy.hpp"
    header.write_text(to_cpp(model, contract), encoding="utf-8")
    calls = ["n " + " ".join(f"{x:.9g}" for x in state.reshape(-1)) for state in states]
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    expected = session.run(None, {"nodes": states})[0]
    return np.abs(answers(compiled(header, folder), calls) - expected).max()


@pytest.mark.nightly
@needs_compiler
@pytest.mark.parametrize("count", [200, 10_000])
def test_the_packaged_policys_actions_are_onnxs(exported, tmp_path, count):
    contract = parse_contract(exported.with_suffix(".json").read_text(encoding="utf-8"))
    states = np.random.default_rng(0).standard_normal((count, 8, 10)).astype(np.float32)
    assert difference(exported.read_bytes(), contract, tmp_path, states) <= 1e-5


def plain(graph, reflection):
    network = Network((8, 8), (16,), norm="layer", graph_norm="layer", residual=True, chebyshev=2, equivariant=True)
    return gctd3.make_actor(graph, 10, 6, network, reflection)


def shared(graph, reflection):
    return gctd3.make_actor(graph, 10, 6, Network((8, 8), (16,), residual=True, mixing="alternating", readout="joint"))


def stochastic(graph, reflection):
    return gctd3.make_stochastic_actor(graph, 10, 6, Network((), (16,)))


@needs_compiler
@pytest.mark.nightly
@pytest.mark.parametrize("make", [plain, shared, stochastic])
def test_any_networks_actions_are_onnxs(robot, exported, tmp_path, make):
    contract = parse_contract(exported.with_suffix(".json").read_text(encoding="utf-8"))
    policy = make(KinematicGraph.from_robot(robot), Reflection.from_robot(robot)).requires_grad_(False).eval()
    model = to_onnx(traced(Deterministic(policy).eval(), (8, 10)), contract)[0]
    states = np.random.default_rng(0).standard_normal((500, 8, 10)).astype(np.float32)
    assert difference(model, contract, tmp_path, states) <= 1e-5


def operators(nodes, inputs=(), shape=(5, 4)):
    """Make an ONNX file of operators in a row, from ``nodes`` to ``action``, whose last makes two numbers."""
    helper, f32 = onnx.helper, onnx.TensorProto.FLOAT
    made = [helper.make_node(kind, given, [made], **attributes) for kind, given, made, attributes in nodes]
    graph = helper.make_graph(
        made,
        "operators",
        [helper.make_tensor_value_info("nodes", f32, ["batch", *shape])],
        [helper.make_tensor_value_info("action", f32, ["batch", None])],
        [onnx.numpy_helper.from_array(np.asarray(value), name) for name, value in inputs],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9).SerializeToString()


AXIS = ("axis", np.array([1], dtype=np.int64))
END = [("Gather", ["y", "first"], "action", {"axis": 1})]
FIRST = ("first", np.array([3, 1], dtype=np.int64))
FLAT = [("Flatten", ["nodes"], "x", {"axis": 1})]
OPERATORS = {
    **{
        kind: [*FLAT, (kind, ["x"], "y", {}), *END] for kind in ("Sigmoid", "Softplus", "Exp", "Abs", "Neg", "Identity")
    },
    **{kind: [*FLAT, ("Exp", ["x"], "e", {}), (kind, ["e"], "y", {}), *END] for kind in ("Log", "Sqrt", "Reciprocal")},
    **{kind: [*FLAT, (kind, ["x", "row"], "y", {}), *END] for kind in ("Add", "Sub", "Mul", "Div", "Max", "Min")},
    "Pow": [*FLAT, ("Pow", ["x", "two"], "y", {}), *END],
    "Softmax": [*FLAT, ("Softmax", ["x"], "y", {"axis": -1}), *END],
    "ReduceSum": [("ReduceSum", ["nodes", "axis"], "y", {"keepdims": 0}), *END],
    "ReduceMean": [("ReduceMean", ["nodes", "axis"], "y", {"keepdims": 0}), *END],
    "Tile": [*FLAT, ("Tile", ["x", "times"], "y", {}), *END],
    "Concat": [*FLAT, ("Tanh", ["x"], "t", {}), ("Concat", ["t", "x"], "y", {"axis": 1}), *END],
    "Unsqueeze": [*FLAT, ("Unsqueeze", ["x", "axis"], "u", {}), ("Squeeze", ["u", "axis"], "y", {}), *END],
    "broadcast": [("Mul", ["nodes", "column"], "m", {}), ("Flatten", ["m"], "y", {"axis": 1}), *END],
    "batched": [("MatMul", ["nodes", "square"], "m", {}), ("Flatten", ["m"], "y", {"axis": 1}), *END],
    "Clip": [*FLAT, ("Clip", ["x", "low"], "y", {}), *END],
}
INPUTS = [
    AXIS,
    FIRST,
    ("row", np.linspace(0.5, 2, 20, dtype=np.float32)[None]),
    ("two", np.float32(2.0)),
    ("low", np.float32(-0.25)),
    ("times", np.array([1, 2], dtype=np.int64)),
    ("column", np.linspace(-1, 1, 5, dtype=np.float32)[:, None]),
    ("square", np.linspace(-1, 1, 16, dtype=np.float32).reshape(4, 4)),
]


@needs_compiler
@pytest.mark.parametrize(
    "kind",
    [kind if kind in ("broadcast", "Concat") else pytest.param(kind, marks=pytest.mark.nightly) for kind in OPERATORS],
)
def test_an_operator_computes_what_onnxruntime_computes(tmp_path, kind):
    used = {name for _, given, _, _ in OPERATORS[kind] for name in given}
    model = operators(OPERATORS[kind], [pair for pair in INPUTS if pair[0] in used])
    states = np.random.default_rng(1).standard_normal((50, 5, 4)).astype(np.float32)
    assert difference(model, small_contract(), tmp_path, states) <= 1e-5


def test_an_unknown_operator_is_refused_by_name():
    model = operators([*FLAT, ("Erf", ["x"], "y", {}), *END], [FIRST])
    with pytest.raises(
        ContractError, match=r"the operator Erf of '.*' is not translated to C\+\+. Operators: Abs, Add"
    ):
        to_cpp(model, small_contract())


def test_numbers_of_a_header_are_the_files(exported):
    """Every weight of the ONNX file stands in the header, to the bit."""
    model = onnx.load(exported)
    text = to_cpp(exported.read_bytes(), small_contract())
    arrays = [
        np.array(re.findall(r"[-+.\de]+(?=f)", numbers), dtype=np.float32)
        for numbers in re.findall(r"float W\d+\[\d+\] = \{([^}]*)\}", text)
    ]
    for part in model.graph.initializer:
        weights = onnx.numpy_helper.to_array(part).reshape(-1)
        if weights.dtype == np.float32:
            assert any(np.array_equal(weights, array) for array in arrays), part.name


@needs_compiler
@pytest.mark.parametrize(
    "contract_of",
    [
        pytest.param(small_contract, marks=pytest.mark.nightly),
        pytest.param(following_contract, marks=pytest.mark.nightly),
        slewing_contract,
        ticking_contract,
    ],
)
def test_the_headers_policy_is_pythons_over_good_and_bad_calls(tmp_path, contract_of):
    """The same calls to both: the same refusals, the same commands; readings, times, tilts, starts and resets."""
    contract = contract_of()
    file = write_policy(tmp_path, contract)
    header = tmp_path / "policy.hpp"
    header.write_text(to_cpp(small_model(contract), contract), encoding="utf-8")
    policy, rng, time = Policy(file), np.random.default_rng(0), 0.0
    calls, expected = [], []
    for _ in range(4000):
        time += rng.choice([1.0] * 20 + [0.0, 0.3, 0.6, 1.4, 2.0, HOLD + 1.0, 50.0]) / RATE
        readings = {f.reading: rng.uniform(0.4 * f.low, 0.4 * f.high) for f in policy.contract.features}
        upright = {"roll_rad": rng.uniform(-0.4, 0.4), "pitch_rad": rng.uniform(-0.4, 0.4), "gravity_up": -0.9}
        readings |= {name: value for name, value in upright.items() if name in readings} | {"down": rng.integers(2)}
        if rng.random() < 0.2:
            readings[rng.choice(list(readings))] = rng.choice([np.nan, np.inf, 1e30, 2.0, -4.0])
        when = rng.choice([np.nan, time - 9.0, time + 100.0]) if rng.random() < 0.1 else time
        numbers, draw = " ".join(f"{x:.17g}" for x in readings.values()), rng.random()
        asked = {name: readings.pop(name) for name in policy.contract.commands}
        if draw < 0.05 or (policy.stopped and draw < 0.2):
            policy.reset(at_home=draw < 0.01)
            calls.append("h" if draw < 0.01 else "r")
            continue
        try:
            if draw > 0.9:
                at_start = {**readings, **dict.fromkeys(asked, 0.0)}
                calls.append("b " + " ".join(f"{at_start[f.reading]:.17g}" for f in policy.contract.features))
                given = policy.start(readings)
            else:
                calls.append(f"s {when:.17g} {numbers}")
                given = policy.step(readings, when, command=asked)
            expected.append([0, policy.at_home, *given.values()])
        except ReadingError as error:
            expected.append([1, policy.at_home, *error.command.values()])
    at = {name: -1.0 if name == "gravity_up" else 0.0 for name in policy.contract.readings}
    policy.reset()
    numbers = " ".join(str(at.get(feature.reading, 0.0)) for feature in policy.contract.features)
    calls += ["r", *[f"b {numbers}"] * 50]
    expected += [[0, policy.at_home, *command.values()] for command in (policy.start(at) for _ in range(50))]
    assert policy.at_home
    mine, expected = answers(compiled(header, tmp_path), calls), np.array(expected)
    assert 500 < expected[:, 0].sum() < len(expected) - 500
    np.testing.assert_array_equal(mine[:, :2], expected[:, :2])
    np.testing.assert_allclose(mine, expected, atol=1e-5)


@pytest.mark.nightly
@needs_compiler
def test_the_command_writes_a_header(tmp_path, capsys):
    header = tmp_path / "policy.hpp"
    assert command("export", f"out={header}", "episodes=1", "threads=1") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["policy.hpp"]
    captured = capsys.readouterr()
    assert "policy.hpp" in captured.out and "height_m (boom encoder)" in captured.err
    states = torch.randn(20, 8, 10)
    with torch.no_grad():
        expected = Deterministic(gctd3.load_policy()).eval()(states).numpy()
    calls = ["n " + " ".join(f"{x:.9g}" for x in state.reshape(-1)) for state in states.numpy()]
    np.testing.assert_allclose(answers(compiled(header, tmp_path), calls), expected, atol=1e-5)
