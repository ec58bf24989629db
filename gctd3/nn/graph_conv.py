"""Graph convolutions over a fixed graph, as dense batched matrix products."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gctd3.nn.kernels import stacked_linear
from gctd3.nn.stacking import stackable_layer


class GraphLayer(nn.Module, ABC):
    r"""Define the base of graph convolutions: fixed mixing of nodes, then :math:`Y = M \Theta + b` at every node.

    Args:
        in_features: ``F``, features of a node.
        out_features: ``F'``, features of a node after the layer.
        propagation: Matrices that mix the nodes, shape ``[..., N, N]``.
        terms: Number of mixtures of each node that the layer weights; the weight's shape is ``[terms * F, F']``.
        bias: Whether to add ``b``, shape ``[F']``.
        persistent: Whether the state dictionary holds ``propagation``; without it, it fits every graph.

    Shapes:
        input ``[*, N, F]``, output ``[*, N, F']``.
    """

    propagation: Tensor

    def __init__(
        self, in_features: int, out_features: int, propagation: Tensor, terms: int, bias: bool, persistent: bool
    ) -> None:
        super().__init__()
        self.in_features, self.out_features = in_features, out_features
        self.register_buffer("propagation", propagation.clone(), persistent=persistent)
        self.weight = nn.Parameter(torch.empty(terms * in_features, out_features))
        self.bias = nn.Parameter(torch.empty(out_features)) if bias else None
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Initialise the weights of every term Glorot-uniformly (Kipf and Welling 2017), and the bias to zero."""
        bound = math.sqrt(6.0 / (self.in_features + self.out_features))
        nn.init.uniform_(self.weight, -bound, bound)
        if self.bias is not None:
            nn.init.zeros_(self.bias)

    def forward(self, nodes: Tensor) -> Tensor:
        """Apply the convolution to ``nodes [*, N, F]``.

        With parameters stacked to ``[E, ...]``, ``[B, N, F]`` and ``[E, B, N, F]`` give ``[E, B, N, F']``.

        Raises:
            ValueError: If the trailing dimensions are not ``[N, F]``.
        """
        expected = (self.propagation.shape[-1], self.in_features)
        if tuple(nodes.shape[-2:]) != expected:
            raise ValueError(
                f"Expected node features of shape [*, {expected[0]}, {expected[1]}], got {list(nodes.shape)}."
            )
        if self.weight.ndim == 3:
            return self.node_first(nodes.transpose(-3, -2)).transpose(-3, -2)
        flat = nodes.reshape(-1, *expected).transpose(0, 1)
        return self.node_first(flat).transpose(-3, -2).reshape(*nodes.shape[:-1], self.out_features)

    def node_first(self, nodes: Tensor) -> Tensor:
        """Apply the convolution to ``[N, B, F]``, where both products of the layer are single matrix products.

        Returns:
            ``[N, B, F']``; ``[E, N, B, F']`` if the parameters are stacked to ``[E, ...]`` (``nodes`` may be too).
        """
        n, batch = nodes.shape[-3:-1]
        mixed = self.mix(nodes)
        if self.weight.ndim == 2:
            out = mixed @ self.weight if self.bias is None else functional.linear(mixed, self.weight.T, self.bias)
        else:
            out = stacked_linear(mixed, self.weight.mT, self.bias)
        return out.reshape(*out.shape[:-2], n, batch, self.out_features)

    @abstractmethod
    def mix(self, nodes: Tensor) -> Tensor:
        """Compute the mixtures ``[(E,) N * B, terms * F]`` of ``nodes [(E,) N, B, F]`` that the weight multiplies."""

    def extra_repr(self) -> str:
        """Return the sizes of the layer, for ``print``."""
        nodes = self.propagation.shape[-1]
        return f"{self.in_features}, {self.out_features}, nodes={nodes}, bias={self.bias is not None}"


@stackable_layer
class GraphConv(GraphLayer):
    r"""Apply a graph convolution, :math:`Y = P X \Theta + b`, with a fixed propagation matrix :math:`P`.

    With :math:`P = \hat D^{-1/2} \hat A \hat D^{-1/2}` it is equation 7 of Phan Bui et al. 2022 and the layer of Kipf
    and Welling 2017 (arXiv:1609.02907).

    Args:
        in_features: ``F``, features of a node.
        out_features: ``F'``, features of a node after the layer.
        propagation: ``P``, shape ``[N, N]``; for example :attr:`gctd3.KinematicGraph.normalized_adjacency`.
        bias: Whether to add ``b``, shape ``[F']``.
        persistent: Whether the state dictionary holds ``P``; without it, it fits every graph.

    Shapes:
        input ``[*, N, F]``, output ``[*, N, F']``.
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        propagation: np.ndarray | Tensor,
        bias: bool = True,
        persistent: bool = True,
    ) -> None:
        matrix = torch.as_tensor(propagation, dtype=torch.get_default_dtype())
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
            raise ValueError(f"A propagation matrix has shape [N, N], got {list(matrix.shape)}.")
        super().__init__(in_features, out_features, matrix, 1, bias, persistent)

    def mix(self, nodes: Tensor) -> Tensor:
        """Compute ``P X``: ``nodes [(E,) N, B, F]`` to ``[(E,) N * B, F]``."""
        n, batch, features = nodes.shape[-3:]
        mixed = self.propagation @ nodes.reshape(*nodes.shape[:-2], batch * features)
        return mixed.reshape(*mixed.shape[:-2], n * batch, features)


@stackable_layer
class ChebyshevConv(GraphLayer):
    r"""Apply a convolution of order ``K``, :math:`Y = \sum_{k=0}^{K} T_k(\tilde\Delta) X \Theta_k + b`.

    It is equation 5 of Phan Bui et al. 2022, from Defferrard et al. 2016 (arXiv:1606.09375): a node aggregates the
    nodes up to ``K`` edges away, with separate weights for each polynomial.

    Args:
        in_features: ``F``, features of a node.
        out_features: ``F'``, features of a node after the layer.
        polynomials: :math:`T_0, \dots, T_K`, shape ``[K + 1, N, N]``; :meth:`gctd3.KinematicGraph.chebyshev`.
        bias: Whether to add ``b``, shape ``[F']``.
        persistent: Whether the state dictionary holds ``polynomials``; without them, it fits every graph.

    Shapes:
        input ``[*, N, F]``, output ``[*, N, F']``; the weight ``[(K + 1) * F, F']`` holds :math:`\Theta_0, \dots,
        \Theta_K`, one below the other.
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        polynomials: np.ndarray | Tensor,
        bias: bool = True,
        persistent: bool = True,
    ) -> None:
        terms = torch.as_tensor(polynomials, dtype=torch.get_default_dtype())
        if terms.ndim != 3 or terms.shape[-1] != terms.shape[-2] or not len(terms):
            raise ValueError(f"Chebyshev polynomials have shape [K + 1, N, N], got {list(terms.shape)}.")
        super().__init__(in_features, out_features, terms, len(terms), bias, persistent)

    def mix(self, nodes: Tensor) -> Tensor:
        """Compute all ``T_k X``, concatenated: ``nodes [(E,) N, B, F]`` to ``[(E,) N * B, (K + 1) * F]``."""
        n, batch, features = nodes.shape[-3:]
        terms = self.propagation.shape[-3]
        flat = nodes.reshape(*nodes.shape[:-2], batch * features)
        mixed = self.propagation.flatten(-3, -2) @ flat
        mixed = mixed.reshape(*mixed.shape[:-2], terms, n * batch, features).transpose(-3, -2)
        return mixed.reshape(*mixed.shape[:-2], terms * features)
