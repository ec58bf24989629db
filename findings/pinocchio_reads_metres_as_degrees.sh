#!/usr/bin/env bash
# Expected: Pinocchio gives the joints of an MJCF file the ranges that MuJoCo gives them.
# Instead: in files that count angles in degrees, which is MJCF's default, it converts the ranges of sliding joints too:
#   a leg that slides by 0.2 m is left 3.5 mm, and the cart of Gymnasium's InvertedPendulum, which has one metre to
#   each side, 17 mm. And limited="false" is not heeded: a wheel or a planar base whose limits are off has them.
# Versions: pin 4.1.0, mujoco 3.17.0, gymnasium 1.3.0.
# Matters for: inverse kinematics and planners, which stop at these limits, and sampling with randomConfiguration.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check pin==4.1.0 mujoco==3.17.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps gymnasium==1.3.0
venv/bin/python - <<'PY'
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pinocchio

CART = Path(find_spec("gymnasium").origin).parent / "envs" / "mujoco" / "assets" / "inverted_pendulum.xml"
LEG = """<mujoco>{compiler}<worldbody>
<body name="thigh"><joint name="hip" axis="0 1 0" range="{hip}"/><geom size="0.1"/>
<body name="shank"><joint name="leg" type="slide" axis="0 0 1" range="-0.2 0.2"/><geom size="0.05"/>
<body name="tyre"><joint name="wheel" axis="0 1 0" range="-90 90" limited="false"/><geom size="0.05"/></body>
</body></body></worldbody></mujoco>"""
Path("degrees.xml").write_text(LEG.format(compiler="", hip="-90 90"))
Path("radians.xml").write_text(LEG.format(compiler='<compiler angle="radian"/>', hip="-1.5708 1.5708"))


def ranges(path):
    ours = mujoco.MjModel.from_xml_path(str(path))
    theirs = pinocchio.buildModelFromMJCF(str(path))
    for joint in (ours.joint(number) for number in range(ours.njnt)):
        at = theirs.joints[theirs.getJointId(joint.name)].idx_q
        yield (
            joint.name,
            np.array(joint.range if ours.jnt_limited[joint.id] else (-np.inf, np.inf)),
            np.array([theirs.lowerPositionLimit[at], theirs.upperPositionLimit[at]]),
        )


print(*(f"{name} {version(name)}" for name in ("pin", "mujoco", "gymnasium")))
same = {}
for path in (Path("radians.xml"), Path("degrees.xml"), CART):
    for name, ours, theirs in ranges(path):
        same[path.stem, name] = np.allclose(ours, theirs, atol=1e-4)
        print(f"{path.stem:17} {name:7} MuJoCo {ours.round(4)} Pinocchio {theirs.round(4)}")
        if name in ("leg", "slider") and path.stem != "radians":
            assert np.allclose(np.deg2rad(ours), theirs)
assert [same["radians", name] for name in ("hip", "leg", "wheel")] == [True, True, False]
assert [same["degrees", name] for name in ("hip", "leg", "wheel")] == [True, False, False]
assert not same["inverted_pendulum", "slider"] and same["inverted_pendulum", "hinge"]
PY
