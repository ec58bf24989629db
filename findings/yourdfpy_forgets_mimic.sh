#!/usr/bin/env bash
# Expected: a URDF that is read and written again by the same library is the same robot.
# Instead: yourdfpy reads <mimic> (its model of JVRC-1 has 34 degrees of freedom) and leaves it out when it writes:
#   the written file has 44. <transmission>, <gazebo> and <safety_controller> go the same way, without a warning.
# Versions: yourdfpy 0.0.60, jvrc-description 1.1.1.
# Matters for: whoever edits a robot with it (other masses, fewer joints) and trains on the written file: fingers, and
#   parallel shanks coupled by mimic joints, swing freely, and joint vectors get longer.
# Source: clemense/yourdfpy issue 57, of mimic; of the others none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check yourdfpy==0.0.60 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps jvrc-description==1.1.1
venv/bin/python - <<'PY'
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import yourdfpy

TAGS = ("joint/mimic", "transmission", "gazebo", "joint/safety_controller", "joint/limit", "link/inertial")
HINGE = """<robot name="leg"><link name="thigh"/><link name="shank"/><joint name="knee" type="revolute">
<parent link="thigh"/><child link="shank"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="5"/>
<safety_controller soft_lower_limit="-0.9" soft_upper_limit="0.9" k_position="10" k_velocity="1"/></joint>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="knee"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
<actuator name="m"><mechanicalReduction>9</mechanicalReduction></actuator></transmission>
<gazebo reference="shank"><mu1>0.8</mu1></gazebo></robot>"""
(jvrc,) = Path(find_spec("jvrc_description").origin).parent.rglob("*.urdf")
Path("hinge.urdf").write_text(HINGE)


def load(path):
    return yourdfpy.URDF.load(str(path), load_meshes=False, build_collision_scene_graph=False)


def count(path):
    root = ElementTree.parse(path).getroot()
    return {tag: len(root.findall(tag)) for tag in TAGS}


print("yourdfpy", version("yourdfpy"), "- jvrc-description", version("jvrc-description"))
counts, freedoms = [], []
for path in (jvrc, Path("hinge.urdf")):
    robot = load(path)
    robot.write_xml_file("written.urdf")
    counts.append((count(path), count("written.urdf")))
    freedoms.append((robot.num_dofs, load("written.urdf").num_dofs))
    print(path.name, "read   ", freedoms[-1][0], "degrees of freedom", counts[-1][0])
    print(path.name, "written", freedoms[-1][1], "degrees of freedom", counts[-1][1])
assert freedoms[0] == (34, 44) and counts[0][0]["joint/mimic"] == 10 and counts[0][1]["joint/mimic"] == 0
assert all(counts[1][0][tag] == 1 and counts[1][1][tag] == 0 for tag in TAGS[1:4])
PY
