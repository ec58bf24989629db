"""Join the network of ROS 1 or ROS 2 as a node. Light."""

from __future__ import annotations

from gctd3.bridge.middleware import Middleware, choose
from gctd3.bridge.settings import Distribution


def join(asked: Distribution, node: str, listen: str | None) -> Middleware:
    """Join the network as a node.

    Args:
        asked: ``middleware`` of :class:`.RosSettings`.
        node: Name of the node.
        listen: ``listen`` of :class:`.RosSettings`.

    Raises:
        MiddlewareError: If it is not installed, or there is no master.
    """
    if choose(asked) == "ros1":
        from gctd3.bridge.ros1 import Ros1

        return Ros1(node, listen)
    from gctd3.bridge.ros2 import Ros2

    return Ros2(node)
