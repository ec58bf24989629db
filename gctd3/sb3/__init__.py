"""Graph policies for Stable-Baselines3: ``GraphExtractor``, and environments whose observations it reads."""

from __future__ import annotations

from importlib.util import find_spec

if find_spec("stable_baselines3") is None:
    raise ImportError("gctd3.sb3 needs Stable-Baselines3: pip install 'gctd3[sb3]'.")

from gctd3.envs.node_observation import NodeObservation as NodeObservation
from gctd3.envs.node_observation import VectorNodeObservation as VectorNodeObservation
from gctd3.sb3.extractor import GraphExtractor as GraphExtractor
from gctd3.sb3.vec_env import BatchedVecEnv as BatchedVecEnv

__all__ = ["BatchedVecEnv", "GraphExtractor", "NodeObservation", "VectorNodeObservation"]
