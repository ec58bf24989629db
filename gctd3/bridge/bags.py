"""Bags of a walk: the topics that the nodes exchange, as a file of ROS 1 or ROS 2. Needs rosbags, and no ROS."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gctd3.bridge.messages import NANO, TYPES, JointSample, Kind, Topic
from gctd3.bridge.names import CLOCK, topic_name
from gctd3.errors import RunError
from gctd3.evaluation.episode import Episode
from gctd3.files import quoted, write_bytes
from gctd3.robots.robot import Robot

BEGIN = 1 * NANO  # time of the first command (ns): a time of 0 means none in ROS
STATES, COMMANDS = Topic("/joint_states", "joints"), Topic("/joint_command", "joints")
Stamped = tuple[int, Topic, Any]  # time (ns), topic, message


def write_walk(path: str | Path, episode: Episode, robot: Robot, dt: float) -> str:
    """Write a bag of an episode, and return a line that says so.

    Args:
        path: File to write, ``.bag`` for ROS 1 or ``.mcap`` for ROS 2; one that is there is replaced.
        episode: The episode, with its motion.
        robot: Its robot.
        dt: Control period (s).

    Raises:
        RunError: If the episode's motion was not recorded.
        OSError: If the file cannot be written.
    """
    messages = list(walk_messages(episode, robot, dt))
    write_bytes(Path(path), bag(Path(path).suffix, messages))
    topics = len({topic.name for _, topic, _ in messages})
    return f"{len(messages):,} messages of {topics} topics, {len(episode.position) * dt:.2f} s, in {quoted(Path(path))}"


def walk_messages(episode: Episode, robot: Robot, dt: float) -> Iterator[Stamped]:
    """Yield the messages of an episode in the order of their time.

    Each command comes a control period before the states, the contacts and the body's height and velocity after it.

    Args:
        episode: The episode, with its motion.
        robot: Its robot.
        dt: Control period (s).

    Raises:
        RunError: If the episode's motion was not recorded.
    """
    motion = episode.motion
    if motion is None:
        raise RunError("A bag needs the motion of the episode, which was not recorded.")
    period, desired = round(dt * NANO), robot.desired_angles(motion.action)
    joints = tuple(joint.name for joint in robot.joints)
    contacts = [Topic(topic_name(f"down_{foot}"), "switch") for foot in robot.feet]
    body = Topic("/height_m", "number"), Topic("/velocity_m_s", "number")
    for step in range(len(episode.position)):
        begin, end = BEGIN + step * period, BEGIN + (step + 1) * period
        yield begin, CLOCK, begin
        yield begin, COMMANDS, JointSample(begin, "", tuple(robot.actuated), _floats(desired[step]))
        for topic, down in zip(contacts, episode.feet_down[step], strict=True):
            yield end, topic, bool(down)
        for topic, value in zip(body, (episode.height[step], motion.velocity[step]), strict=True):
            yield end, topic, float(value)
        yield end, STATES, JointSample(end, "", joints, _floats(motion.angles[step]), _floats(motion.velocities[step]))


def _floats(values: np.ndarray) -> tuple[float, ...]:
    return tuple(np.asarray(values, dtype=np.float64).tolist())


def bag(suffix: str, messages: Iterable[Stamped]) -> bytes:
    """Return the content of a bag.

    Args:
        suffix: ``.bag`` for ROS 1, ``.mcap`` for ROS 2.
        messages: Its messages.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    ros1 = suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    with tempfile.TemporaryDirectory(prefix="gctd3_bag_") as folder:
        made = Path(folder) / "walk"
        writer = Writer1(made) if ros1 else Writer2(made, version=9, storage_plugin=StoragePlugin.MCAP)
        with writer:
            connections: dict[Topic, Any] = {}
            for time, topic, message in messages:
                kind = _type(topic.kind)
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic.name, kind, typestore=store)
                content = _message(store.types, topic.kind, message, ros1)
                pack = store.serialize_ros1 if ros1 else store.serialize_cdr
                writer.write(connections[topic], time, pack(content, kind))
        file = made if ros1 else next(made.glob("*.mcap"))
        return file.read_bytes()


def _type(kind: Kind) -> str:
    return TYPES[kind].replace("/", "/msg/")


def _message(types: Any, kind: Kind, value: Any, ros1: bool) -> Any:  # noqa: ANN401
    """Return a message of rosbags' types for a plain value, see :data:`.Kind`."""

    def time(nanoseconds: int) -> Any:  # noqa: ANN401
        return types["builtin_interfaces/msg/Time"](*divmod(nanoseconds, NANO))

    if kind == "joints":
        # A header of ROS 1 has a number besides.
        number = (0,) if ros1 else ()
        header = types["std_msgs/msg/Header"](*number, stamp=time(value.stamp), frame_id=value.frame)
        arrays = (np.array(values, dtype=np.float64) for values in (value.positions, value.velocities, ()))
        return types[_type(kind)](header, list(value.names), *arrays)
    return types[_type(kind)](time(value) if kind == "clock" else value)
