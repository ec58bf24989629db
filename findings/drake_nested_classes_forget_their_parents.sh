#!/usr/bin/env bash
# Expected: a nested default class of an MJCF file has what its parents have, in Drake as in MuJoCo.
# Instead: it has so only for the kinds of element that stand in the class itself. Joints of a class that holds <geom>
#   or <motor> but no <joint> get MuJoCo's built-in values, not those of the class above: no damping, no limits. Geoms
#   of a class without <geom> get water's density. In dm_control's CMU humanoid the 14 joints of toes, hands and wrists
#   are undamped. Without a warning.
# Versions: drake 1.51.1, mujoco 3.17.0, dm_control 1.0.50.
# Matters for: robots whose common values stand once, at the top: MuJoCo Menagerie's and dm_control's are written so.
# Source: RobotLocomotion/drake multibody/parsing/detail_mujoco_parser.cc, and pull request 22625 on defaults; no issue
#   found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check drake==1.51.1 mujoco==3.17.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps dm_control==1.0.50
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
CMU = Path(find_spec("dm_control").origin).parent / "suite" / "humanoid_CMU.xml"
LEG = """<mujoco model="leg"><default><geom density="500"/><joint damping="5" limited="true" range="-30 30"/>
<default class="leg">{leg}</default></default><worldbody><body name="shank" childclass="leg">
<joint name="knee" axis="0 1 0"/><geom size="0.1"/></body></worldbody></mujoco>"""


def load(path):
    """Return the mass in MuJoCo and in Drake, and the joints' damping and upper limits, likewise."""
    model, plant = mujoco.MjModel.from_xml_path(str(path)), MultibodyPlant(0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    hinges = [model.joint(number) for number in range(model.njnt) if model.jnt_type[number] == 3]
    joints = [plant.GetJointByName(hinge.name) for hinge in hinges]
    damping = {h.name: (h.damping[0], j.default_damping()) for h, j in zip(hinges, joints)}
    upper = {h.name: (h.range[1], j.position_upper_limit()) for h, j in zip(hinges, joints)}
    masses = model.body_subtreemass[0], plant.CalcTotalMass(plant.CreateDefaultContext())
    return masses, damping, upper


print(*(f"{name} {version(name)}" for name in ("drake", "mujoco", "dm_control")), "- MuJoCo, Drake")
for inside, same in (('<geom friction="1"/><joint armature="0"/>', True), ('<motor gear="2"/>', False)):
    Path("leg.xml").write_text(LEG.format(leg=inside))
    said.clear()
    masses, damping, upper = load("leg.xml")
    print(f"class with {inside}:")
    print("    mass {:.2f} {:.2f} kg,".format(*masses), "damping {} {} N m s/rad,".format(*damping["knee"]), end=" ")
    print("upper limit {:.2f} {:.2f} rad".format(*upper["knee"]))
    assert (np.isclose(*masses), np.isclose(*damping["knee"]), np.isclose(*upper["knee"])) == (same,) * 3 and not said
masses, damping, upper = load(CMU)
lost = [name for name, (ours, theirs) in damping.items() if ours > 0 and theirs == 0]
print(f"CMU humanoid: {len(lost)} of {len(damping)} joints lose their damping:", *lost)
assert len(lost) == 14 and {"ltoesrx", "rtoesrx"} <= set(lost)
assert not [line for line in said if "damping" in line or "default" in line]
PY
