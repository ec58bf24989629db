#!/usr/bin/env bash
# Expected: mujoco.rollout steps the MjData that it is given, as mj_step does: a force in xfrc_applied pushes the
#   robot, an equality that was switched off stays off, and control is what it was.
# Instead: without a control_spec that names them, rollout clears applied forces and puts equalities back to the
#   model's own state before the first step; control, if none is passed, is kept. The push is gone without a word, in
#   data too.
# Versions: mujoco 3.17.0.
# Matters for: pushes and cut cables in batched environments that were written with mj_step first.
# Source: rollout's docstring calls control_spec the "specification of control vectors"; of what is left out it says
#   nothing.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6
venv/bin/python - <<'PY'
import mujoco
import numpy as np
from mujoco import rollout

ROBOT = """<mujoco><option gravity="0 0 0"/><worldbody>
<body name="trunk" pos="0 0 1"><freejoint/><geom size="0.1" mass="10"/>
<body pos="0.3 0 0"><joint name="hip" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.3" mass="0.1"/></body></body>
<body name="box" pos="0 2 1"><freejoint/><geom size="0.1" mass="1"/></body></worldbody>
<actuator><position joint="hip" kp="5" kv="0.2"/></actuator>
<equality><weld name="cable" body1="box"/></equality></mujoco>"""
model = mujoco.MjModel.from_xml_string(ROBOT)
STEPS, FULL = 100, mujoco.mjtState.mjSTATE_FULLPHYSICS


def pushed():
    data = mujoco.MjData(model)
    data.xfrc_applied[1, 0] = 50.0  # N forwards on the trunk
    data.xfrc_applied[3, 0] = 5.0  # N forwards on the box, which was cut loose
    data.eq_active[0] = 0
    data.ctrl[0] = 0.5
    return data


def show(how, state, data):
    speed, box, hip = state[1 + model.nq], state[1 + model.nq + 7], state[1 + 7]
    left = f"force then {data.xfrc_applied[1, 0]:.0f} N, cable {'on' if data.eq_active[0] else 'off'}"
    print(f"{how:37} trunk {speed:.2f} m/s, box {box:.2f} m/s, hip {hip:.2f} rad; {left}")
    return speed, box, hip


print("mujoco", mujoco.__version__)
data = pushed()
start, end = (np.empty(mujoco.mj_stateSize(model, FULL)) for _ in range(2))
mujoco.mj_getState(model, data, start, FULL)
for _ in range(STEPS):
    mujoco.mj_step(model, data)
mujoco.mj_getState(model, data, end, FULL)
stepped = show("mj_step", end, data)

data = pushed()
states, _ = rollout.rollout(model, data, start[None], nstep=STEPS)
rolled = show("rollout", states[0, -1], data)

spec = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_XFRC_APPLIED | mujoco.mjtState.mjSTATE_EQ_ACTIVE
data, control = pushed(), np.empty(mujoco.mj_stateSize(model, spec))
mujoco.mj_getState(model, data, control, spec)
told = np.tile(control, (1, STEPS, 1))
states, _ = rollout.rollout(model, data, start[None], told, control_spec=int(spec), nstep=STEPS)
named = show("rollout that is told, by control_spec", states[0, -1], data)
assert stepped[0] > 0.9 and stepped[1] > 0.9 and stepped[2] > 0.3 and np.allclose(named, stepped)
assert abs(rolled[0]) < 0.01 and abs(rolled[1]) < 0.01 and rolled[2] > 0.3
PY
