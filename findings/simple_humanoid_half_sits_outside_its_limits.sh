#!/usr/bin/env bash
# Expected: the left leg of example-robot-data's simple_humanoid has the limits of the right one, and the pose
#   half_sitting of its SRDF, its reference configuration, lies within them.
# Instead: from the second joint on, each joint of the left leg has the limits of the joint above it in the right leg:
#   angle, effort and speed. The left knee has the range and the torque of the hip joint above it: it bends backwards by
#   120 degrees, and by no more than 40 as a knee does. The left ankle has those of the knee, 300 N m for the right
#   one's 30. From the elbow on the left arm is shifted likewise. Both ankles' pitch has the range of a knee, so that
#   they cannot be flexed as half_sitting has them. Hence the pose is outside of 4 limits, in simple_humanoid_classical
#   of 3.
# Versions: example-robot-data 6.0.0.
# Matters for: inverse kinematics and planners, which stop at these limits or find no solution at the pose that they
#   start from, and servos that are made from the file's efforts: the left knee has half of the right one's torque.
# Source: simple_humanoid_description/urdf and srdf, from laas/simple_humanoid_description; no issue found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check --no-deps example-robot-data==6.0.0
venv/bin/python - <<'PY'
import sysconfig
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

(home,) = Path(sysconfig.get_paths()["purelib"]).rglob("simple_humanoid_description")
LIMITS = "lower", "upper", "effort", "velocity"
OUTSIDE = {
    "simple_humanoid": ["RLEG_ANKLE_P", "LLEG_HIP_P", "LLEG_KNEE", "LLEG_ANKLE_P"],
    "simple_humanoid_classical": ["RLEG_ANKLE_P", "LLEG_KNEE", "LLEG_ANKLE_P"],
}


def read(name):
    """Return the limits of the joints of simple_humanoid's file `name`, in its order, and the pose half_sitting."""
    joints = ElementTree.parse(home / "urdf" / f"{name}.urdf").getroot().iterfind("joint[limit]")
    limits = {joint.get("name"): tuple(float(joint.find("limit").get(key)) for key in LIMITS) for joint in joints}
    (state,) = ElementTree.parse(home / "srdf" / f"{name}.srdf").getroot().iterfind("group_state[@name='half_sitting']")
    pose = {joint.get("name"): joint.get("value").split() for joint in state}
    return limits, {joint: float(value[0]) for joint, value in pose.items() if joint in limits}


print("example-robot-data", version("example-robot-data"))
for name, expected in OUTSIDE.items():
    limits, pose = read(name)
    for limb, joints, same, shifted in (("LEG", 5, 1, 1), ("ARM", 7, 2, 3)):
        right = [joint for joint in limits if joint.startswith("R" + limb)][:joints]
        left = ["L" + joint[1:] for joint in right]
        print(f"{name}, {limb.lower()}: (lower rad, upper rad, effort N m, velocity rad/s)")
        for joint, other in zip(right, left):
            print(f"    {joint[1:]:15} right {limits[joint]}")
            print(f"    {'':15} left  {limits[other]}")
        alike = [limits[joint] == limits[other] for joint, other in zip(right, left)]
        assert all(alike[:same]) and not any(alike[same:])
        assert all(limits[other] == limits[above] for other, above in zip(left[shifted:], right[shifted - 1 :]))
    outside = {joint: angle for joint, angle in pose.items() if not limits[joint][0] <= angle <= limits[joint][1]}
    print(f"{name}, half_sitting: outside of the limits are", outside)
    assert list(outside) == expected and limits["RLEG_ANKLE_R"] == limits["LLEG_ANKLE_R"]
    assert limits["LLEG_KNEE"][:3] == (-2.095, 0.7, 160) and limits["RLEG_KNEE"][:3] == (0, 2.618, 300)
PY
