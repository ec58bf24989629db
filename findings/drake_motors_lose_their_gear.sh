#!/usr/bin/env bash
# Expected: Drake gives a motor of an MJCF file the torque that MuJoCo gives it: control times gear, up to ctrlrange
#   times gear. Of attributes that it does not read it warns.
# Instead: the gear goes into the reflected inertia, as it should, but into neither the torque nor the effort limit: a
#   control of 1 on a motor with gear 10 is 1 N m in Drake, 10 in MuJoCo. Gymnasium's Ant and Hopper get motors of 1 N m
#   for 150 and 200, Humanoid of 0.4 for 10 to 120. Without a warning.
# Versions: drake 1.51.1, mujoco 3.17.0, gymnasium 1.3.0.
# Matters for: a policy that is tried out in a second simulator (the actions have to be multiplied by gear by hand, and
#   the limits set anew), and optimisation, which respects the effort limits.
# Source: RobotLocomotion/drake multibody/parsing/detail_mujoco_parser.cc, and pull request 21967, which began to read
#   gear; no issue found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check drake==1.51.1 mujoco==3.17.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps gymnasium==1.3.0
venv/bin/python - <<'PY'
import logging
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
from pydrake.all import MultibodyPlant, Parser

said = []
watch = logging.Handler()
watch.emit = lambda record: said.append(record.getMessage())
logging.getLogger("drake").handlers = [watch]
logging.getLogger("drake").propagate = False
ASSETS = Path(find_spec("gymnasium").origin).parent / "envs" / "mujoco" / "assets"
LEG = """<mujoco model="leg"><option gravity="0 0 0"/><worldbody><body name="shank">
<joint name="knee" axis="0 1 0" armature="{armature}"/><geom size="0.1" pos="0 0 -0.5" mass="1"/></body></worldbody>
<actuator><motor joint="knee" gear="{gear}" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""


def load(path):
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    return mujoco.MjModel.from_xml_path(str(path)), plant


print(*(f"{name} {version(name)}" for name in ("drake", "mujoco", "gymnasium")))
for gear, armature in ((1, 0), (10, 0), (10, 1)):
    Path("leg.xml").write_text(LEG.format(gear=gear, armature=armature))
    model, plant = load("leg.xml")
    data = mujoco.MjData(model)
    data.ctrl[0] = 1.0
    mujoco.mj_forward(model, data)
    context = plant.CreateDefaultContext()
    plant.get_actuation_input_port().FixValue(context, [1.0])
    theirs = plant.EvalTimeDerivatives(context).CopyToVector()[-1]
    (limit,) = (plant.get_joint_actuator(index).effort_limit() for index in plant.GetJointActuatorIndices())
    print(f"gear {gear:2}, armature {armature}: control 1 gives {data.qacc[0]:6.3f} rad/s^2 in MuJoCo", end=", ")
    print(f"{theirs:6.3f} in Drake, limit {gear} and {limit:.0f} N m")
    assert np.isclose(data.qacc[0], gear * theirs) and limit == 1
for name in ("ant", "hopper", "humanoid"):
    model, plant = load(ASSETS / f"{name}.xml")
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        (number,) = np.flatnonzero(model.actuator_trnid[:, 0] == model.joint(actuator.joint().name()).id)
        control = np.abs(model.actuator_ctrlrange[number]).max()
        assert np.isclose(actuator.effort_limit(), control) and model.actuator_gear[number, 0] > 20
    torques = np.abs(model.actuator_ctrlrange).max(axis=1) * model.actuator_gear[:, 0]
    limits = {plant.get_joint_actuator(index).effort_limit() for index in plant.GetJointActuatorIndices()}
    print(f"{name}: {torques.min():.0f} to {torques.max():.0f} N m in MuJoCo, {limits} in Drake")
warnings = [line for line in said if "gear" in line]
print(f"Drake warned {len(said)} times, of gear {len(warnings)} times")
assert said and not warnings
PY
