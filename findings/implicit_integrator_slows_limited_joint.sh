#!/usr/bin/env bash
# Expected: a servo of 10 N m gives 10 N m, whether the limit stands at the joint (actuatorfrcrange) or at the
#   actuator (forcerange).
# Instead: with the integrators implicit and implicitfast, a servo with kv that runs into the joint's limit
#   accelerates its link by 0.29 of what 10 N m give: the derivative of its damping is taken as if it were still
#   acting. With Euler, or with forcerange, it is right. The reported force differs as well: actuator_force says 200 N
#   m.
# Versions: mujoco 3.17.0.
# Matters for: MuJoCo Menagerie's Unitree G1 and Booster T1 (joint limits and implicitfast), every URDF (effort
#   becomes the joint's limit), and energy, torque and saturation computed from actuator_force.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6
venv/bin/python - <<'PY'
import mujoco

LINK = """<mujoco><option gravity="0 0 0" timestep="0.005" integrator="{integrator}"/><worldbody><body>
<joint name="knee" axis="0 1 0" {joint}/><geom size="0.05" pos="0 0 -0.2" mass="0.5"/></body></worldbody>
<actuator><position joint="knee" kp="200" kv="10" {servo}/></actuator></mujoco>"""
print("mujoco", mujoco.__version__)
found = {}
for integrator in ("Euler", "implicit", "implicitfast"):
    for place, limit in (
        ("joint", {"joint": 'actuatorfrcrange="-10 10"', "servo": ""}),
        ("actuator", {"joint": "", "servo": 'forcerange="-10 10"'}),
    ):
        model = mujoco.MjModel.from_xml_string(LINK.format(integrator=integrator, **limit))
        data = mujoco.MjData(model)
        data.ctrl[0] = 1.0
        mujoco.mj_step(model, data)
        right = 10.0 / float(model.dof_M0[0])
        found[integrator, place] = data.qvel[0] / model.opt.timestep / right
        print(
            f"{integrator:12} limit at the {place:8}: {found[integrator, place]:.2f} of the acceleration of 10 N m; "
            f"joint gets {data.qfrc_actuator[0]:.0f} N m, actuator_force {data.actuator_force[0]:.0f} N m"
        )
for (integrator, place), share in found.items():
    slowed = integrator != "Euler" and place == "joint"
    assert abs(share - (0.29 if slowed else 1.0)) < 0.02, (integrator, place)
PY
