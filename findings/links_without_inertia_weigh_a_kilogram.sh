#!/usr/bin/env bash
# Expected: a URDF's link without <inertial> is a mere frame (a camera, the sole's middle) and weighs nothing.
# Instead: Bullet and DART give each such link 1 kg and, about every axis, 1 kg m^2, Bullet with a warning, DART without
#   a word. The humanoid JVRC-1, 62.4 kg, weighs 77.4 kg in both. MuJoCo goes by the link's shape, if it has one: a massless
#   foot of one decilitre weighs 113 g there.
# Versions: pybullet 3.2.7, dartpy 6.20.0, mujoco 3.17.0, jvrc-description 1.1.1.
# Matters for: sim-to-sim checks of a policy: a foot with 1 kg m^2 of its own hardly swings.
# Source: bulletphysics/bullet3 pull request 3097 (a robot file mended for this reason), dartsim/dart issue 1604.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6 pybullet==3.2.7 dartpy==6.20.0
venv/bin/pip install -q --disable-pip-version-check --no-deps jvrc-description==1.1.1
venv/bin/python - <<'PY'
import os
import re
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import dartpy
import mujoco
import pybullet

LEG = """<robot name="leg"><link name="shank"><inertial><mass value="2"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="ankle" type="revolute"><parent link="shank"/><child link="foot"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="10" velocity="5"/></joint>
<link name="foot"><collision><geometry><sphere radius="0.03"/></geometry></collision></link></robot>"""
(jvrc,) = Path(find_spec("jvrc_description").origin).parent.rglob("*.urdf")
# Shapes are not looked at, so the meshes need not be found.
shapeless = re.sub(r"<(visual|collision)\b.*?</\1>", "", jvrc.read_text(), flags=re.DOTALL)
Path("leg.urdf").write_text(LEG)
Path("jvrc.urdf").write_text(shapeless)


def sums(path):
    links = ElementTree.parse(path).getroot().findall("link")
    stated = sum(float(mass.get("value")) for link in links for mass in link.findall("inertial/mass"))
    # Bullet warns on standard output, past Python.
    terminal, log = os.dup(1), os.open("warnings", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    body = pybullet.loadURDF(path, flags=pybullet.URDF_USE_INERTIA_FROM_FILE)
    os.dup2(terminal, 1)
    bullet = sum(pybullet.getDynamicsInfo(body, i)[0] for i in range(-1, pybullet.getNumJoints(body)))
    dart = dartpy.utils.DartLoader().parseSkeleton(str(Path(path).resolve())).getMass()
    return len(links), sum(link.find("inertial") is None for link in links), stated, bullet, dart


pybullet.connect(pybullet.DIRECT)
print(*(f"{name} {version(name)}," for name in ("pybullet", "dartpy", "mujoco", "jvrc-description")))
for name in ("leg", "jvrc"):
    links, bare, stated, bullet, dart = sums(f"{name}.urdf")
    print(f"{name}: {links} links, {bare} without <inertial>; stated {stated:.1f} kg, Bullet {bullet:.1f} kg, DART {dart:.1f} kg")
    warned = Path("warnings").read_text().count("No inertial data for link")
    assert bare == warned and abs(bullet - stated - bare) < 1e-6 and abs(dart - stated - bare) < 1e-6
foot = float(mujoco.MjModel.from_xml_path("leg.urdf").body_mass[1])
print(f"MuJoCo: the leg's foot, a ball of 113 ml, weighs {foot:.3f} kg")
assert abs(foot - 0.113) < 0.001
PY
