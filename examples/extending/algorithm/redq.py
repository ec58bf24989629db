"""An algorithm of one's own: REDQ (Chen et al. 2021, arXiv:2101.05982), around TorchRL's loss.

Train with it:

    PYTHONPATH=examples/extending/algorithm python -m gctd3.train \
        --config-dir=examples/extending/algorithm algo=redq
"""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import TensorDictBase
from torchrl.objectives import REDQLoss, SoftUpdate

from gctd3.algorithms.base import Algorithm, Architecture, Metrics
from gctd3.algorithms.settings import AlgorithmSettings
from gctd3.errors import ConfigError


@dataclass(frozen=True)
class REDQSettings(AlgorithmSettings):
    """Set the hyperparameters of REDQ.

    Attributes:
        critics: Critics in the ensemble (the paper's N).
        chosen: Critics of which the target takes the smallest value, drawn anew for each update (the paper's M).
    """

    critics: int = 5
    chosen: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.chosen <= self.critics:
            raise ConfigError(f"chosen must be from 1 to critics = {self.critics}, got {self.chosen}.")

    def build(self, architecture: Architecture) -> REDQ:
        """Build the algorithm, with fresh networks."""
        return REDQ(self, architecture)


class REDQ(Algorithm):
    """An ensemble of critics, of which a few drawn at random make each target, and a Gaussian actor."""

    LOSSES = ("forward",)

    def __init__(self, settings: REDQSettings, architecture: Architecture) -> None:
        super().__init__(settings.compile)
        self.settings = settings
        self.actor = architecture.stochastic_actor()
        self.loss = REDQLoss(
            self.actor,
            [architecture.critic() for _ in range(settings.critics)],
            num_qvalue_nets=settings.critics,
            sub_sample_len=settings.chosen,
            loss_function="l2",
            target_entropy=-float(architecture.action_dim),
        )
        self.loss.make_value_estimator(gamma=settings.gamma)
        _ = self.loss.target_entropy  # made when first asked for, and part of a checkpoint from then on
        self.targets = SoftUpdate(self.loss, tau=settings.tau)
        self.optimizer("critic", self.loss.qvalue_network_params.values(True, True))
        self.optimizer("actor", self.loss.actor_network_params.values(True, True))
        self.optimizer("alpha", [self.loss.log_alpha])

    def _update(self, batch: TensorDictBase) -> Metrics:
        """Make one update of the critics, the actor, the temperature and the targets."""
        losses = self.loss(batch)
        # TorchRL evaluates the actor once for all of them, so they share a graph; each reaches its own parameters only.
        for optimizer in self.optimizers.values():
            optimizer.zero_grad(set_to_none=True)
        (losses["loss_qvalue"] + losses["loss_actor"] + losses["loss_alpha"]).backward()
        for optimizer in self.optimizers.values():
            optimizer.step()
        self.targets.step()
        return {name: losses[name].detach() for name in ("loss_qvalue", "loss_actor", "alpha", "entropy")}

    def averaged_actor_params(self) -> TensorDictBase:
        """Return the actor's own: REDQ averages critics alone."""
        return self.loss.actor_network_params
