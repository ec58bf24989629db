"""Networks over a kinematic graph, as plain modules and as TensorDictModules. Light: imported when used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gctd3.nn.actor import Actor as Actor
    from gctd3.nn.critic import Critic as Critic
    from gctd3.nn.encoder import FlatEncoder as FlatEncoder
    from gctd3.nn.encoder import GraphEncoder as GraphEncoder
    from gctd3.nn.equivariance import Symmetric as Symmetric
    from gctd3.nn.factories import make_actor as make_actor
    from gctd3.nn.factories import make_critic as make_critic
    from gctd3.nn.factories import make_stochastic_actor as make_stochastic_actor
    from gctd3.nn.graph_conv import ChebyshevConv as ChebyshevConv
    from gctd3.nn.graph_conv import GraphConv as GraphConv
    from gctd3.nn.readout import JointReadout as JointReadout
    from gctd3.nn.readout import PooledReadout as PooledReadout
    from gctd3.nn.settings import Network as Network
    from gctd3.nn.settings import NetworkSettings as NetworkSettings

_HOME = {
    "Actor": "gctd3.nn.actor",
    "ChebyshevConv": "gctd3.nn.graph_conv",
    "Critic": "gctd3.nn.critic",
    "FlatEncoder": "gctd3.nn.encoder",
    "GraphConv": "gctd3.nn.graph_conv",
    "GraphEncoder": "gctd3.nn.encoder",
    "JointReadout": "gctd3.nn.readout",
    "Network": "gctd3.nn.settings",
    "NetworkSettings": "gctd3.nn.settings",
    "PooledReadout": "gctd3.nn.readout",
    "Symmetric": "gctd3.nn.equivariance",
    "make_actor": "gctd3.nn.factories",
    "make_critic": "gctd3.nn.factories",
    "make_stochastic_actor": "gctd3.nn.factories",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any of the names above
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}.")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
