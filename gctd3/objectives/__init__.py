"""TorchRL's losses with twin critics as one batched module, and with critics that see more than the policy."""

from gctd3.objectives.sac import SACLoss
from gctd3.objectives.stacked import FusedSoftUpdate
from gctd3.objectives.td3 import TD3Loss

__all__ = ["FusedSoftUpdate", "SACLoss", "TD3Loss"]
