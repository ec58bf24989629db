#!/usr/bin/env bash
# Expected: Humanoid-v5 and HumanoidStandup-v5 have two legs alike.
# Instead: the left knee has a spring of 1 N m/rad that wants to stretch it, the right one has none. Floating without
#   gravity, with both knees let go of at 115 degrees, the left leg stretches in two seconds and the right one stays
#   bent. The hips' armature is 0.010 kg m^2 on the left and 0.008 on the right, and HumanoidStandup's left hip bends
#   10 degrees further.
# Versions: gymnasium 1.3.0, mujoco 3.17.0.
# Matters for: mirrored experience and symmetric policies, measures of limping and of symmetry, and results compared
#   with those of humanoids whose file is symmetric. The spring does work that the control cost does not see.
# Source: none found; the same lines stand in many copies of the file.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps --target robots gymnasium==1.3.0
venv/bin/python - <<'PY'
import mujoco
import numpy as np

print("mujoco", mujoco.__version__, "- gymnasium 1.3.0")
for name in ("humanoid", "humanoidstandup"):
    model = mujoco.MjModel.from_xml_path(f"robots/gymnasium/envs/mujoco/assets/{name}.xml")
    springs, reach, armature = [], [], []
    for side in ("left", "right"):
        knee, hip = model.joint(f"{side}_knee"), model.joint(f"{side}_hip_y")
        springs.append(float(knee.stiffness[0]))
        armature.append(float(hip.armature[0]))
        reach.append(round(float(np.rad2deg(hip.range[0]))))
    print(f"{name} (left, right): spring of the knee {springs} N m/rad, hip: armature {armature}, from {reach} deg")

    model.opt.gravity[:] = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    for side in ("left", "right"):
        data.joint(f"{side}_knee").qpos[0] = np.deg2rad(-115.0)
    angles = []
    for _ in range(4):
        for _ in range(round(0.5 / model.opt.timestep)):
            mujoco.mj_step(model, data)
        angles.append([round(float(np.rad2deg(data.joint(f"{side}_knee").qpos[0]))) for side in ("left", "right")])
    print("  knees let go of at -115 deg, after 0.5, 1, 1.5, 2 s (left, right):", angles)
    assert springs == [1.0, 0.0] and armature == [0.01, 0.008]
    assert reach == ([-110, -110] if name == "humanoid" else [-120, -110])
    assert angles[-1][0] > -40 and angles[-1][1] < -105
PY
