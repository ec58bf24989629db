"""A TensorDictModule without TensorDict's questions about what its network returns."""

from __future__ import annotations

from tensordict.nn import TensorDictModule

from gctd3.compat import PlainOutputs


class PlainModule(PlainOutputs, TensorDictModule):
    """Write what a network returns, which are tensors, as it is."""


PLAIN = TensorDictModule, PlainModule  # types of modules that do nothing around a network but read and write keys
