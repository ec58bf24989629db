#!/usr/bin/env bash
# Expected: pytorch-kinematics puts the bodies of an MJCF file where MuJoCo puts them for the same joint angles, and a
#   joint without a range has no limits, as it has when it comes from a URDF.
# Instead: a joint that is not at its body's origin (pos="0 0 0.05") shifts its body and all below it by that distance,
#   in the zero pose too; ref is not heeded, so a leg drawn with a bent knee is bent twice; and joints without a range
#   have the limits 0 and 0. No warning is given.
# Versions: pytorch-kinematics 0.10.0, torch 2.13.0, mujoco 3.2.7 (with 3.17.0 it reads no joint at all: KeyError).
# Matters for: foot positions in rewards and batched inverse kinematics, with the file that the simulator loads. Files
#   with all joints at their bodies' origins and no ref agree, except for the limits.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check pytorch-kinematics==0.10.0 torch==2.13.0 mujoco==3.2.7 numpy==2.2.6
venv/bin/python - <<'PY'
from importlib.metadata import version

import mujoco
import numpy as np
import pytorch_kinematics
import torch

LEG = """<mujoco><compiler angle="radian"/><worldbody><body name="thigh" pos="0 0 1"><joint name="hip" axis="0 1 0"/>
<geom size="0.1"/><body name="shank" pos="0 0 -0.3"><joint name="knee" axis="0 1 0" {knee}/><geom size="0.05"/>
<body name="foot" pos="0 0 -0.3"><geom size="0.03"/></body></body></body></worldbody></mujoco>"""
URDF = """<robot name="wheel"><link name="base"/><link name="tyre"/><joint name="axle" type="continuous">
<parent link="base"/><child link="tyre"/><axis xyz="0 1 0"/></joint></robot>"""


def compare(knee, angles):
    xml = LEG.format(knee=knee)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[:] = angles
    mujoco.mj_kinematics(model, data)
    chain = pytorch_kinematics.build_chain_from_mjcf(xml)
    foot = chain.forward_kinematics(torch.tensor(angles))["foot"].get_matrix()[0, :3, 3].numpy()
    off = float(np.linalg.norm(foot - data.body("foot").xpos))
    print(f"knee {knee or 'at its origin':15} angles {angles}: foot at", data.body("foot").xpos.round(3), end=" ")
    print(f"in MuJoCo, {foot.round(3)} in pytorch-kinematics, {1000 * off:.0f} mm off")
    return off, chain.get_joint_limits()


print(*(f"{name} {version(name)}" for name in ("pytorch-kinematics", "torch", "mujoco")))
cases = [("", [0.3, 0.5]), ('pos="0 0 0.05"', [0.0, 0.0]), ('pos="0 0 0.05"', [0.3, 0.5]), ('ref="0.5"', [0.3, 0.5])]
plain, zero, moved, bent = (compare(*case) for case in cases)
wheel = pytorch_kinematics.build_chain_from_urdf(URDF.encode()).get_joint_limits()
print("limits of two joints without a range, MJCF:", plain[1], "- of a continuous joint, URDF:", wheel)
assert plain[0] < 1e-5 and all(abs(off - 0.05) < 1e-4 for off, _ in (zero, moved)) and bent[0] > 0.1
assert np.array_equal(plain[1], np.zeros((2, 2))) and np.isinf(wheel).all()
PY
