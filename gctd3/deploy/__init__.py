"""Deploy: an exported policy on a robot, its contract, and the export.

Light: to run a policy needs NumPy and onnxruntime only.
"""

from gctd3.deploy.policy import Policy
from gctd3.errors import ContractError, ReadingError

__all__ = ["ContractError", "Policy", "ReadingError"]
