"""Middleware: what the nodes need of ROS 1 or ROS 2, and the choice between them. Light."""

from __future__ import annotations

import queue
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

from gctd3.bridge.messages import Topic
from gctd3.bridge.settings import Distribution
from gctd3.errors import MiddlewareError

DEBIAN = Path("/usr/lib/python3/dist-packages")  # where Debian's packages of ROS 1 are
DEBIAN_PYTHON = Path("/usr/bin/python3")
ROS1_LINE = (
    "apt-get install -y --no-install-recommends python3-rospy python3-rosmaster python3-std-msgs python3-sensor-msgs "
    "python3-std-srvs python3-geometry-msgs"
)
ROS2_LINE = "pip install 'gctd3[ros2]'"
POLL = 0.02  # between two looks whether the other node is there (s)
NOTICE = 2.0  # of waiting, after which a line says so (s)


class Middleware(ABC):
    """Exchange messages with other nodes; what arrives waits in one inbox, in its order.

    Attributes:
        where: What the node is connected to, for messages.
    """

    where: str

    def __init__(self) -> None:
        self._inbox: queue.SimpleQueue[tuple[Topic, Any]] = queue.SimpleQueue()

    @abstractmethod
    def advertise(self, topics: Iterable[Topic]) -> None:
        """Announce topics on which this node publishes."""

    @abstractmethod
    def subscribe(self, topics: Iterable[Topic]) -> None:
        """Subscribe to topics."""

    @abstractmethod
    def serve(self, name: str, function: Callable[[], None]) -> None:
        """Offer a service of the type ``std_srvs/Empty``; the function runs in a thread of its own."""

    @abstractmethod
    def publish(self, topic: Topic, message: Any) -> None:  # noqa: ANN401 - by the topic's kind
        """Publish a message on an advertised topic."""

    @abstractmethod
    def lonely(self, topics: Iterable[Topic]) -> list[str]:
        """Return the names of those topics which have no other node at their other end."""

    @abstractmethod
    def now(self) -> int:
        """Return the time of day (ns)."""

    @abstractmethod
    def close(self) -> None:
        """Leave the network."""

    def receive(self, timeout: float) -> tuple[Topic, Any] | None:
        """Return the next message and its topic, ``None`` if there is none within ``timeout`` (s)."""
        try:
            return self._inbox.get(timeout=timeout) if timeout > 0 else self._inbox.get_nowait()
        except queue.Empty:
            return None

    def meet(self, topics: Iterable[Topic], wait: float, say: Callable[[str], None]) -> None:
        """Wait until another node is at the other end of every topic.

        Args:
            topics: The topics.
            wait: Longest time (s).
            say: Function that shows a line for those who wait.

        Raises:
            MiddlewareError: If a topic is still without one.
        """
        topics, began, told = tuple(topics), time.monotonic(), False
        while missing := self.lonely(topics):
            spent = time.monotonic() - began
            text = f"nobody is at the other end of {', '.join(missing)} ({self.where})"
            if spent > wait:
                raise MiddlewareError(f"After {wait:g} s {text}.")
            if spent > NOTICE and not told:
                say(f"Waiting for the other node: {text}.")
                told = True
            time.sleep(POLL)

    def __enter__(self) -> Middleware:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def find_ros1() -> str | None:
    """Make rospy importable, and return why it is not; ``None`` if it is.

    Debian's packages are found behind those of the environment that runs, as it needs its own NumPy.
    """
    if find_spec("rospy") is not None:
        return None
    if find_spec("rclpy") is not None:
        return "this environment has ROS 2, whose messages have the names of ROS 1's: ROS 1 needs another environment"
    if not (DEBIAN / "rospy").is_dir():
        return f"ROS 1 needs rospy: {ROS1_LINE}"
    theirs = DEBIAN_PYTHON.resolve().name.removeprefix("python")
    mine = f"{sys.version_info.major}.{sys.version_info.minor}"
    if theirs != mine:
        return f"ROS 1 of {DEBIAN} is for Python {theirs}, and this is {mine}: use an environment of that Python."
    if str(DEBIAN) not in sys.path:
        sys.path.append(str(DEBIAN))
    return None


def find_ros2() -> str | None:
    """Return why rclpy cannot be imported; ``None`` if it can."""
    return None if find_spec("rclpy") is not None else f"ROS 2 needs rclpy: {ROS2_LINE}, in an environment of its own"


def choose(asked: Distribution) -> Distribution:
    """Return the middleware that is asked for, or the first that can be imported.

    Raises:
        MiddlewareError: If it cannot be imported; the message says what brings it.
    """
    reasons = {name: find() for name, find in (("ros1", find_ros1), ("ros2", find_ros2)) if asked in ("auto", name)}
    for name, reason in reasons.items():
        if reason is None:
            return "ros1" if name == "ros1" else "ros2"
    raise MiddlewareError(f"{'; or '.join(str(reason) for reason in reasons.values())}.")
