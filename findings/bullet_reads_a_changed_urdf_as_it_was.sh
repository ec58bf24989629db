#!/usr/bin/env bash
# Expected: pybullet.loadURDF reads the file that is there, also after it has been written anew and after
#   resetSimulation.
# Instead: Bullet keeps the content of every file that it has read, by its path, for the life of the connection: a robot
#   whose masses are written anew between episodes keeps its first masses, without a word.
#   setPhysicsEngineParameter(enableFileCaching=0) after every resetSimulation reads the file again.
# Versions: pybullet 3.2.7.
# Matters for: domain randomisation that writes URDFs, and comparisons of two variants of a robot under one name.
# Source: none found; the guide names the parameter for wavefront files.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check --only-binary=:all: pybullet==3.2.7 numpy==2.2.6
venv/bin/python - <<'PY'
from pathlib import Path

import pybullet

BOX = """<robot name="box"><link name="box"><inertial><mass value="{}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def mass(value, cached=True):
    pybullet.resetSimulation()
    if not cached:
        pybullet.setPhysicsEngineParameter(enableFileCaching=0)
    Path("box.urdf").write_text(BOX.format(value))
    return pybullet.getDynamicsInfo(pybullet.loadURDF("box.urdf"), -1)[0]


pybullet.connect(pybullet.DIRECT)
first, second, third = mass(1.0), mass(2.0), mass(3.0, cached=False)
print(f"pybullet 3.2.7: written 1, 2, 3 kg; read {first}, {second} kg, and {third} kg with enableFileCaching=0")
assert (first, second, third) == (1.0, 1.0, 3.0)
PY
