"""The network of an ONNX file as C++: a statement for each operator, arrays for its weights.

For a batch of one state every shape is known, so that operators which only move numbers become tables of places, and
scratch memory has a fixed size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np

from gctd3.deploy.cpp_operators import ALIASES, BINARY, MOVES, UNARY, lines
from gctd3.deploy.network import open_session
from gctd3.errors import ContractError


@dataclass
class CppNetwork:
    """Hold the parts of a network in C++.

    Attributes:
        constants: Definitions of its arrays.
        statements: Statements that compute ``action`` from ``nodes``.
        scratch: Size of its scratch memory (numbers).
    """

    constants: list[str] = field(default_factory=list)
    statements: list[str] = field(default_factory=list)
    scratch: int = 0


def to_cpp_network(content: bytes) -> CppNetwork:
    """Translate the network of an ONNX file with one input and one output.

    Raises:
        ContractError: If the network has an operator, or an attribute of one, that is not translated.
    """
    return _Translation(content).translate()


class _Translation:
    def __init__(self, content: bytes) -> None:
        self.onnx: Any = import_module("onnx")
        self.model = self.onnx.load_from_string(content)
        self.graph = self.model.graph
        self.made = CppNetwork()
        self.values = self._values()
        self.fixed = {part.name for part in self.graph.initializer}
        # Expression in C++ of each tensor, by name; of a constant once it is defined.
        self.places: dict[str, str] = {self.graph.input[0].name: "nodes"}
        self.defined: dict[bytes, str] = {}

    def _values(self) -> dict[str, np.ndarray]:
        """Compute every tensor for one state of zeros, for their shapes and for those that do not depend on it."""
        shown = self.onnx.ModelProto()
        shown.CopyFrom(self.model)
        names = [name for node in self.graph.node for name in node.output if name]
        del shown.graph.output[:]
        shown.graph.output.extend(self.onnx.ValueInfoProto(name=name) for name in names)
        (port,) = self.graph.input
        shape = [1, *(dim.dim_value for dim in port.type.tensor_type.shape.dim[1:])]
        state = np.zeros(shape, np.float32)
        computed = open_session(shown.SerializeToString()).run(names, {port.name: state})
        parts = {part.name: self.onnx.numpy_helper.to_array(part) for part in self.graph.initializer}
        return {port.name: state, **parts, **dict(zip(names, computed, strict=True))}

    def translate(self) -> CppNetwork:
        for node in self.graph.node:
            # The shape of a tensor is known.
            if node.op_type in ("Shape", "Constant") or all(name in self.fixed or not name for name in node.input):
                self.fixed |= set(node.output)
                continue
            if any(self.values[name].dtype != np.float32 for name in node.output if name):
                raise ContractError(f"out=.hpp: operator {node.op_type} of {node.name!r} makes no float32 numbers.")
            self._node(node, self._attributes(node))
        (out,) = self.graph.output
        self._say(f"copy({self._at(out.name)}, action, {self.values[out.name].size});")
        return self.made

    def _node(self, node: Any, attributes: dict[str, Any]) -> None:  # noqa: ANN401 - onnx is untyped
        kind = node.op_type
        special: dict[str, Callable[[Any, dict[str, Any]], None]] = {
            "MatMul": self._matmul,
            "Gemm": self._gemm,
            "LayerNormalization": self._layer_norm,
            "ReduceMean": self._reduce,
            "ReduceSum": self._reduce,
            "Clip": self._clip,
            "Softmax": self._softmax,
        }
        if node.domain not in ("", "ai.onnx") or not (
            kind in special or kind in ALIASES or kind in MOVES or kind in UNARY or kind in BINARY
        ):
            known = sorted({*special, *ALIASES, *MOVES, *UNARY, *BINARY})
            raise ContractError(
                f"out=.hpp: the operator {kind} of {node.name!r} is not translated to C++. Operators: "
                f"{', '.join(known)}. Export to .onnx."
            )
        if kind in ALIASES:
            self.places[node.output[0]] = self._at(node.input[0])
        elif kind in MOVES:
            self._move(node)
        elif kind in UNARY:
            (x,) = node.input
            y, size = self._new(node.output[0])
            self._say(
                f"for (int i = 0; i < {size}; ++i) {{ const float x = {self._at(x)}[i]; {y}[i] = {UNARY[kind]}; }}"
            )
        elif kind in BINARY:
            self._binary(node, BINARY[kind])
        else:
            special[kind](node, attributes)

    # Tensors.

    def _attributes(self, node: Any) -> dict[str, Any]:  # noqa: ANN401
        return {one.name: self.onnx.helper.get_attribute_value(one) for one in node.attribute}

    def _say(self, statement: str) -> None:
        self.made.statements.append(statement)

    def _new(self, name: str) -> tuple[str, int]:
        """Return the place of a new tensor in the scratch memory, and its size."""
        size = int(self.values[name].size)
        self.places[name] = f"(scratch + {self.made.scratch})"
        self.made.scratch += size
        return self.places[name], size

    def _at(self, name: str) -> str:
        if name not in self.places:
            self.places[name] = self._constant(self.values[name])
        return self.places[name]

    def _constant(self, values: np.ndarray) -> str:
        """Define an array of float or int once, and return its name."""
        real = values.dtype == np.float32
        if real and not np.isfinite(values).all():
            raise ContractError("out=.hpp: a weight of the network is not finite.")
        flat = np.ascontiguousarray(values).reshape(-1)
        key = flat.dtype.str.encode() + flat.tobytes()
        if key not in self.defined:
            self.defined[key] = f"{'W' if real else 'T'}{len(self.defined)}"
            kind = "float" if real else "int"
            # The shortest decimal that is read back as the same float.
            texts = [str(value) + ("f" if real else "") for value in flat]
            rows = "\n".join(lines(texts))
            self.made.constants.append(f"static constexpr {kind} {self.defined[key]}[{flat.size}] = {{\n{rows}}};")
        return self.defined[key]

    # Operators.

    def _move(self, node: Any) -> None:  # noqa: ANN401
        """Find out whence each number comes, by moving the places in place of the numbers."""
        moving = [name for name in node.input if name and self.values[name].dtype == np.float32]
        if len(moving) > 1 and node.op_type != "Concat":
            raise ContractError(f"out=.hpp: operator {node.op_type} of {node.name!r} has several inputs of numbers.")
        places = {}
        for i, name in enumerate(moving):
            numbered = np.arange(self.values[name].size).reshape(self.values[name].shape)
            places[name] = numbered * len(moving) + i
        feeds = {name: places.get(name, self.values[name]) for name in node.input if name}
        for out, came in zip(node.output, self._alone(node, feeds), strict=True):
            y, size = self._new(out)
            came = came.reshape(-1)
            for i, name in enumerate(moving):
                there = np.flatnonzero(came % len(moving) == i)
                table = self._constant((came[there] // len(moving)).astype(np.int32))
                if len(moving) == 1:
                    self._say(f"for (int i = 0; i < {size}; ++i) {y}[i] = {self._at(name)}[{table}[i]];")
                    continue
                to = self._constant(there.astype(np.int32))
                self._say(f"for (int i = 0; i < {there.size}; ++i) {y}[{to}[i]] = {self._at(name)}[{table}[i]];")

    def _alone(self, node: Any, feeds: dict[str, np.ndarray]) -> list[np.ndarray]:  # noqa: ANN401
        """Run one operator on integers in place of its numbers."""
        helper = self.onnx.helper
        ports = [
            helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(value.dtype), value.shape)
            for name, value in feeds.items()
        ]
        outs = [self.onnx.ValueInfoProto(name=name) for name in node.output]
        graph = helper.make_graph([node], "alone", ports, outs)
        imports = list(self.model.opset_import)
        model = helper.make_model(graph, opset_imports=imports, ir_version=self.model.ir_version)
        moved: list[np.ndarray] = open_session(model.SerializeToString()).run(list(node.output), feeds)
        return moved

    def _spread(self, name: str, shape: tuple[int, ...]) -> str:
        """Return the expression of a tensor's number at ``i`` when it is broadcast to a shape."""
        values = self.values[name]
        if values.shape == shape:
            return f"{self._at(name)}[i]"
        if values.size == 1:
            return f"{self._at(name)}[0]"
        places = np.broadcast_to(np.arange(values.size, dtype=np.int32).reshape(values.shape), shape)
        return f"{self._at(name)}[{self._constant(places)}[i]]"

    def _binary(self, node: Any, formula: str) -> None:  # noqa: ANN401
        shape, names = self.values[node.output[0]].shape, list(node.input)
        if len(names) != 2:
            raise ContractError(f"out=.hpp: operator {node.op_type} of {node.name!r} must have two inputs.")
        y, size = self._new(node.output[0])
        a, b = (self._spread(name, shape) for name in names)
        self._say(f"for (int i = 0; i < {size}; ++i) {{ const float a = {a}, b = {b}; {y}[i] = {formula}; }}")

    def _matmul(self, node: Any, _: dict[str, Any]) -> None:  # noqa: ANN401
        a, b = (self.values[name] for name in node.input)
        if min(a.ndim, b.ndim) < 2:
            raise ContractError(f"out=.hpp: MatMul of {node.name!r} has an input of one dimension.")
        (m, k), n, out = a.shape[-2:], b.shape[-1], self.values[node.output[0]]
        y, _size = self._new(node.output[0])
        batch = out.shape[:-2]
        count = int(np.prod(batch, dtype=int))
        tables = []
        for values in (a, b):
            places = np.arange(int(np.prod(values.shape[:-2], dtype=int)), dtype=np.int32).reshape(values.shape[:-2])
            tables.append(np.broadcast_to(places, batch).reshape(-1))
        for i in range(count):
            left = f"{self._at(node.input[0])} + {int(tables[0][i]) * m * k}"
            right = f"{self._at(node.input[1])} + {int(tables[1][i]) * k * n}"
            self._say(f"multiply<{m}, {k}, {n}>({left}, {right}, {y} + {i * m * n});")

    def _gemm(self, node: Any, attributes: dict[str, Any]) -> None:  # noqa: ANN401
        a, b = (self.values[name] for name in node.input[:2])
        left, right = attributes.get("transA", 0), attributes.get("transB", 0)
        if left or attributes.get("alpha", 1.0) != 1.0 or attributes.get("beta", 1.0) != 1.0:
            raise ContractError(f"out=.hpp: Gemm of {node.name!r} has transA, alpha or beta, which are not translated.")
        (m, k), n = a.shape, b.shape[0 if right else 1]
        y, size = self._new(node.output[0])
        self._say(
            f"multiply{'_transposed' if right else ''}<{m}, {k}, {n}>({self._at(node.input[0])}, "
            f"{self._at(node.input[1])}, {y});"
        )
        if len(node.input) > 2 and node.input[2]:
            self._say(f"for (int i = 0; i < {size}; ++i) {y}[i] += {self._spread(node.input[2], (m, n))};")

    def _layer_norm(self, node: Any, attributes: dict[str, Any]) -> None:  # noqa: ANN401
        shape = self.values[node.input[0]].shape
        axis = attributes.get("axis", -1) % len(shape)
        width, epsilon = int(np.prod(shape[axis:])), attributes.get("epsilon", 1e-5)
        if len([name for name in node.output if name]) > 1:
            raise ContractError(f"out=.hpp: LayerNormalization of {node.name!r} has more than one output.")
        y, size = self._new(node.output[0])
        bias = self._at(node.input[2]) if len(node.input) > 2 and node.input[2] else "nullptr"
        self._say(
            f"layer_norm<{size // width}, {width}>({self._at(node.input[0])}, {self._at(node.input[1])}, {bias}, "
            f"{float(np.float32(epsilon))!r}f, {y});"
        )

    def _reduce(self, node: Any, attributes: dict[str, Any]) -> None:  # noqa: ANN401
        values = self.values[node.input[0]]
        given = self.values[node.input[1]].tolist() if len(node.input) > 1 and node.input[1] else None
        axes = given if given is not None else attributes.get("axes", range(values.ndim))
        gone = sorted(axis % values.ndim for axis in axes)
        kept = [axis for axis in range(values.ndim) if axis not in gone]
        places = np.arange(values.size, dtype=np.int32).reshape(values.shape).transpose(*kept, *gone)
        y, size = self._new(node.output[0])
        count = values.size // size
        divide = f" / {count}.0f" if node.op_type == "ReduceMean" else ""
        self._say(
            f"for (int i = 0; i < {size}; ++i) {{ float sum = 0.0f; for (int k = 0; k < {count}; ++k) sum += "
            f"{self._at(node.input[0])}[{self._constant(places)}[i * {count} + k]]; {y}[i] = sum{divide}; }}"
        )

    def _clip(self, node: Any, _: dict[str, Any]) -> None:  # noqa: ANN401
        names = [*node.input, "", ""][1:3]
        if any(name and name not in self.fixed for name in names):
            raise ContractError(f"out=.hpp: Clip of {node.name!r} has limits that are computed.")
        low, high = (float(self.values[name]) if name else None for name in names)
        y, size = self._new(node.output[0])
        formula = "x"
        if low is not None and np.isfinite(low):
            formula = f"({formula} < {low!r}f ? {low!r}f : {formula})"
        if high is not None and np.isfinite(high):
            formula = f"({formula} > {high!r}f ? {high!r}f : {formula})"
        self._say(
            f"for (int i = 0; i < {size}; ++i) {{ const float x = {self._at(node.input[0])}[i]; {y}[i] = {formula}; }}"
        )

    def _softmax(self, node: Any, attributes: dict[str, Any]) -> None:  # noqa: ANN401
        shape = self.values[node.input[0]].shape
        if attributes.get("axis", -1) % len(shape) != len(shape) - 1:
            raise ContractError(f"out=.hpp: Softmax of {node.name!r} must be over the last axis.")
        y, size = self._new(node.output[0])
        self._say(f"softmax<{size // shape[-1]}, {shape[-1]}>({self._at(node.input[0])}, {y});")
