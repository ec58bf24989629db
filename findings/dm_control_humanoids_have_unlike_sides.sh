#!/usr/bin/env bash
# Expected: the right half of a humanoid is the mirror image of the left one, and so are the limits of its joints.
# Instead: in three of dm_control's four humanoids one pair of joints is not. In the suite's humanoid the left hip bends
#   by 120 degrees and the right one by 110. In the suite's humanoid_CMU both forearms turn from -180 to 0 degrees about
#   mirrored axes, one inwards and one outwards; in V2019 and V2020 they are right. In V2020 both shoulders turn from
#   -63 to 90 degrees about mirrored axes: the left elbow gets 0.26 m above its shoulder and 0.29 m below it, the right
#   one the other way round. The position control scales actions to these ranges, so action 0 raises the right elbow
#   and lowers the left one.
# Versions: dm_control 1.0.50, mujoco 3.17.0.
# Matters for: mirrored experience, symmetric policies and measures of symmetry, in much used benchmarks, and for motion
#   capture, which has to be fitted to these limits.
# Source: openai/gym pull request 932, merged in 2019, mended the same numbers at the hip of Gym's humanoid; of
#   dm_control none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check dm_control==1.0.50 mujoco==3.17.0 numpy==2.2.6
export MUJOCO_GL=disabled
venv/bin/python - <<'PY'
from importlib.metadata import version

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.locomotion.walkers import cmu_humanoid
from dm_control.suite import humanoid, humanoid_CMU


def suite(module):
    return mujoco.MjModel.from_xml_string(*module.get_model_and_assets())


def walker(kind):
    arena = composer.Arena()
    arena.attach(kind())
    return mjcf.Physics.from_mjcf_model(arena.mjcf_model).model.ptr


def mirrored(name):
    """Return the name that the partner of a joint on the left has, or None."""
    path, slash, last = name.rpartition("/")
    for left, right in (("left", "right"), ("l", "r")):
        if last.startswith(left):
            return path + slash + right + last[len(left) :]
    return None


def unlike(model):
    """Return the joints on the left whose partner has another range, with both in degrees, about mirrored axes."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    names = [model.joint(number).name for number in range(model.njnt)]
    pairs = [(name, mirrored(name)) for name in names if mirrored(name) in names]
    apart = sum(np.abs(data.joint(left).xanchor - data.joint(right).xanchor) for left, right in pairs)
    flip = np.where(np.arange(3) == apart.argmax(), -1, 1)  # the side is along x in some files, along y in others
    found = {}
    for left, right in pairs:
        same = np.dot(-flip * data.joint(left).xaxis, data.joint(right).xaxis)  # rotations are mirrored like this
        assert np.isclose(abs(same), 1, atol=1e-3)
        ours, theirs = model.joint(left).range, model.joint(right).range
        theirs = theirs if same > 0 else -theirs[::-1]
        if not np.allclose(ours, theirs, atol=1e-3):
            degrees = np.rad2deg([ours, theirs]).round().astype(int)
            found[left.rpartition("/")[2]] = degrees.tolist()
    return len(pairs), found


print(*(f"{name} {version(name)}" for name in ("dm_control", "mujoco")))
newer = walker(cmu_humanoid.CMUHumanoidPositionControlledV2020)
for name, model, expected in (
    ("suite, humanoid", suite(humanoid), {"left_hip_y": [[-120, 20], [-110, 20]]}),
    ("suite, humanoid_CMU", suite(humanoid_CMU), {"lwristry": [[-180, 0], [0, 180]]}),
    ("CMU humanoid V2019", walker(cmu_humanoid.CMUHumanoidPositionControlled), {}),
    ("CMU humanoid V2020", newer, {"lhumerusrz": [[-63, 90], [-90, 63]]}),
):
    pairs, found = unlike(model)
    print(f"{name}: of {pairs} pairs {len(found)} unlike; left joint, its range and its partner's, mirrored: {found}")
    assert found == expected and pairs > 8

data = mujoco.MjData(newer)
heights = {}
for side in "lr":
    joint, servo = newer.joint(f"walker/{side}humerusrz"), newer.actuator(f"walker/{side}humerusrz")
    target = -servo.biasprm[0] / servo.biasprm[1]  # the angle that action 0 asks for
    for angle in (*joint.range, target):
        data.qpos[:] = 0
        data.qpos[joint.qposadr[0]] = angle
        mujoco.mj_kinematics(newer, data)
        elbow = data.body(f"walker/{side}radius").xpos - data.body(f"walker/{side}humerus").xpos
        heights.setdefault(side, []).append(round(float(elbow[1]), 2))  # y is up in this body
print("V2020's elbows above their shoulders (m), at the lower limit, the upper limit and action 0:", heights)
assert heights["l"] == [0.26, -0.29, -0.07] and heights["r"] == [-0.26, 0.29, 0.07]
PY
