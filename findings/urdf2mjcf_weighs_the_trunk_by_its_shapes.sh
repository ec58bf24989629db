#!/usr/bin/env bash
# Expected: a robot that is converted from URDF to MJCF has the masses and inertias that its URDF states.
# Instead: urdf2mjcf takes the <inertial> of the root link out of the file that it writes; no message says so. MuJoCo
#   then weighs the trunk by its geoms at water's density, those for the eye together with those for collisions: a
#   trunk of 5 kg with its centre 30 mm to the front has 12 kg and its centre in the middle. Without any shapes nothing
#   is left that weighs. All other links keep their masses.
#   Solo 12 of example-robot-data 6.0.0, which is not run below, comes out at 7.8 kg instead of 2.5.
#   In the same file motors are without limits (<limit effort> is not read), <dynamics> and <mimic> are gone.
# Versions: urdf2mjcf 0.2.39, mujoco 3.17.0.
# Matters for: whoever trains on the written file. The trunk is a legged robot's heaviest link, and with a fine mesh the
#   wrong mass is plausible enough to be missed.
# Source: kscalelabs/urdf2mjcf pull request 81, open, of the mass; of the others none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check urdf2mjcf==0.2.39 mujoco==3.17.0
venv/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import mujoco
from urdf2mjcf.convert import convert_urdf_to_mjcf

INERTIAL = """<inertial><origin xyz="{x} 0 {z}"/><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>"""
BOX = """<{use}><geometry><box size="0.3 0.2 0.1"/></geometry></{use}>"""
URDF = """<robot name="hopper"><link name="trunk">{trunk}{shapes}</link>
<link name="thigh">{thigh}<collision><origin xyz="0 0 -0.1"/><geometry><cylinder radius="0.03" length="0.2"/></geometry>
</collision></link><link name="rod">{rod}</link>
<joint name="hip" type="revolute"><parent link="trunk"/><child link="thigh"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="33" velocity="20"/><dynamics damping="0.7" friction="0.2"/></joint>
<joint name="crank" type="revolute"><parent link="thigh"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="5" velocity="20"/><mimic joint="hip" multiplier="-2"/></joint></robot>"""
links = {
    "trunk": INERTIAL.format(x=0.03, z=0, mass=5, i=0.1),
    "thigh": INERTIAL.format(x=0, z=-0.1, mass=2, i=0.02),
    "rod": INERTIAL.format(x=0, z=0, mass=0.3, i=0.001),
}


def convert(name, *uses):
    urdf = Path(f"{name}.urdf")
    urdf.write_text(URDF.format(shapes="".join(BOX.format(use=use) for use in uses), **links))
    written = urdf.with_suffix(".xml")
    convert_urdf_to_mjcf(urdf, written)
    return written


print(*(f"{name} {version(name)}" for name in ("urdf2mjcf", "mujoco")))
masses = {}
for name, uses in (("collision", ("collision",)), ("both", ("visual", "collision"))):
    model = mujoco.MjModel.from_xml_path(str(convert(name, *uses)))
    trunk = model.body("trunk")
    masses[name] = {link: float(model.body(link).mass[0]) for link in links}
    print(f"trunk with {name:9}: masses", masses[name], "centre of the trunk", trunk.ipos, "inertia", trunk.inertia)
    assert abs(trunk.ipos[0]) < 1e-6
print("URDF                : masses", {"trunk": 5.0, "thigh": 2.0, "rod": 0.3}, "centre of the trunk [0.03 0. 0.]")
bare = ElementTree.parse(convert("bare")).getroot().find("worldbody/body")
weigh = bare.findall("inertial") + bare.findall("geom")
print("trunk without shapes: elements with a mass", len(weigh))
limited = model.actuator_ctrllimited.any() or model.actuator_forcelimited.any() or model.jnt_actfrclimited.any()
print("torque limits", bool(limited), end=" ")
hip = model.joint("hip")
print("damping", hip.damping, "friction", hip.frictionloss, "equalities", model.neq)
assert [round(masses[name]["trunk"], 6) for name in ("collision", "both")] == [6.0, 12.0]
assert all(found["thigh"] == 2 and found["rod"] == 0.3 for found in masses.values())
assert bare.get("name") == "trunk" and not weigh
assert model.nu == 2 and not limited and not hip.damping.any() and not hip.frictionloss.any() and model.neq == 0
PY
