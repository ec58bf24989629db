"""The base of every algorithm: networks, a TorchRL loss, optimisers, an averaged policy for evaluation."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.objectives import LossModule

from gctd3.algorithms.adam import Adam
from gctd3.algorithms.imitation import Imitation
from gctd3.compat import import_compiler
from gctd3.nn.factories import make_actor, make_critic, make_stochastic_actor
from gctd3.nn.settings import NetworkSettings, Scale
from gctd3.robots.graph import KinematicGraph
from gctd3.tasks.reflection import Reflection

if TYPE_CHECKING:
    from gctd3.algorithms.settings import AlgorithmSettings

Metrics = dict[str, Tensor]
EAGER = 2  # updates before compiling, in which every loss is called once and gets its networks


@dataclass(frozen=True)
class Architecture:
    """Hold the arguments from which an algorithm's networks are built.

    Attributes:
        graph: The robot's graph.
        network: Kind and sizes of the networks.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        privileged_dim: Length of the critics' privileged input, 0 for none.
        reflection: The robot's mirror symmetry; equivariant networks need it.
        device: Device of the parameters.
    """

    graph: KinematicGraph
    network: NetworkSettings
    in_features: int
    action_dim: int
    privileged_dim: int = 0
    reflection: Reflection | None = None
    device: torch.device | str = "cpu"

    def actor(self) -> TensorDictModule:
        """Build a deterministic policy."""
        actor = make_actor(self.graph, self.in_features, self.action_dim, self.network, self.reflection)
        return actor.to(self.device)

    def stochastic_actor(self, scale: Scale = "softplus") -> TensorDictModuleBase:
        """Build a Gaussian policy; ``scale`` as in :func:`.make_stochastic_actor`."""
        sizes = self.in_features, self.action_dim
        return make_stochastic_actor(self.graph, *sizes, self.network, self.reflection, scale).to(self.device)

    def critic(self) -> TensorDictModule:
        """Build an action-value network."""
        sizes = self.in_features, self.action_dim
        critic = make_critic(self.graph, *sizes, self.network, self.privileged_dim, self.reflection)
        return critic.to(self.device)


class Algorithm(ABC):
    """Train an actor from batches of transitions.

    Attributes:
        actor: The policy under training, which also collects the transitions.
        loss: The TorchRL loss that holds all parameters.
        updates: Number of updates so far.
        imitation: Controller that the actor imitates, if any.
    """

    actor: TensorDictModuleBase
    loss: LossModule
    settings: AlgorithmSettings
    LOSSES: tuple[str, ...]  # methods of the loss that an update calls

    def __init__(self, compiled: bool = False) -> None:
        self.updates = 0
        self.optimizers: dict[str, torch.optim.Optimizer] = {}
        self.imitation: Imitation | None = None
        self._to_compile = compiled

    def update(self, batch: TensorDictBase) -> Metrics:
        """Update the networks on a batch of size ``[B]``, on the parameters' device, and return scalars to log."""
        if self._to_compile and self.updates == EAGER:
            self._compile()
        self.updates += 1
        return self._update(batch)

    @abstractmethod
    def _update(self, batch: TensorDictBase) -> Metrics:
        """Compute the update of :meth:`update`; ``updates`` already includes it."""

    def _compile(self) -> None:
        import_compiler()
        cuda = next(self.loss.parameters()).is_cuda
        for name in self.LOSSES:
            compiled = torch.compile(getattr(self.loss, name), mode="reduce-overhead" if cuda else "default")
            setattr(self.loss, name, _in_a_step(compiled) if cuda else compiled)

    @abstractmethod
    def averaged_actor_params(self) -> TensorDictBase:
        """Return the parameters of the averaged actor."""

    @property
    def critics_alone(self) -> bool:
        """Return whether this update is of the critics only."""
        return self.imitation is not None and self.imitation.critics_alone(self.updates)

    def imitating(self, loss: Tensor, batch: TensorDictBase) -> Tensor:
        """Return the actor's loss of a batch, with the term that pulls it towards :attr:`imitation`, if any."""
        return loss if self.imitation is None else self.imitation.add_to(loss, self.actor, batch, self.updates)

    def average_from_actor(self) -> None:
        """Set the averaged actor's parameters to the actor's."""
        self.averaged_actor_params().data.update_(TensorDict.from_module(self.actor).data)

    def policy(self) -> TensorDictModuleBase:
        """Return a copy of the actor on the CPU, without gradients, to evaluate; averaged if the settings say so."""
        policy = copy.deepcopy(self.actor).requires_grad_(False).eval()
        if self.settings.average_policy:
            self.averaged_actor_params().data.clone().to_module(policy)
        return policy.to("cpu")

    def optimizer(self, name: str, parameters: Iterable[nn.Parameter]) -> torch.optim.Optimizer:
        """Create an Adam optimiser of the trainable ones of ``parameters``, saved under ``name``."""
        trainable = [p for p in parameters if isinstance(p, nn.Parameter) and p.requires_grad]
        self.optimizers[name] = Adam(trainable, lr=self.settings.learning_rate)
        return self.optimizers[name]

    def state_dict(self) -> dict[str, Any]:
        """Return the state of all parameters, targets, optimisers and counts."""
        return {
            "updates": self.updates,
            "loss": self.loss.state_dict(),
            "optimizers": {name: optimizer.state_dict() for name, optimizer in self.optimizers.items()},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that :meth:`state_dict` returned."""
        self.updates = int(state["updates"])
        self.loss.load_state_dict(state["loss"])
        for name, optimizer in self.optimizers.items():
            optimizer.load_state_dict(state["optimizers"][name])


def _in_a_step(compiled: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function on CUDA graphs so that its next call does not overwrite its results, by copying them."""

    def call(batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        torch.compiler.cudagraph_mark_step_begin()  # type: ignore[no-untyped-call]
        loss, details = compiled(batch)
        return loss.clone(), {key: value.clone() for key, value in details.items()}

    return call


def minimize(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    """Take one optimisation step down the gradient of ``loss``."""
    optimizer.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()
