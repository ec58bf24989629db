#!/usr/bin/env bash
# Expected: Pinocchio reads the robot that MuJoCo reads from an MJCF file, or says what it cannot read.
# Instead: what stands in a <frame> or <replicate> is left out without a word: bodies, joints, geoms with their masses.
#   A leg in a <frame> is gone, a joint in one leaves its body fixed, a quadruped whose leg is written once and
#   replicated is a trunk without legs. MuJoCo itself writes frames: of four legs that are replicated, or put on a trunk
#   by MjSpec.attach, and then written by mj_saveLastXML or to_xml(), Pinocchio finds the one that is not turned. And of
#   several bodies in the worldbody the first alone is read: with a box before the robot, the box is the robot.
# Versions: pin 4.1.0, mujoco 3.17.0.
# Matters for: inverse kinematics and dynamics with the file that the simulator loads, and models written by MjSpec.
# Source: none found; stack-of-tasks/pinocchio issues 2747 (sites) and 2782 (the first body's place) are closed.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check pin==4.1.0 mujoco==3.17.0 numpy==2.2.6
venv/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import mujoco
import numpy as np
import pinocchio

JOINT, GEOM = '<joint name="hip" axis="0 1 0"/>', '<geom size="0.05" mass="1"/>'
LEG = f'<body name="leg" pos="0.2 0 0">{JOINT}{GEOM}</body>'
TRUNK = '<body name="trunk"><freejoint/><geom size="0.1" mass="5"/>{}</body>'
BOX = '<body name="box" pos="1 0 0"><geom size="0.1" mass="3"/></body>'


def turned(element):
    return f'<frame euler="0 0 90">{element}</frame>'


def robot(*bodies):
    return f"<mujoco><worldbody>{''.join(bodies)}</worldbody></mujoco>"


def attached():
    """Return the XML that MuJoCo writes of a trunk with four legs round it."""
    spec = mujoco.MjSpec.from_string(robot(TRUNK.format("")))
    for leg in range(4):
        frame = spec.body("trunk").add_frame(euler=[0, 0, 90 * leg])
        spec.attach(mujoco.MjSpec.from_string(robot(LEG)), prefix=f"{leg}_", frame=frame)
    spec.compile()
    return spec.to_xml()


def saved(xml):
    """Return the XML that MuJoCo saves of a model that it has read."""
    model = mujoco.MjModel.from_xml_string(xml)
    mujoco.mj_saveLastXML("saved.xml", model)
    return Path("saved.xml").read_text()


replicated = robot(TRUNK.format(f'<replicate count="4" euler="0 0 90">{LEG}</replicate>'))
print(*(f"{name} {version(name)}" for name in ("pin", "mujoco")))
for name, xml, expected, read in (
    ("leg", robot(TRUNK.format(LEG)), (7, 6), (7, 6)),
    ("leg in a frame", robot(TRUNK.format(turned(LEG))), (7, 6), (6, 5)),
    ("its joint in a frame", robot(TRUNK.format(LEG.replace(JOINT, turned(JOINT)))), (7, 6), (6, 6)),
    ("its geom in a frame", robot(TRUNK.format(LEG.replace(GEOM, turned(GEOM)))), (7, 6), (7, 5)),
    ("leg replicated four times", replicated, (10, 9), (6, 5)),
    ("the same, saved by MuJoCo", saved(replicated), (10, 9), (7, 6)),
    ("four legs by MjSpec.attach", attached(), (10, 9), (7, 6)),
    ("robot, then box", robot(TRUNK.format(LEG), BOX), (7, 9), (7, 6)),
    ("box, then robot", robot(BOX, TRUNK.format(LEG)), (7, 9), (0, 3)),
):
    Path("robot.xml").write_text(xml)
    ours = mujoco.MjModel.from_xml_path("robot.xml")
    theirs = pinocchio.buildModelFromMJCF("robot.xml")
    masses = ours.body_mass.sum(), sum(inertia.mass for inertia in theirs.inertias)
    print(f"{name:26}: {ours.nv:2} degrees of freedom and {masses[0]:.1f} kg in MuJoCo,", end=" ")
    print(f"{theirs.nv} and {masses[1]:.1f} kg in Pinocchio")
    assert np.allclose((ours.nv, masses[0]), expected) and np.allclose((theirs.nv, masses[1]), read)
PY
