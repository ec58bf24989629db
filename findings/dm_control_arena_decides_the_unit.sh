#!/usr/bin/env bash
# Expected: a robot's joint limits are those of its file, whether dm_control loads it alone or attached to an arena.
# Instead: dm_control writes both into one file, and a robot whose own file does not name its unit of angles gets the
#   arena's. A robot in degrees, MJCF's default, has no limits to speak of in composer.Arena, which is in radians: a
#   knee's -150 degrees become -150 rad, 24 turns. The other way round, dm_control's default CMU humanoid (V2019) is in
#   radians and does not say so: alone, or attached to an mjcf.RootElement(), no joint of it has a range of more than
#   3.2 degrees, and the knee goes from 0.01 to 2.97. There is no warning; only two files that name different units are
#   refused. MuJoCo's own MjSpec keeps each file's unit.
# Versions: dm_control 1.0.50, mujoco 3.17.0.
# Matters for: whoever puts a robot of another source into an arena, or takes the CMU humanoid out of one, to train with
#   it elsewhere say: knees bend either way, or the body is stiff.
# Source: google-deepmind/dm_control issue 331, closed, of a user's file in degrees; of the CMU humanoid none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check dm_control==1.0.50 mujoco==3.17.0 numpy==2.2.6
export MUJOCO_GL=disabled
venv/bin/python - <<'PY'
from importlib.metadata import version

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.locomotion.walkers import cmu_humanoid

LEG = """<mujoco model="leg"><worldbody><body name="thigh"><geom size="0.1"/>
<body name="shank"><joint name="knee" axis="0 1 0" range="-150 0" limited="true" damping="1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.04"/></body></body></worldbody></mujoco>"""


def leg():
    return mjcf.from_xml_string(LEG)


def cmu():
    return cmu_humanoid.CMUHumanoid().mjcf_model


def load(robot, arena):
    if arena is None:
        return mjcf.Physics.from_mjcf_model(robot).model.ptr
    arena.attach(robot).add("freejoint")
    return mjcf.Physics.from_mjcf_model(arena).model.ptr


def swing(model, knee, torque):
    """Return the extreme angle (degrees) that the knee reaches in a second without gravity."""
    model.opt.gravity = 0
    data, angles = mujoco.MjData(model), []
    while data.time < 1:
        data.qfrc_applied[knee.dofadr[0]] = torque
        mujoco.mj_step(model, data)
        angles.append(float(data.qpos[knee.qposadr[0]]))
    return np.rad2deg(max(angles, key=abs))


print(*(f"{name} {version(name)}" for name in ("dm_control", "mujoco")))
found = {}
for name, robot, knee, torque in (("leg", leg, "knee", -30), ("CMUHumanoid", cmu, "ltibiarx", 30)):
    for place, arena in (
        ("alone", None),
        ("in RootElement()", mjcf.RootElement()),
        ("in composer.Arena()", composer.Arena().mjcf_model),
    ):
        model = load(robot(), arena)
        joint = next(model.joint(i) for i in range(model.njnt) if model.joint(i).name.endswith(knee))
        limits = np.rad2deg(joint.range).round(2).tolist()
        hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        widest = np.ptp(np.rad2deg(model.jnt_range[hinges]), axis=1).max()
        reached = swing(model, joint, torque)
        found[name, place] = limits, widest, reached
        print(f"{name} {place}: knee {limits} degrees, widest range {widest:.2f}", end="; ")
        print(f"{torque} N m take the knee to {reached:.1f}")
assert found["leg", "in composer.Arena()"][0] == [-8594.37, 0] and found["leg", "in composer.Arena()"][2] < -360
assert found["CMUHumanoid", "in composer.Arena()"][0] == [0.57, 170]
for place in ("alone", "in RootElement()"):
    assert found["leg", place][0] == [-150, 0] and found["leg", place][2] > -180
    assert found["CMUHumanoid", place][0] == [0.01, 2.97] and found["CMUHumanoid", place][1] < 3.2
scene = mujoco.MjSpec()
scene.compiler.degree = False
scene.attach(mujoco.MjSpec.from_string(LEG), prefix="leg/", frame=scene.worldbody.add_frame())
limits = np.rad2deg(scene.compile().joint("leg/knee").range)
print(f"leg in a scene in radians, by MuJoCo's MjSpec: knee {limits.round(2)} degrees")
assert np.allclose(limits, (-150, 0))
PY
