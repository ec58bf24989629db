#!/usr/bin/env bash
# Expected: a humanoid's two soles are mirror images of each other.
# Instead: holosoma's Unitree G1 has seven capsules lying lengthwise under each foot. On the left all are 10 mm in
#   radius; on the right the second and the sixth are 8 mm, so they do not reach the ground. The left foot stands on 14
#   points, the right one on 10: its heel is 20 mm wide, the left one's 36 mm. With weight on the heel, the left foot
#   stands up to 16 mm from its middle, the right one up to 10 mm; further out they tip over.
# Versions: holosoma 0.0.3, mujoco 3.17.0.
# Matters for: heel strike and the ankle's roll: a policy learns to put the right foot down in another way. Mirrored
#   experience and symmetric policies; counts of contacts at the feet.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps --target robots holosoma==0.0.3
venv/bin/python - <<'PY'
import mujoco
import numpy as np

robot = mujoco.MjModel.from_xml_path("robots/holosoma/data/robots/g1/scenes/scene_g1_29dof_wbt_plane.xml")


def stand(capsules, weight):
    """Roll (degrees) and contacts of a sole that stood alone for a second with 20 kg over the place `weight` (m)."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    foot = spec.worldbody.add_body(name="foot", pos=[0, 0, 0.035])
    foot.add_freejoint()
    foot.explicitinertial, foot.mass, foot.inertia, foot.ipos = True, 20.0, [0.05] * 3, [*weight, 0.0]
    for capsule in capsules:
        foot.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=capsule.size, pos=capsule.pos, quat=capsule.quat)
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(round(1.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    w, x, y, z = data.qpos[3:7]
    roll = np.rad2deg(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    return abs(float(roll)), np.array([contact.pos for contact in data.contact])


print("mujoco", mujoco.__version__, "- holosoma 0.0.3")
counts, heels, reaches = {}, {}, {}
for side, out in (("left", 1), ("right", -1)):
    capsules = [robot.geom(f"{side}_foot{number}_collision") for number in range(1, 8)]
    _, points = stand(capsules, (0.04, 0.0))
    counts[side] = len(points)
    heels[side] = round(1000 * float(np.ptp(points[points[:, 0] < 0.0, 1])))
    # Over the heel, 4 cm behind the ankle: how many millimetres out to the side before it tips.
    reaches[side] = max(aside for aside in range(26) if stand(capsules, (-0.04, out * aside / 1000))[0] < 5.0)
    print(
        f"{side:5} radii {[1000 * float(capsule.size[0]) for capsule in capsules]} mm: {counts[side]} points, heel "
        f"{heels[side]} mm wide, tips once the weight on the heel is more than {reaches[side]} mm aside"
    )
assert counts == {"left": 14, "right": 10}
assert heels["left"] > 33 and heels["right"] < 23
assert reaches["left"] - reaches["right"] > 4
PY
