"""The uncompiled file of a robot, for what is added to its model later, such as terrain."""

from __future__ import annotations

from collections.abc import Callable

import mujoco


class Blueprint:
    """Hold how to read a robot's file again, uncompiled; it does not follow its robot into other processes.

    Args:
        read: Function that returns a new copy of the completed spec.
    """

    def __init__(self, read: Callable[[], mujoco.MjSpec]) -> None:
        self._read = read

    def spec(self) -> mujoco.MjSpec:
        """Return a new copy of the completed spec."""
        return self._read()

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        return type(None), ()
