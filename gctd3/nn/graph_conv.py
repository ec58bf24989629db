"""Graph convolutions over a fixed graph, as dense batched matrix products."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gctd3.nn.layers import stacked_linear


class GraphConv(nn.Module):
    r"""One graph convolution, :math:`Y = P X \Theta + b`, with a fixed propagation matrix :math:`P`.

    With :math:`P = \hat D^{-1/2} \hat A \hat D^{-1/2}` it is equation 7 of Phan Bui et al. 2022 and the layer of Kipf
    and Welling 2017 (arXiv:1609.02907).

    Args:
        in_features: ``F``, features of a node.
        out_features: ``F'``, features of a node after the layer.
        propagation: ``P``, shape ``[N, N]``; for example :attr:`gctd3.KinematicGraph.normalized_adjacency`.
        bias: Whether to add ``b``, shape ``[F']``.

    Shapes:
        input ``[*, N, F]``, output ``[*, N, F']``.
    """

    propagation: Tensor

    def __init__(
        self, in_features: int, out_features: int, propagation: np.ndarray | Tensor, bias: bool = True
    ) -> None:
        super().__init__()
        self.in_features, self.out_features = in_features, out_features
        matrix = torch.as_tensor(propagation, dtype=torch.get_default_dtype())
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
            raise ValueError(f"A propagation matrix has shape [N, N], got {list(matrix.shape)}.")
        self.register_buffer("propagation", matrix.clone())
        self.weight = nn.Parameter(torch.empty(in_features, out_features))
        self.bias = nn.Parameter(torch.empty(out_features)) if bias else None
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Glorot-uniform weights (Kipf and Welling 2017), zero bias."""
        bound = math.sqrt(6.0 / (self.in_features + self.out_features))
        nn.init.uniform_(self.weight, -bound, bound)
        if self.bias is not None:
            nn.init.zeros_(self.bias)

    def forward(self, nodes: Tensor) -> Tensor:
        """Convolve ``nodes [*, N, F]``.

        Raises:
            ValueError: If the trailing dimensions are not ``[N, F]``.
        """
        expected = (self.propagation.shape[-1], self.in_features)
        if tuple(nodes.shape[-2:]) != expected:
            raise ValueError(
                f"Expected node features of shape [*, {expected[0]}, {expected[1]}], got {list(nodes.shape)}."
            )
        flat = nodes.reshape(-1, *expected).transpose(0, 1)
        return self.node_first(flat).transpose(-3, -2).reshape(*nodes.shape[:-1], self.out_features)

    def node_first(self, nodes: Tensor) -> Tensor:
        """The same on ``[N, B, F]``, the layout in which both products of the layer are single matrix products.

        Returns:
            ``[N, B, F']``; ``[E, N, B, F']`` if the parameters are stacked to ``[E, F, F']`` (``nodes`` may be too).
        """
        n, batch, features = nodes.shape[-3:]
        mixed = self.propagation @ nodes.reshape(*nodes.shape[:-2], batch * features)
        mixed = mixed.reshape(*mixed.shape[:-2], n * batch, features)
        if self.weight.ndim == 2:
            out = mixed @ self.weight if self.bias is None else functional.linear(mixed, self.weight.T, self.bias)
        else:
            out = stacked_linear(mixed, self.weight.mT, self.bias)
        return out.reshape(*out.shape[:-2], n, batch, self.out_features)

    def extra_repr(self) -> str:
        """Sizes, for ``print``."""
        nodes = self.propagation.shape[-1]
        return f"{self.in_features}, {self.out_features}, nodes={nodes}, bias={self.bias is not None}"
