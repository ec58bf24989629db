#!/usr/bin/env bash
# Expected: mcap-ros2-support's writer refuses a message that does not fit its definition: a field's name misspelt, a
#   wrong number of joints.
# Instead: all of this is written, without a word. A field that is not there is 0, or empty, and a name that the
#   definition lacks is dropped. An array of fixed length is cut, or filled up with zeros: of a humanoid's 29 joint
#   angles in a float32[20] the last nine are gone; a quadruped's 12 get eight zeros, and on the way the caller's own
#   list gets eight None. A field of whole numbers cuts 0.9 to 0. The file is valid, and replays.
# Versions: mcap-ros2-support 0.6.0, mcap 1.6.0.
# Matters for: recorded references and commands of robots (Unitree's LowCmd has room for a fixed number of motors), and
#   data sets written without a ROS installation.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mcap-ros2-support==0.6.0 mcap==1.6.0
venv/bin/python - <<'PY'
import io
from importlib.metadata import version

from mcap_ros2.reader import read_ros2_messages
from mcap_ros2.writer import Writer

DEFINITION = """float64[] position
float64[] velocity
float32[20] target
int16 mode"""


def trip(**message):
    """Return the message as it comes back from a file."""
    file = io.BytesIO()
    writer = Writer(file)
    schema = writer.register_msgdef("legs_msgs/msg/Command", DEFINITION)
    writer.write_message("/command", schema, message, 0, 0)
    writer.finish()
    file.seek(0)
    (read,) = read_ros2_messages(file)
    return read.ros_msg


print(*(f"{name} {version(name)}" for name in ("mcap-ros2-support", "mcap")))
read = trip(position=[0.1, 0.2], velocity=[1.0, 2.0], target=[0.5] * 20, mode=1)
print("as it should be:", read)
assert (list(read.position), list(read.velocity), list(read.target)) == ([0.1, 0.2], [1, 2], [0.5] * 20)
assert read.mode == 1

read = trip(positions=[0.1, 0.2], velocity=[1.0, 2.0], target=[0.5] * 20)
print("'positions' for 'position', and no mode:", read)
assert list(read.position) == [] and list(read.velocity) == [1, 2] and read.mode == 0

humanoid = [round(0.1 * number, 1) for number in range(29)]
read = trip(target=humanoid, mode=0.9)
print(f"29 angles and a mode of 0.9: target {[round(angle, 1) for angle in read.target]}, mode {read.mode}")
assert len(read.target) == 20 and read.mode == 0

quadruped = [0.5] * 12
read = trip(target=quadruped)
print(f"12 angles: target {list(read.target)}")
print(f"the caller's list afterwards: {quadruped}")
assert list(read.target) == [0.5] * 12 + [0] * 8 and quadruped == [0.5] * 12 + [None] * 8
PY
