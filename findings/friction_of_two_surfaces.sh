#!/usr/bin/env bash
# Expected: a sole and a floor with friction 0.5 each, or 0.5 and 1.0, slide alike in every simulator; the two numbers
#   describe two materials.
# Instead: MuJoCo takes the larger of the two, DART the smaller, Bullet their product. A sole of 0.5 on a floor of 1.0
#   has 1.0 in MuJoCo and 0.5 in the others; of 0.5 on 0.5 it has 0.5, 0.5 and 0.25. Making a MuJoCo robot's soles
#   more slippery than the floor (to randomise friction, say) changes nothing at all.
# Versions: mujoco 3.17.0, dartpy 6.20.0, pybullet 3.2.7.
# Matters for: randomised friction that touches one surface only, and sim-to-sim checks with the same numbers.
# Source: MuJoCo's documentation says so (Computation, contact parameters); the comparison is this script's.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 numpy==2.2.6 dartpy==6.20.0
# Where pip would have to compile Bullet, which takes long, it is left out.
venv/bin/pip install -q --disable-pip-version-check --only-binary=:all: pybullet==3.2.7 || echo "no wheel of pybullet"
venv/bin/python - <<'PY'
from importlib.metadata import version

import dartpy
import mujoco
import numpy as np

try:
    import pybullet
except ImportError:
    pybullet = None

HALF, SETTLE, SLIDE, DT, SPEED, GRAVITY = (0.2, 0.2, 0.05), 300, 100, 0.001, 3.0, 9.81


def coefficient(step, throw, speed):
    """From how fast a flat box slows down: (v - v') / (g t)."""
    for _ in range(SETTLE):
        step()
    throw()
    for _ in range(SLIDE):
        step()
    return (SPEED - speed()) / (GRAVITY * SLIDE * DT)


def in_mujoco(sole, floor):
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
    <option timestep="{DT}" cone="elliptic" impratio="10"/>
    <worldbody><geom type="plane" size="9 9 1" friction="{floor}"/><body pos="0 0 {HALF[2]}"><freejoint/>
    <geom type="box" size="{HALF[0]} {HALF[1]} {HALF[2]}" mass="1" friction="{sole}"/></body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    return coefficient(
        lambda: mujoco.mj_step(model, data), lambda: data.qvel.__setitem__(0, SPEED), lambda: data.qvel[0]
    )


def in_bullet(sole, floor):
    pybullet.resetSimulation()
    pybullet.setGravity(0, 0, -GRAVITY)
    pybullet.setTimeStep(DT)
    ground = pybullet.createMultiBody(0, pybullet.createCollisionShape(pybullet.GEOM_PLANE))
    shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=HALF)
    box = pybullet.createMultiBody(1, shape, basePosition=[0, 0, HALF[2]])
    pybullet.changeDynamics(ground, -1, lateralFriction=floor)
    pybullet.changeDynamics(box, -1, lateralFriction=sole, linearDamping=0, angularDamping=0)
    throw = lambda: pybullet.resetBaseVelocity(box, [SPEED, 0, 0])  # noqa: E731
    return coefficient(pybullet.stepSimulation, throw, lambda: pybullet.getBaseVelocity(box)[0][0])


def in_dart(sole, floor):
    world = dartpy.simulation.World()
    world.setTimeStep(DT)
    for size, friction, free in (((20.0, 20.0, 0.2), floor, False), (tuple(2 * x for x in HALF), sole, True)):
        body = dartpy.dynamics.Skeleton("box" if free else "ground")
        make = body.createFreeJointAndBodyNodePair if free else body.createWeldJointAndBodyNodePair
        joint, node = make()
        shape = node.createShapeNode(dartpy.dynamics.BoxShape(size))
        shape.createCollisionAspect()
        shape.createDynamicsAspect()
        shape.getDynamicsAspect().setFrictionCoeff(friction)
        node.setInertia(dartpy.dynamics.Inertia(1.0, [0, 0, 0], np.diag([0.014, 0.014, 0.027])))
        if free:
            body.setPosition(5, HALF[2])
        else:
            below = dartpy.math.Isometry3()
            below.set_translation([0, 0, -0.1])
            joint.setTransformFromParentBodyNode(below)
        world.addSkeleton(body)
    return coefficient(world.step, lambda: body.setVelocity(3, SPEED), lambda: body.getVelocity(3))


print(*(f"{name} {version(name)}" for name in ("mujoco", "dartpy")), "pybullet 3.2.7" if pybullet else "")
if pybullet:
    pybullet.connect(pybullet.DIRECT)
for sole, floor in ((0.5, 1.0), (0.5, 0.5), (0.2, 0.8)):
    found = {"MuJoCo": (in_mujoco(sole, floor), max(sole, floor)), "DART": (in_dart(sole, floor), min(sole, floor))}
    if pybullet:
        found["Bullet"] = in_bullet(sole, floor), sole * floor
    print(f"sole {sole}, floor {floor}:", *(f"{name} {measured:.2f}" for name, (measured, _) in found.items()))
    assert all(abs(measured - rule) < 0.08 for measured, rule in found.values())
PY
