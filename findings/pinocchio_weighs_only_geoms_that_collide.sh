#!/usr/bin/env bash
# Expected: Pinocchio, reading an MJCF file whose bodies have no <inertial>, gives them the masses that MuJoCo does.
# Instead: geoms with contype="0" and conaffinity="0" have no mass. They collide with nothing, unless a <pair> says so,
#   and MuJoCo weighs them like any other. Gymnasium's Swimmer weighs 106.8 kg in MuJoCo and nothing in
#   Pinocchio, the arm of its Pusher 13.7 kg and 0.18 kg; a shank drawn by one geom and collided by another loses the
#   drawn one's mass. No warning is given; the mass matrix is singular.
# Versions: pin 4.1.0, mujoco 3.17.0, gymnasium 1.3.0.
# Matters for: whole-body controllers, feedforward torques and mass features that are computed from the file a policy is
#   trained on. Files with <inertial> in every body (most robots made from CAD) agree in both.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check pin==4.1.0 mujoco==3.17.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps gymnasium==1.3.0
venv/bin/python - <<'PY'
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pinocchio

ASSETS = Path(find_spec("gymnasium").origin).parent / "envs" / "mujoco" / "assets"
SHANK = """<mujoco><worldbody><body name="shank"><joint name="knee" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.04" {collides}/><geom type="sphere" size="0.05" pos="0 0 -0.3"/>
</body></worldbody></mujoco>"""
Path("shank.xml").write_text(SHANK.format(collides='contype="0" conaffinity="0"'))
Path("shank_collides.xml").write_text(SHANK.format(collides=""))


def masses(path, body):
    """Mass of the tree that starts at the body, in MuJoCo and in Pinocchio (which reads moving bodies only)."""
    model = mujoco.MjModel.from_xml_path(str(path))
    return float(model.body_subtreemass[model.body(body).id]), pinocchio.computeTotalMass(
        pinocchio.buildModelFromMJCF(str(path))
    )


print(*(f"{name} {version(name)}" for name in ("pin", "mujoco", "gymnasium")))
found = {}
for path, body in (
    (ASSETS / "swimmer.xml", "torso"),
    (ASSETS / "pusher_v5.xml", "r_shoulder_pan_link"),
    (ASSETS / "walker2d_v5.xml", "torso"),
    (Path("shank.xml"), "shank"),
    (Path("shank_collides.xml"), "shank"),
):
    found[path.stem] = masses(path, body)
    print(f"{path.stem:15} MuJoCo {found[path.stem][0]:8.3f} kg   Pinocchio {found[path.stem][1]:8.3f} kg")
swimmer = pinocchio.buildModelFromMJCF(str(ASSETS / "swimmer.xml"))
inertia = pinocchio.crba(swimmer, swimmer.createData(), pinocchio.neutral(swimmer)) - np.diag(swimmer.armature)
print("Swimmer's mass matrix in Pinocchio without armature, largest entry:", np.abs(inertia).max())
for same in ("walker2d_v5", "shank_collides"):
    assert np.isclose(*found[same])
assert found["swimmer"][0] > 100 and found["swimmer"][1] == 0 and np.abs(inertia).max() < 1e-9
assert found["pusher_v5"][0] > 13 and found["pusher_v5"][1] < 0.2
assert found["shank"][1] < 0.3 * found["shank"][0]
PY
