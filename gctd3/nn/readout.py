"""Readouts after the encoder whose weights fit robots of any size: one head for all joints, and one pool.

Both read the nodes' codes in the layout of :meth:`gctd3.nn.GraphEncoder.node_first` and know the robot only by which
node each action moves, a constant that is not part of the state dictionary.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from gctd3.errors import ConfigError
from gctd3.nn.stacking import stackable_layer
from gctd3.robots.graph import KinematicGraph


@stackable_layer
class JointReadout(nn.Module):
    """Apply one head to each actuated joint's code, concatenated with the mean of all nodes' codes.

    It is the shared controller of NerveNet (Wang et al., ICLR 2018), with the mean as the head's input about the whole
    robot. The head distinguishes joints by their codes only.

    Args:
        graph: The robot's graph, with the node that each action moves.
        action_dim: ``A``, number of actions.
        head: Network from ``[*, 2 * width]`` to ``[*, k]``, ``k`` numbers for each action.

    Shapes:
        input ``[N, B, width]``, output ``[B, k * A]``: the first numbers of all actions, then the second.
    """

    selection: Tensor

    def __init__(self, graph: KinematicGraph, action_dim: int, head: nn.Module) -> None:
        super().__init__()
        self.register_buffer("selection", selection(graph, action_dim), persistent=False)
        self.head = head

    def forward(self, codes: Tensor) -> Tensor:
        """Compute the actions' numbers from ``codes [(E,) N, B, width]``."""
        joints = self.selection @ codes.flatten(-2)
        joints = joints.reshape(*joints.shape[:-1], *codes.shape[-2:])
        robot = codes.mean(-3, keepdim=True).expand_as(joints)
        out = self.head(torch.cat([joints, robot], dim=-1).flatten(-3, -2))
        return out.unflatten(-2, joints.shape[-3:-1]).movedim(-3, -1).flatten(-2)


@stackable_layer
class PooledReadout(nn.Module):
    """Apply shared layers to every node's code and action, and map their mean over the nodes to a value.

    It is a sum decomposition of Deep Sets (Zaheer et al. 2017, arXiv:1703.06114, theorem 2), divided by the number of
    nodes so that its size does not grow with the robot.

    Args:
        graph: The robot's graph, with the node that each action moves.
        action_dim: ``A``, number of actions.
        each: Network from ``[*, width + 1]`` to ``[*, D]``, applied to every node.
        pooled: Network from ``[*, D + C]`` to ``[*, 1]``, where ``C`` is the length of the critic's privileged input.

    Shapes:
        inputs ``[N, B, width]``, ``[B, A]`` and, if ``C > 0``, ``[B, C]``; output ``[B, 1]``.
    """

    selection: Tensor

    def __init__(self, graph: KinematicGraph, action_dim: int, each: nn.Module, pooled: nn.Module) -> None:
        super().__init__()
        self.register_buffer("selection", selection(graph, action_dim), persistent=False)
        self.each, self.pooled = each, pooled

    def forward(self, codes: Tensor, action: Tensor, *beside: Tensor) -> Tensor:
        """Estimate the value of ``action [B, A]`` at ``codes [(E,) N, B, width]``."""
        rows = codes.shape[-3:-1]
        pushed = (self.selection.mT @ action.mT).unsqueeze(-1)
        if pushed.ndim < codes.ndim:
            pushed = pushed.expand(*codes.shape[:-1], 1)
        at_nodes = torch.cat([codes.expand(*pushed.shape[:-1], codes.shape[-1]), pushed], dim=-1)
        pooled = self.each(at_nodes.flatten(-3, -2)).unflatten(-2, rows).mean(-3)
        extra = [x.expand(*pooled.shape[:-1], x.shape[-1]) for x in beside]
        return self.pooled(torch.cat([pooled, *extra], dim=-1))


def selection(graph: KinematicGraph, action_dim: int) -> Tensor:
    """Return the matrix ``[A, N]`` of zeros and ones that selects the node of each action.

    Raises:
        ConfigError: If the graph does not name the nodes of the actions, or names another number of them.
    """
    if len(graph.actuated) != action_dim:
        raise ConfigError(
            f"readout: joint needs the node that each of the {action_dim} actions moves; the graph names "
            f"{len(graph.actuated)}. KinematicGraph.from_robot finds them, from_edges takes them as actuated=[...]."
        )
    return torch.eye(graph.num_nodes)[list(graph.actuated)]
