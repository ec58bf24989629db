"""Networks that are exactly equivariant to the reflection of a robot's left and right sides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from gctd3.errors import ConfigError
from gctd3.nn.stacking import stackable_layer
from gctd3.tasks.reflection import Reflection, SignedPermutation


@stackable_layer
class Reflect(nn.Module):
    """Apply a signed permutation to the last dimension, as a product with a fixed matrix.

    Shapes:
        input ``[*, D]``, output ``[*, D]``; a matrix stacked to ``[E, D, D]`` holds ``E`` times the same.
    """

    matrix: Tensor

    def __init__(self, permutation: SignedPermutation) -> None:
        super().__init__()
        matrix = torch.as_tensor(permutation.matrix, dtype=torch.get_default_dtype())
        self.register_buffer("matrix", matrix, persistent=False)

    def forward(self, values: Tensor) -> Tensor:
        """Reflect ``values [*, D]``."""
        return values @ (self.matrix if self.matrix.ndim == 2 else self.matrix[0])


@stackable_layer
class Symmetric(nn.Module):
    r"""Average a function over a state and its mirror image: :math:`f(x) = (g(x) + M' g(M x)) / 2`.

    Whatever :math:`g` is, :math:`f(M x) = M' f(x)`: averaging over a group is equivariant to it (Puny et al. 2022,
    arXiv:2110.03336, with both elements of the group as the frame; for robots Ordonez-Apraez et al. 2024,
    arXiv:2402.15552). This doubles the cost of the forward pass and adds no parameters.

    Args:
        reflection: The robot's mirror symmetry.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        per_action: Outputs of the function for each action: 1 for actions; 2 for actions followed by their scales,
            which change places but not signs; 0 for a value, which is invariant.

    Raises:
        ConfigError: If the reflection has another number of actions.
    """

    def __init__(self, reflection: Reflection, in_features: int, action_dim: int, per_action: int) -> None:
        super().__init__()
        if len(reflection.action.source) != action_dim:
            raise ConfigError(
                f"equivariant: true needs a reflection of all {action_dim} actions, got one of "
                f"{len(reflection.action.source)}: only actuators of joints have a mirror image."
            )
        self.nodes = Reflect(reflection.nodes(in_features))
        self.action, self.counters = Reflect(reflection.action), Reflect(reflection.counters)
        self.out = Reflect(_outputs(reflection.action, per_action)) if per_action else nn.Identity()

    def forward(self, function: Callable[..., Tensor], nodes: Tensor, *beside: Tensor) -> Tensor:
        """Average ``function(nodes, *beside)`` over the state and its mirror image.

        Args:
            function: Maps ``[*, N, F]`` and ``beside`` to ``[*, D]`` or, stacked, to ``[E, *, D]``.
            nodes: ``[*, N, F]``.
            *beside: Actions ``[*, A]`` and counters ``[*, C]``, as many as ``function`` takes.
        """
        unbatched = nodes.ndim == 2  # one state: a batch of one until the end
        inputs = [x.unsqueeze(0) for x in (nodes, *beside)] if unbatched else [nodes, *beside]
        mirrored = [self.nodes(inputs[0].flatten(-2)).reshape(inputs[0].shape)]
        mirrored += [reflect(x) for reflect, x in zip((self.action, self.counters), inputs[1:], strict=False)]
        dims = [-3, *[-2] * len(beside)]
        both = function(*(torch.cat(pair, dim=dim) for *pair, dim in zip(inputs, mirrored, dims, strict=True)))
        # Not chunk: of a batch of unknown size PyTorch's ONNX exporter cannot halve it.
        seen, reflected = both.reshape(*both.shape[:-2], 2, -1, both.shape[-1]).unbind(-3)
        out = 0.5 * (seen + self.out(reflected))
        return out.squeeze(-2) if unbatched else out


def _outputs(action: SignedPermutation, per_action: int) -> SignedPermutation:
    """Return the reflection of actions, and of the scales after them, whose signs do not change."""
    source = [action.source + i * len(action.source) for i in range(per_action)]
    sign = [action.sign, *[np.ones_like(action.sign)] * (per_action - 1)]
    return SignedPermutation(np.concatenate(source), np.concatenate(sign))
