"""gctd3: graph-structured off-policy policies for legged robots, on TorchRL.

Light to import: nothing heavy is loaded until it is used.
"""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gctd3.checkpoint import load_policy as load_policy
    from gctd3.envs.factory import make_env as make_env
    from gctd3.graph import KinematicGraph as KinematicGraph
    from gctd3.nn import make_actor as make_actor
    from gctd3.nn import make_critic as make_critic
    from gctd3.nn import make_stochastic_actor as make_stochastic_actor
    from gctd3.robot import Robot as Robot

__version__ = "0.1.0"

_HOME = {
    "KinematicGraph": "gctd3.graph",
    "Robot": "gctd3.robot",
    "load_policy": "gctd3.checkpoint",
    "make_actor": "gctd3.nn",
    "make_critic": "gctd3.nn",
    "make_env": "gctd3.envs.factory",
    "make_stochastic_actor": "gctd3.nn",
}
__all__ = sorted(_HOME)

# On a robot, where gctd3.deploy runs, it may be missing.
with suppress(ModuleNotFoundError):
    import gymnasium

    gymnasium.register(
        id="gctd3/Biped-v0",
        entry_point="gctd3.envs.gym:BipedEnv",
        vector_entry_point="gctd3.envs.gym:BipedVectorEnv",
    )


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any of the names above
    if name not in _HOME:
        raise AttributeError(f"module 'gctd3' has no attribute {name!r}; it has {', '.join(__all__)}.")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
