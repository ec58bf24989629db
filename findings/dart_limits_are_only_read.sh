#!/usr/bin/env bash
# Expected: a joint with <limit lower="-1" upper="1" effort="10" velocity="5"/> stays between -1 and 1 rad in a
#   simulator that reads the file, at most 5 rad/s fast, whatever is asked of it.
# Instead: dartpy shows these numbers on the joint and enforces none: under 100 N m the knee spins on, for hundreds of
#   rad. One line for each joint, setLimitEnforcement(True), holds angle and speed; the effort of setForce stays
#   unchecked.
# Versions: dartpy 6.20.0.
# Matters for: sim-to-sim checks of a policy with DART's Python package: knees that bend the wrong way pass.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check dartpy==6.20.0 numpy==2.2.6
venv/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import dartpy

LINK = """<link name="{}"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
LEG = f"""<robot name="leg">{LINK.format("thigh")}{LINK.format("shank")}
<joint name="knee" type="revolute"><parent link="thigh"/><child link="shank"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="10" velocity="5"/></joint></robot>"""
Path("leg.urdf").write_text(LEG)


def extremes(enforced):
    leg = dartpy.utils.DartLoader().parseSkeleton(str(Path("leg.urdf").resolve()))
    knee = leg.getJoint("knee")
    read = [knee.getPositionLowerLimit(0), knee.getPositionUpperLimit(0), knee.getVelocityUpperLimit(0)]
    effort, held = knee.getForceUpperLimit(0), knee.areLimitsEnforced()
    print("read:", read, "rad, rad, rad/s, effort", effort, "N m; enforced:", held)
    if enforced:
        knee.setLimitEnforcement(True)
    world = dartpy.simulation.World()
    world.setGravity([0.0, 0.0, 0.0])
    world.setTimeStep(0.001)
    world.addSkeleton(leg)
    angles, speeds = [], []
    for _ in range(1000):
        knee.setForce(0, 100.0)
        world.step()
        angles.append(abs(knee.getPosition(0)))
        speeds.append(abs(knee.getVelocity(0)))
    return max(angles), max(speeds)


print("dartpy", version("dartpy"))
angle, speed = extremes(enforced=False)
print(f"as it comes: up to {angle:.1f} rad, {speed:.1f} rad/s")
assert angle > 10 and speed > 20
angle, speed = extremes(enforced=True)
print(f"with setLimitEnforcement(True): up to {angle:.3f} rad, {speed:.3f} rad/s")
assert angle < 1.01 and speed < 5.01
PY
