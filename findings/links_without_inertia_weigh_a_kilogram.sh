#!/usr/bin/env bash
# Expected: a URDF's link without <inertial> is a mere frame (a camera, the sole's middle) and weighs nothing.
# Instead: Bullet and DART give each such link 1 kg and, about every axis, 1 kg m^2, Bullet with a warning, DART
#   without a word. The humanoid JVRC-1, 62.4 kg, weighs 77.4 kg in both. MuJoCo goes by the link's shape, if it has
#   one: a massless foot of one decilitre weighs 113 g there.
# Versions: pybullet 3.2.7, dartpy 6.20.0, mujoco 3.17.0, jvrc-description 1.1.1.
# Matters for: sim-to-sim checks of a policy: a foot with 1 kg m^2 of its own hardly swings.
# Source: bulletphysics/bullet3 pull request 3097 (a robot file mended for this reason), dartsim/dart issue 1604.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6 dartpy==6.20.0
# Where pip would have to compile Bullet, which takes long, it is left out.
venv/bin/pip install -q --disable-pip-version-check --only-binary=:all: pybullet==3.2.7 || echo "no wheel of pybullet"
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

try:
    import pybullet
except ImportError:
    pybullet = None

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


def in_bullet(path):
    # Bullet warns on standard output, past Python.
    terminal, log = os.dup(1), os.open("warnings", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    body = pybullet.loadURDF(path, flags=pybullet.URDF_USE_INERTIA_FROM_FILE)
    os.dup2(terminal, 1)
    return sum(pybullet.getDynamicsInfo(body, i)[0] for i in range(-1, pybullet.getNumJoints(body)))


print(*(f"{name} {version(name)}," for name in ("dartpy", "mujoco", "jvrc-description")), end=" ")
print("pybullet 3.2.7" if pybullet else "")
if pybullet:
    pybullet.connect(pybullet.DIRECT)
for name in ("leg.urdf", "jvrc.urdf"):
    links = ElementTree.parse(name).getroot().findall("link")
    bare = sum(link.find("inertial") is None for link in links)
    stated = sum(float(mass.get("value")) for link in links for mass in link.findall("inertial/mass"))
    loaded = {"DART": dartpy.utils.DartLoader().parseSkeleton(str(Path(name).resolve())).getMass()}
    if pybullet:
        loaded["Bullet"] = in_bullet(name)
        assert Path("warnings").read_text().count("No inertial data for link") == bare
    print(f"{name}: {len(links)} links, {bare} without <inertial>; stated {stated:.1f} kg,", end=" ")
    print(*(f"{simulator} {mass:.1f} kg" for simulator, mass in loaded.items()))
    assert bare > 0 and all(abs(mass - stated - bare) < 1e-6 for mass in loaded.values())
foot = float(mujoco.MjModel.from_xml_path("leg.urdf").body_mass[1])
print(f"MuJoCo: the leg's foot, a ball of 113 ml, weighs {foot:.3f} kg")
assert abs(foot - 0.113) < 0.001
PY
