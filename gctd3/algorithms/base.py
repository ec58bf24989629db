"""What every algorithm has: networks, a TorchRL loss, optimisers, an averaged policy for evaluation."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.objectives import LossModule

from gctd3.errors import ConfigError
from gctd3.graph import KinematicGraph
from gctd3.nn import Network, make_actor, make_critic, make_stochastic_actor
from gctd3.reflection import Reflection

Metrics = dict[str, Tensor]


@dataclass(frozen=True)
class Architecture:
    """What networks are built from.

    Attributes:
        graph: The robot's graph.
        network: Kind and sizes.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        privileged_dim: Length of the critics' extra input, 0 for none.
        reflection: How the robot looks in the mirror; equivariant networks need it.
    """

    graph: KinematicGraph
    network: Network
    in_features: int
    action_dim: int
    privileged_dim: int = 0
    reflection: Reflection | None = None

    def actor(self) -> TensorDictModule:
        """A fresh deterministic policy."""
        return make_actor(self.graph, self.in_features, self.action_dim, self.network, self.reflection)

    def stochastic_actor(self) -> TensorDictModuleBase:
        """A fresh Gaussian policy."""
        return make_stochastic_actor(self.graph, self.in_features, self.action_dim, self.network, self.reflection)

    def critic(self) -> TensorDictModule:
        """A fresh action-value network."""
        sizes = self.in_features, self.action_dim
        return make_critic(self.graph, *sizes, self.network, self.privileged_dim, self.reflection)


@dataclass(frozen=True)
class AlgorithmSettings(ABC):
    """Hyperparameters that all algorithms share.

    Attributes:
        learning_rate: Of Adam, for every network.
        tau: Share of the trained parameters that enters the averaged ones at each target update.
        gamma: Discount factor.
        average_policy: Whether evaluations use the averaged actor rather than the trained one.
        privileged_critic: Whether the critics also see how near each time-based ending is.
    """

    learning_rate: float = 3e-4
    tau: float = 0.005
    gamma: float = 0.99
    average_policy: bool = True
    privileged_critic: bool = False

    def __post_init__(self) -> None:
        if not self.learning_rate > 0:
            raise ConfigError(f"learning_rate must be above 0, got {self.learning_rate}.")
        if not 0 < self.tau <= 1:
            raise ConfigError(f"tau must be in (0, 1], got {self.tau}.")
        if not 0 <= self.gamma < 1:
            raise ConfigError(f"gamma must be in [0, 1), got {self.gamma}.")

    @abstractmethod
    def build(self, architecture: Architecture) -> Algorithm:
        """The algorithm, with fresh networks."""


class Algorithm(ABC):
    """Trains an actor from batches of transitions.

    Attributes:
        actor: The policy under training; collecting uses it.
        loss: The TorchRL loss that holds all parameters.
        updates: Updates so far.
    """

    actor: TensorDictModuleBase
    loss: LossModule
    settings: AlgorithmSettings

    def __init__(self) -> None:
        self.updates = 0
        self.optimizers: dict[str, torch.optim.Optimizer] = {}

    @abstractmethod
    def update(self, batch: TensorDictBase) -> Metrics:
        """One update on a batch of size ``[B]``; returns scalars to log."""

    @abstractmethod
    def averaged_actor_params(self) -> TensorDictBase:
        """Parameters of the averaged actor."""

    def policy(self) -> TensorDictModuleBase:
        """A copy of the actor to evaluate and ship: averaged if the settings say so, without gradients."""
        policy = copy.deepcopy(self.actor).requires_grad_(False).eval()
        if self.settings.average_policy:
            self.averaged_actor_params().data.clone().to_module(policy)
        return policy

    def optimizer(self, name: str, parameters: Iterable[nn.Parameter]) -> torch.optim.Optimizer:
        """A new Adam over the trainable ones of ``parameters``, saved under ``name``."""
        trainable = [p for p in parameters if isinstance(p, nn.Parameter) and p.requires_grad]
        self.optimizers[name] = torch.optim.Adam(trainable, lr=self.settings.learning_rate, fused=True)
        return self.optimizers[name]

    def state_dict(self) -> dict[str, Any]:
        """All parameters, targets, optimisers and counts."""
        return {
            "updates": self.updates,
            "loss": self.loss.state_dict(),
            "optimizers": {name: optimizer.state_dict() for name, optimizer in self.optimizers.items()},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        self.updates = int(state["updates"])
        self.loss.load_state_dict(state["loss"])
        for name, optimizer in self.optimizers.items():
            optimizer.load_state_dict(state["optimizers"][name])


def minimize(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    """One step down the gradient of ``loss``."""
    optimizer.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()
