"""ROS 1: the nodes by rospy, and a master of their own."""

from __future__ import annotations

import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any
from urllib.parse import urlparse

from gctd3.bridge.messages import NANO, TYPES, Kind, Topic
from gctd3.bridge.middleware import Middleware
from gctd3.bridge.packing import fill, plain
from gctd3.errors import MiddlewareError, one_line

MASTER_URI, ADDRESSES = "ROS_MASTER_URI", ("ROS_HOSTNAME", "ROS_IP")
LOOPBACK, PORT = "127.0.0.1", 11311
REACH = 2.0  # for a master to answer (s)
# gazebo_msgs is part of Gazebo, and not of Debian; its definitions, from which rospy makes the types at run time.
_CONTACTS = """Header header
gazebo_msgs/ContactState[] states
"""
_CONTACT = """MSG: gazebo_msgs/ContactState
string info
string collision1_name
string collision2_name
geometry_msgs/Wrench[] wrenches
geometry_msgs/Wrench total_wrench
geometry_msgs/Vector3[] contact_positions
geometry_msgs/Vector3[] contact_normals
float64[] depths
"""
_HEADER = "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
_WRENCH = "MSG: geometry_msgs/Wrench\nVector3 force\nVector3 torque\n"
_VECTOR = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"


def listen_at(address: str | None) -> str:
    """Choose the address at which this process' nodes and masters listen, and return it.

    Args:
        address: The address; ``None`` for the one in the environment, else the loopback one.

    Raises:
        MiddlewareError: If it is a name that does not resolve: ROS would deliver nothing, and not say so.
    """
    told = "listen"
    if address is None:
        told = next((name for name in ADDRESSES if os.environ.get(name)), told)
        address = os.environ.get(told) or LOOPBACK
    try:
        socket.getaddrinfo(address, None)
    except OSError as error:
        raise MiddlewareError(f"{told}={address}: this address cannot be resolved ({one_line(error)}).") from error
    for name in ADDRESSES:
        os.environ.pop(name, None)
    os.environ["ROS_HOSTNAME" if address == "localhost" else "ROS_IP"] = address
    return address


def find_master(address: str) -> str:
    """Return the URI of the master, if it answers.

    Args:
        address: Address at which this node listens.

    Raises:
        MiddlewareError: If there is none, or it could not reach this node.
    """
    uri = os.environ.setdefault(MASTER_URI, f"http://localhost:{PORT}")
    place = urlparse(uri)
    try:
        host, port = place.hostname, place.port
    except ValueError:
        host, port = None, None
    if host is None or port is None:
        raise MiddlewareError(f"{MASTER_URI} must be as http://localhost:{PORT}, got {uri!r}.")
    try:
        with socket.create_connection((host, port), timeout=REACH) as connection:
            here = str(connection.getpeername()[0])
    except OSError as error:
        raise MiddlewareError(
            f"There is no ROS master at {uri} ({one_line(error)}): start roscore or rosmaster --core, or set "
            f"{MASTER_URI}; node=both starts its own."
        ) from error
    import rosgraph

    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(REACH)
    try:
        if not rosgraph.is_master_online(uri):
            raise MiddlewareError(f"What answers at {uri} is no ROS master; {MASTER_URI} says where it is.")
    except OSError as error:
        raise MiddlewareError(f"What answers at {uri} is no ROS master ({one_line(error)}).") from error
    finally:
        socket.setdefaulttimeout(before)
    if _is_loopback(address) and not _is_loopback(here):
        raise MiddlewareError(
            f"The master at {uri} is elsewhere, and this node listens at {address} only, where no other machine "
            "reaches it: listen=ADDRESS gives one of this machine's addresses."
        )
    return uri


def _is_loopback(address: str) -> bool:
    return address in ("localhost", "::1") or address.startswith("127.")


def start_master(address: str | None) -> Any:  # noqa: ANN401 - rosmaster's
    """Start a master in this process at a free port, for this process and its children.

    Args:
        address: Address at which it listens, see :func:`listen_at`.

    Raises:
        MiddlewareError: If it does not answer.
    """
    own = listen_at(address)
    from rosmaster.master import Master

    with socket.socket() as probe:
        probe.bind((own, 0))
        port = probe.getsockname()[1]
    os.environ[MASTER_URI] = f"http://{own}:{port}"
    master = Master(port)
    master.start()
    import rosgraph

    began = time.monotonic()
    while not (master.ok() and rosgraph.is_master_online(os.environ[MASTER_URI])):
        if time.monotonic() - began > 5.0:
            raise MiddlewareError(f"The master at {os.environ[MASTER_URI]} does not answer.")
        time.sleep(0.02)
    return master


class Ros1(Middleware):
    """Exchange messages by rospy; a process has one such node.

    Args:
        node: Name of the node.
        listen: ``listen`` of :class:`.RosSettings`.

    Raises:
        MiddlewareError: If there is no master, or it could not reach this node.
    """

    def __init__(self, node: str, listen: str | None) -> None:
        super().__init__()
        address = listen_at(listen)
        self.where = f"ROS master at {find_master(address)}"
        if "ROS_LOG_DIR" not in os.environ:
            os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="gctd3_ros_")
        import rospy

        self._rospy = rospy
        self._publishers: dict[Topic, Any] = {}
        self._subscribers: dict[Topic, Any] = {}
        self._types: dict[Kind, Any] = {}
        rospy.init_node(node, disable_signals=True, disable_rosout=True)

    def advertise(self, topics: Iterable[Topic]) -> None:
        """Announce topics on which this node publishes."""
        for topic in topics:
            # A latched message has to outlast a slow subscriber; of the others only the newest counts.
            self._publishers[topic] = self._rospy.Publisher(
                topic.name, self._type(topic.kind), queue_size=10, tcp_nodelay=True, latch=topic.latched
            )

    def subscribe(self, topics: Iterable[Topic]) -> None:
        """Subscribe to topics."""
        for topic in topics:
            self._subscribers[topic] = self._rospy.Subscriber(
                topic.name, self._type(topic.kind), self._taker(topic), queue_size=10, tcp_nodelay=True
            )

    def _taker(self, topic: Topic) -> Callable[[Any], None]:
        return lambda message: self._inbox.put((topic, plain(topic.kind, message, _nanoseconds)))

    def serve(self, name: str, function: Callable[[], None]) -> None:
        """Offer a service of the type ``std_srvs/Empty``."""
        from std_srvs.srv import Empty, EmptyResponse

        def answer(_: object) -> Any:  # noqa: ANN401
            function()
            return EmptyResponse()

        self._rospy.Service(name, Empty, answer)

    def publish(self, topic: Topic, message: Any) -> None:  # noqa: ANN401
        """Publish a message on an advertised topic."""
        made = self._type(topic.kind)()
        self._publishers[topic].publish(fill(made, topic.kind, message, self._time, self._state))

    def lonely(self, topics: Iterable[Topic]) -> list[str]:
        """Return the names of those topics which have no other node at their other end."""
        ends = {**self._publishers, **self._subscribers}
        return [topic.name for topic in topics if ends[topic].get_num_connections() == 0]

    def now(self) -> int:
        """Return the time of day (ns)."""
        return time.time_ns()

    def close(self) -> None:
        """Leave the network; threads that rospy does not end get two seconds."""
        leaving = threading.Thread(target=self._rospy.signal_shutdown, args=("done",), daemon=True)
        leaving.start()
        leaving.join(2.0)

    def _type(self, kind: Kind) -> Any:  # noqa: ANN401
        if kind not in self._types:
            package, _, name = TYPES[kind].partition("/")
            try:
                module = __import__(f"{package}.msg", fromlist=[name])
                self._types[kind] = getattr(module, name)
            except ImportError:
                if kind != "contacts":
                    raise
                from genpy.dynamic import generate_dynamic

                between = "\n" + "=" * 80 + "\n"
                text = between.join([_CONTACTS, _HEADER, _CONTACT, _WRENCH, _VECTOR])
                made = generate_dynamic(TYPES[kind], text)
                self._types[kind] = made[TYPES[kind]]
                self._contact = made["gazebo_msgs/ContactState"]
        return self._types[kind]

    def _time(self, nanoseconds: int) -> Any:  # noqa: ANN401
        return self._rospy.Time(*divmod(nanoseconds, NANO))

    def _state(self) -> Any:  # noqa: ANN401
        if not hasattr(self, "_contact"):
            from gazebo_msgs.msg import ContactState

            self._contact = ContactState
        return self._contact()


def _nanoseconds(time: Any) -> int:  # noqa: ANN401 - genpy's
    return int(time.secs) * NANO + int(time.nsecs)
