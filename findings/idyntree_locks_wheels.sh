#!/usr/bin/env bash
# Expected: a URDF joint of type continuous turns without end; its <limit> names the largest effort and speed, and no
#   angles, as the format has it for such joints.
# Instead: iDynTree takes the angles that are not there for zeros: the wheel has position limits, from 0 to 0. A written
#   URDF has a revolute joint with lower="0" and upper="0" in its place. Only without <limit>, and so without effort
#   and speed, it stays continuous. <mimic> is dropped on the way.
# Versions: idyntree 15.1.0.
# Matters for: legs on wheels: for who solves with these limits, and who reduces or merges a model with iDynTree before
#   another program reads it. MuJoCo happens to take a range from 0 to 0 for none, Pinocchio takes it as it stands.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check idyntree==15.1.0 numpy==2.2.6
venv/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import idyntree.bindings

INERTIAL = """<inertial><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""
URDF = """<robot name="leg"><link name="thigh">{inertial}</link><link name="shank">{inertial}</link>
<link name="tyre">{inertial}</link><link name="rod">{inertial}</link>
<joint name="knee" type="revolute"><parent link="thigh"/><child link="shank"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="9" velocity="5"/></joint>
<joint name="wheel" type="continuous"><parent link="shank"/><child link="tyre"/><axis xyz="0 1 0"/>{limit}</joint>
<joint name="crank" type="revolute"><parent link="shank"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="9" velocity="5"/><mimic joint="knee"/></joint></robot>"""


def pass_through(name, limit):
    given, written = Path(f"{name}.urdf"), Path(f"{name}_written.urdf")
    given.write_text(URDF.format(inertial=INERTIAL, limit=limit))
    loader = idyntree.bindings.ModelLoader()
    assert loader.loadModelFromFile(str(given))
    model = loader.model()
    wheel = model.getJoint(model.getJointIndex("wheel"))
    exporter = idyntree.bindings.ModelExporter()
    assert exporter.init(model) and exporter.exportModelToFile(str(written))
    joints = {joint.get("name"): joint for joint in ElementTree.parse(written).getroot().iter("joint")}
    bounds = joints["wheel"].find("limit")
    found = wheel.hasPosLimits(), joints["wheel"].get("type"), {} if bounds is None else dict(bounds.attrib)
    read = f"{wheel.getMinPosLimit(0)} to {wheel.getMaxPosLimit(0)}" if found[0] else "no position limits"
    print(f"continuous wheel {name}: read with {read}, written as", *found[1:])
    return *found, joints["crank"].find("mimic")


print("idyntree", version("idyntree"))
limited = pass_through("with effort and speed", '<limit effort="3" velocity="20"/>')
bare = pass_through("without a limit", "")
print("mimic in the written file:", limited[3])
assert limited[:2] == (True, "revolute") and float(limited[2]["lower"]) == float(limited[2]["upper"]) == 0
assert bare[:3] == (False, "continuous", {}) and limited[3] is bare[3] is None
PY
