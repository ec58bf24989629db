"""Make networks for tests: one with each option, and one with all."""

import torch
from torch import nn

from gctd3.nn import Network

SIZES = 10, 6  # features of a node over all frames, actions
NETWORKS = {
    "graph norm": Network(graph_norm="layer"),
    "residual": Network(residual=True),
    "chebyshev": Network(chebyshev=2),
    "local and global": Network((32, 32, 16), residual=True, graph_norm="layer", mixing="alternating"),
    "joint": Network(readout="joint", norm="layer"),
    "joint without a graph": Network((), readout="joint", hidden=(32,)),
    "equivariant": Network(equivariant=True),
    "everything": Network(
        (16, 16), (32, 32), "layer", "layer", True, 2, mixing="alternating", readout="joint", equivariant=True
    ),
}


def randomised(module: nn.Module) -> nn.Module:
    """Move biases and norms away from their zeros and ones, where a mistake with them would not show."""
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return module
