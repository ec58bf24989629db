#!/usr/bin/env bash
# Expected: joint positions given as an array of whole numbers to a field of float64 are converted, or refused.
# Instead: rosbags writes the array's bytes as they are: 1, 2, 3 are read back as 5e-324, 1e-323, 1.5e-323, zero in
#   all but name, without an error. A list is refused, and so is float32; int64 has the right width and passes.
# Versions: rosbags 0.11.9, numpy 2.2.6.
# Matters for: recorded references and commands of robots: np.zeros(12, int), np.arange, poses typed without a decimal
#   point.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check rosbags==0.11.9 numpy==2.2.6
venv/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from rosbags.rosbag2 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
kind = "sensor_msgs/msg/JointState"
JointState, Header, Time = (
    store.types[name] for name in (kind, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
)
nothing = np.array([], dtype=np.float64)


def through_a_bag(name, position):
    message = JointState(Header(Time(0, 0), ""), ["hip", "knee", "ankle"], position, nothing, nothing)
    with Writer(name, version=9) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        writer.write(connection, 0, store.serialize_cdr(message, kind))
    with Reader(name) as reader:
        ((connection, _, raw),) = reader.messages()
        return store.deserialize_cdr(raw, connection.msgtype).position


print("rosbags", version("rosbags"), "numpy", np.__version__)
floats = through_a_bag("floats", np.array([1.0, 2.0, 3.0]))
integers = through_a_bag("integers", np.array([1, 2, 3]))
print("written [1., 2., 3.] (float64), read", floats)
print("written [1, 2, 3] (int64), read", integers)
for wrong in ([1.0, 2.0, 3.0], np.array([1, 2, 3], dtype=np.float32)):
    try:
        through_a_bag(f"wrong_{type(wrong).__name__}", wrong)
        raise SystemExit("a list or float32 is taken now")
    except (AttributeError, ValueError) as error:
        print(f"written as {type(wrong).__name__} {getattr(wrong, 'dtype', '')}: {type(error).__name__}: {error}")
assert floats.tolist() == [1, 2, 3] and (integers > 0).all() and (integers < 1e-320).all()
PY
