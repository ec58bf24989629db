"""Join the network of ROS 1 or ROS 2 as a node. Light."""

from __future__ import annotations

from importlib.util import find_spec

from gctd3.bridge.messages import TYPES
from gctd3.bridge.middleware import Middleware, choose
from gctd3.bridge.names import Layout
from gctd3.bridge.settings import Distribution
from gctd3.errors import MiddlewareError


def choose_for(asked: Distribution, layout: Layout) -> Distribution:
    """Return the middleware that is asked for, or the first that can be imported, if it has the topics' types.

    Args:
        asked: ``middleware`` of :class:`.RosSettings`.
        layout: The topics.

    Raises:
        MiddlewareError: If it cannot be imported, or lacks a type that pip does not bring.
    """
    chosen = choose(asked)
    contacts = any(topic.kind == "contacts" for topic in layout.sensors)
    if chosen == "ros2" and contacts and find_spec("gazebo_msgs") is None:
        raise MiddlewareError(
            f"names=authors sends the feet's contacts as {TYPES['contacts']}, a type of Gazebo classic, of which this "
            "ROS 2 has no package: names=paper sends them as std_msgs/Bool; middleware=ros1 makes the type by itself."
        )
    return chosen


def join(chosen: Distribution, node: str, listen: str | None) -> Middleware:
    """Join the network as a node.

    Args:
        chosen: What :func:`choose_for` returned.
        node: Name of the node.
        listen: ``listen`` of :class:`.RosSettings`.

    Raises:
        MiddlewareError: If there is no master.
    """
    if chosen == "ros1":
        from gctd3.bridge.ros1 import Ros1

        return Ros1(node, listen)
    from gctd3.bridge.ros2 import Ros2

    return Ros2(node)
