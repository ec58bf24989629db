#!/usr/bin/env bash
# Expected: "MJX will raise an exception if asked to copy an mjModel to the device that references unsupported
#   features", says its documentation.
# Instead: MJX-JAX takes and ignores a servo's `delay`, `damping` and `armature`, a sensor's `delay`, polynomial
#   `damping` and `stiffness` of joints (the first number alone is used), a moving surface (`surfacevel`), and
#   `actuatorgroupdisable`: a disabled motor goes on driving. With implicitfast it damps a servo by its kv even while
#   the servo is at its `forcerange`, which in MuJoCo then has no derivative. Nothing is said, neither by put_model nor
#   by step. A <pid> servo, in contrast, does raise.
# Versions: mujoco-mjx 3.17.0, mujoco 3.17.0, jax 0.10.2 (from Python 3.11).
# Matters for: policies that are trained in MJX on a robot whose latency and reflected inertia stand in the file: they
#   are trained on a robot without both, and walk on another one in MuJoCo.
# Source: google-deepmind/mujoco doc/mjx.rst, "Feature Parity", whose table does not list these; no issue found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0 mujoco-mjx==3.17.0 jax==0.10.2 jaxlib==0.10.2 \
  numpy==2.2.6
export JAX_PLATFORMS=cpu XLA_FLAGS=--xla_backend_optimization_level=0
venv/bin/python - <<'PY'
from importlib.metadata import version

import jax
import mujoco
from mujoco import mjx

jax.config.update("jax_enable_x64", True)
STEPS = 40
SERVO = '<position joint="hip" kp="20" kv="0.5" {}/>'
LEG = """<mujoco><option timestep="0.005" integrator="{integrator}" actuatorgroupdisable="{disabled}"/><worldbody>
<geom type="plane" size="5 5 0.1" {floor}/>
<body name="trunk" pos="0 0 0.38"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="3"/>
<body name="leg" pos="0 0 -0.1"><joint name="hip" axis="0 1 0" range="-60 60" {joint}/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5"/>
<geom size="0.04" pos="0 0 -0.25" mass="0.2"/></body></body></worldbody>
<actuator>{motor}</actuator><sensor><jointpos joint="hip" {sensor}/></sensor></mujoco>"""


def simulate(integrator="Euler", disabled="", floor="", joint="", motor=SERVO.format(""), sensor=""):
    """Return what the hip's sensor reads after STEPS, in MuJoCo and in MJX; None is an exception of MJX."""
    model = mujoco.MjModel.from_xml_string(LEG.format(**locals()))
    data = mujoco.MjData(model)
    data.ctrl[:], data.qvel[6] = 0.8, 1.0
    try:
        copy = mjx.put_model(model, impl="jax")
    except NotImplementedError:
        copy = None
    if copy is not None:
        start = mjx.make_data(copy, impl="jax")
        start = start.replace(ctrl=jax.numpy.array(data.ctrl), qvel=jax.numpy.array(data.qvel))
        copy = jax.jit(lambda there: jax.lax.fori_loop(0, STEPS, lambda _, now: mjx.step(copy, now), there))(start)
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
    return float(data.sensordata[0]), None if copy is None else float(copy.sensordata[0])


LIMITED = {"integrator": "implicitfast", "motor": SERVO.replace("0.5", "2").format('forcerange="-1 1"')}
TWO = '<motor joint="hip"/><motor joint="hip" gear="5" group="2"/>'
FREE = '<motor joint="hip"/>'
CASES = {  # the case without the feature, and with it
    "servo's delay of 30 ms": ({}, {"motor": SERVO.format('delay="0.03" nsample="8"')}),
    "servo's damping": ({}, {"motor": SERVO.format('damping="2"')}),
    "servo's armature": ({}, {"motor": SERVO.format('armature="0.1"')}),
    "sensor's delay of 50 ms": ({}, {"sensor": 'delay="0.05" nsample="12"'}),
    "joint's damping 0.1 2 3": ({"joint": 'damping="0.1"'}, {"joint": 'damping="0.1 2 3"'}),
    "joint's stiffness 5 20 30": ({"joint": 'stiffness="5"'}, {"joint": 'stiffness="5 20 30"'}),
    "floor that moves": ({"motor": FREE}, {"motor": FREE, "floor": 'surfacevel="1 0 0 0 0 0"'}),
    "second motor disabled": ({"motor": TWO}, {"motor": TWO, "disabled": "2"}),
}
print(*(f"{name} {version(name)}" for name in ("mujoco-mjx", "mujoco", "jax")), "- hip after 0.2 s, rad")
for name, (without, with_it) in CASES.items():
    plain, plain_mjx = simulate(**without)
    ours, theirs = simulate(**with_it)
    print(f"{name:26} MuJoCo {plain:7.4f} becomes {ours:7.4f} | MJX {plain_mjx:7.4f} becomes {theirs:7.4f}")
    assert abs(plain - plain_mjx) < 1e-6 < 0.02 < abs(ours - plain)
    assert abs(theirs - plain_mjx) < 0.05 * abs(ours - plain)
ours, theirs = simulate(**LIMITED)
print(f"servo at its forcerange, implicitfast: MuJoCo {ours:.4f} | MJX {theirs:.4f}")
assert abs(ours - theirs) > 0.02
LIMITED["integrator"] = "Euler"
ours, theirs = simulate(**LIMITED)
print(f"servo at its forcerange, Euler       : MuJoCo {ours:.4f} | MJX {theirs:.4f}")
assert abs(ours - theirs) < 1e-6
ours, theirs = simulate(motor='<pid joint="hip" kp="20" kv="0.5"/>')
print(f"<pid>: MJX {'raises' if theirs is None else 'does not raise'}")
assert theirs is None
PY
