"""Operators of ONNX as formulas in C++. Source of their meaning: https://onnx.ai/onnx/operators."""

from __future__ import annotations

from collections.abc import Iterator

# Operators that leave the numbers where they are, that move them, and that compute each from one or from two others.
ALIASES = ("Reshape", "Flatten", "Squeeze", "Unsqueeze", "Identity", "Dropout")
MOVES = ("Transpose", "Slice", "Split", "Gather", "Concat", "Expand", "Tile")
UNARY = {
    "Relu": "x > 0.0f ? x : 0.0f",
    "Tanh": "std::tanh(x)",
    "Sigmoid": "1.0f / (1.0f + std::exp(-x))",
    "Softplus": "x > 20.0f ? x : std::log1p(std::exp(x))",
    "Exp": "std::exp(x)",
    "Log": "std::log(x)",
    "Sqrt": "std::sqrt(x)",
    "Abs": "std::fabs(x)",
    "Neg": "-x",
    "Reciprocal": "1.0f / x",
}
BINARY = {
    "Add": "a + b",
    "Sub": "a - b",
    "Mul": "a * b",
    "Div": "a / b",
    "Max": "a > b ? a : b",
    "Min": "a < b ? a : b",
    "Pow": "std::pow(a, b)",
}
WIDTH = 118  # columns of a line of numbers


def lines(texts: list[str]) -> Iterator[str]:
    """Yield lines of numbers with commas."""
    line = ""
    for text in texts:
        if line and len(line) + len(text) + 2 > WIDTH:
            yield line
            line = ""
        line += f"{text}, "
    yield line
