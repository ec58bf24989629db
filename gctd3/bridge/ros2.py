"""ROS 2: the nodes by rclpy."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import Any

from gctd3.bridge.messages import NANO, TYPES, Kind, Topic
from gctd3.bridge.middleware import Middleware
from gctd3.bridge.packing import fill, plain
from gctd3.errors import MiddlewareError, one_line

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
DEPTH = 10  # messages that a topic keeps
SETTLE = 1.0  # from the match of two ends until messages are sure to arrive (s)


class Ros2(Middleware):
    """Exchange messages by rclpy, on this machine only unless ``ROS_AUTOMATIC_DISCOVERY_RANGE`` says otherwise.

    Args:
        node: Name of the node.

    Raises:
        MiddlewareError: If rclpy cannot begin.
    """

    def __init__(self, node: str) -> None:
        super().__init__()
        os.environ.setdefault(RANGE, "LOCALHOST")
        self.where = f"ROS 2, {RANGE}={os.environ[RANGE]}, ROS_DOMAIN_ID={os.environ.get('ROS_DOMAIN_ID', '0')}"
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.signals import SignalHandlerOptions

            self._context = rclpy.Context()
            rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
            self._node = rclpy.create_node(node, context=self._context, start_parameter_services=False)
        except Exception as error:  # rclpy's errors and those of its libraries share no base class
            raise MiddlewareError(f"ROS 2 cannot begin: {one_line(error)}.") from error
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._publishers: dict[Topic, Any] = {}
        self._subscribed: set[Topic] = set()
        self._matched: float | None = None
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        with contextlib.suppress(ExternalShutdownException, ShutdownException):
            self._executor.spin()

    def _quality(self, topic: Topic) -> Any:  # noqa: ANN401
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        kept = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
        return QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=kept)

    def advertise(self, topics: Iterable[Topic]) -> None:
        """Announce topics on which this node publishes."""
        for topic in topics:
            made = self._node.create_publisher(_type(topic.kind), topic.name, self._quality(topic))
            self._publishers[topic] = made

    def subscribe(self, topics: Iterable[Topic]) -> None:
        """Subscribe to topics."""
        for topic in topics:
            self._node.create_subscription(_type(topic.kind), topic.name, self._taker(topic), self._quality(topic))
            self._subscribed.add(topic)

    def _taker(self, topic: Topic) -> Callable[[Any], None]:
        return lambda message: self._inbox.put((topic, plain(topic.kind, message, _nanoseconds)))

    def serve(self, name: str, function: Callable[[], None]) -> None:
        """Offer a service of the type ``std_srvs/Empty``."""
        from std_srvs.srv import Empty

        def answer(_: object, response: Any) -> Any:  # noqa: ANN401
            function()
            return response

        self._node.create_service(Empty, name, answer)

    def publish(self, topic: Topic, message: Any) -> None:  # noqa: ANN401
        """Publish a message on an advertised topic."""
        made = _type(topic.kind)()
        self._publishers[topic].publish(fill(made, topic.kind, message, _time, _contact))

    def lonely(self, topics: Iterable[Topic]) -> list[str]:
        """Return the names of those topics which have no other node at their other end."""
        missing = []
        for topic in topics:
            if topic in self._publishers:
                there = self._publishers[topic].get_subscription_count()
            else:
                there = self._node.count_publishers(topic.name)
            if there == 0:
                missing.append(topic.name)
        # The first messages after a match can be lost.
        self._matched = None if missing else self._matched or time.monotonic()
        if self._matched is not None and time.monotonic() - self._matched < SETTLE:
            return [topic.name for topic in topics]
        return missing

    def now(self) -> int:
        """Return the time of day (ns)."""
        return time.time_ns()

    def close(self) -> None:
        """Leave the network."""
        self._executor.shutdown(timeout_sec=2.0)
        self._node.destroy_node()
        self._context.try_shutdown()
        self._thread.join(2.0)


def _type(kind: Kind) -> Any:  # noqa: ANN401
    package, _, name = TYPES[kind].partition("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except ImportError as error:
        raise MiddlewareError(
            f"ROS 2 lacks {package} here: pip install ros-kilted-{package.replace('_', '-')}."
        ) from error


def _time(nanoseconds: int) -> Any:  # noqa: ANN401
    from builtin_interfaces.msg import Time

    seconds, rest = divmod(nanoseconds, NANO)
    return Time(sec=seconds, nanosec=rest)


def _nanoseconds(time: Any) -> int:  # noqa: ANN401 - rclpy's
    return int(time.sec) * NANO + int(time.nanosec)


def _contact() -> Any:  # noqa: ANN401
    from gazebo_msgs.msg import ContactState

    return ContactState()
