"""Settings of the algorithms. Light: networks and PyTorch are imported when an algorithm is built."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gctd3.errors import ConfigError
from gctd3.nn.settings import Scale

if TYPE_CHECKING:
    from gctd3.algorithms.base import Algorithm, Architecture


@dataclass(frozen=True)
class ImitationSettings:
    """Hold the settings of imitation: the policy begins as the fittest of the gaits that evolve in the warm-up.

    A policy that observes a clock (:class:`.GaitClock`) acts as the gait does at that time; one that observes none
    learns from what robots observed and did in the warm-up's last round, which collectors in other processes do not
    record. A policy that begins as that of another run (``init``) is held to that one instead.

    Attributes:
        updates: Updates of the actor towards the gait, before the first one of the critics; 0 for no imitation. A
            policy of another run needs none of them, but is held to only if there are some.
        initial_learning_rate: Learning rate at the first of these updates, from which it falls linearly to 0, so that
            the last batches are not followed more than the others; ``None`` for the algorithm's, which stays.
        retries: Times that the training begins again with a new warm-up, when a policy that still is the gait misses
            conditions that would end the training: another gait is found sooner than learning mends one.
        critics_first: Updates of the critics that follow before the actor learns on.
        weight: Factor of the mean squared difference from the gait's actions in the actor's loss, in the unit of that
            loss (TD3+BC, arXiv:2106.06860, has 0.4 for data).
        fade: Updates over which the factor falls to 0.
    """

    updates: int = 0
    initial_learning_rate: float | None = None
    retries: int = 0
    critics_first: int = 1000
    weight: float = 12.0
    fade: int = 8000

    def __post_init__(self) -> None:
        for name in ("updates", "retries", "critics_first"):
            if getattr(self, name) < 0:
                raise ConfigError(f"{name} must be at least 0, got {getattr(self, name)}.")
        if self.initial_learning_rate is not None and not self.initial_learning_rate > 0:
            raise ConfigError(f"initial_learning_rate must be above 0, or null, got {self.initial_learning_rate}.")
        if self.weight < 0:
            raise ConfigError(f"weight must be at least 0, got {self.weight}.")
        if self.fade < 1:
            raise ConfigError(f"fade must be at least 1, got {self.fade}.")


@dataclass(frozen=True)
class AlgorithmSettings(ABC):
    """Hold the hyperparameters that all algorithms share.

    Attributes:
        learning_rate: Learning rate of Adam, for every network (Table 4).
        tau: Share of the trained parameters that enters the averaged ones at each target update; the paper's is 0.001.
        gamma: Discount factor (Table 4).
        average_policy: Evaluate the averaged actor, which is steadier than the trained one.
        privileged_critic: Let the critics see how near each time-based ending is, and the features of task.privileged;
            the policy never does.
        compile: Compile the losses with torch.compile, into CUDA graphs on a GPU; on a CPU it costs more than it saves.
    """

    learning_rate: float = 3e-4
    tau: float = 0.005
    gamma: float = 0.99
    average_policy: bool = True
    privileged_critic: bool = True
    compile: bool = False

    def __post_init__(self) -> None:
        if not self.learning_rate > 0:
            raise ConfigError(f"learning_rate must be above 0, got {self.learning_rate}.")
        if not 0 < self.tau <= 1:
            raise ConfigError(f"tau must be in (0, 1], got {self.tau}.")
        if not 0 <= self.gamma < 1:
            raise ConfigError(f"gamma must be in [0, 1), got {self.gamma}.")

    @abstractmethod
    def build(self, architecture: Architecture) -> Algorithm:
        """Build the algorithm, with newly initialised networks."""


@dataclass(frozen=True)
class TD3Settings(AlgorithmSettings):
    """Hold the hyperparameters of TD3.

    Attributes:
        policy_delay: Critic updates for each update of the actor and the targets (Table 4).
        policy_noise: Standard deviation of the noise on the target's actions (half a joint's range).
        noise_clip: Largest size of that noise (half a joint's range).
    """

    policy_delay: int = 2
    policy_noise: float = 0.2
    noise_clip: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.policy_delay < 1:
            raise ConfigError(f"policy_delay must be at least 1, got {self.policy_delay}.")
        if self.policy_noise < 0 or self.noise_clip < 0:
            raise ConfigError(
                f"policy_noise and noise_clip must be at least 0, got {self.policy_noise} and {self.noise_clip}."
            )

    def build(self, architecture: Architecture) -> Algorithm:
        """Build the algorithm, with newly initialised networks."""
        from gctd3.algorithms.td3 import TD3

        return TD3(self, architecture)


@dataclass(frozen=True)
class DDPGSettings(AlgorithmSettings):
    """Hold the hyperparameters of DDPG: those that all algorithms share."""

    def build(self, architecture: Architecture) -> Algorithm:
        """Build the algorithm, with newly initialised networks."""
        from gctd3.algorithms.ddpg import DDPG

        return DDPG(self, architecture)


@dataclass(frozen=True)
class SACSettings(AlgorithmSettings):
    """Hold the hyperparameters of SAC.

    Attributes:
        alpha: Initial temperature.
        scale: Function that makes a standard deviation of the policy's output: ``exp``, as in the code of SAC's
            authors, or ``softplus``, as in TorchRL.
    """

    alpha: float = 0.2
    scale: Scale = "softplus"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.alpha > 0:
            raise ConfigError(f"alpha must be above 0, got {self.alpha}.")

    def build(self, architecture: Architecture) -> Algorithm:
        """Build the algorithm, with newly initialised networks."""
        from gctd3.algorithms.sac import SAC

        return SAC(self, architecture)
