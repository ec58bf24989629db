#!/usr/bin/env bash
# Expected: mj_setConst(model, data), called after a mass was changed, recomputes the model's constants; the robot in
#   data goes on from where it is.
# Instead: data comes back with its positions at the joints' spring references (0 for most): the robot stands at its
#   origin with straight legs, while its velocities, its clock and its control are as before. Give it an MjData of its
#   own.
# Versions: mujoco 3.17.0.
# Matters for: a payload, a lost limb or another mass in the middle of an episode.
# Source: MuJoCo's documentation names the function for this purpose; that data is written to is not said there.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6
venv/bin/python - <<'PY'
import mujoco

LEG = """<mujoco><worldbody><geom type="plane" size="5 5 1"/>
<body name="trunk" pos="0 0 0.6"><freejoint/><geom type="box" size="0.2 0.1 0.05" mass="5"/>
<body pos="0 0 -0.05"><joint name="hip" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2"/>
<body pos="0 0 -0.2"><joint name="knee" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2"/>
</body></body></body></worldbody></mujoco>"""
model = mujoco.MjModel.from_xml_string(LEG)
print("mujoco", mujoco.__version__)


def walking():
    data = mujoco.MjData(model)
    data.qpos[:] = [7.0, 0.5, 0.5, 1.0, 0.0, 0.0, 0.0, 0.6, -1.2]
    data.qvel[0], data.time = 1.0, 3.0
    return data


def show(when, data):
    legs = data.qpos[7:].round(2)
    print(f"{when:46} x {data.qpos[0]:.1f} m, hip and knee {legs} rad, {data.qvel[0]:.1f} m/s, {data.time:.0f} s")


data = walking()
show("walking", data)
model.body("trunk").mass[0] += 2.0
mujoco.mj_setConst(model, mujoco.MjData(model))
show("after a payload, mj_setConst with other data", data)
assert (data.qpos == walking().qpos).all()
mujoco.mj_setConst(model, data)
show("after mj_setConst with the robot's data", data)
assert data.qpos[0] == 0 and (data.qpos[7:] == 0).all() and data.qvel[0] == 1.0 and data.time == 3.0
PY
