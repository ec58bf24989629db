"""Files of robots that lack something, and whether what is made of them trains."""

from pathlib import Path

import mujoco
import numpy as np
from compositions import STILL, walking

from gctd3.envs.simulation import Simulation
from gctd3.robots.settings import RobotSettings

CASES = Path(__file__).parent / "robots" / "cases"
SHIPPED = ("biped", "biped_planar", "quadruped", "hexapod")
LEG = """
<body name="thigh_{n}" pos="{x} {y} 0"><joint name="hip_{n}" axis="0 1 0" range="-90 90"/>
  <geom name="thigh_{n}" type="capsule" fromto="0 0 0 0 0 -.2" size=".03" mass=".5"/>
  <body name="shank_{n}" pos="0 0 -.2"><joint name="knee_{n}" axis="0 1 0" range="-150 5"/>
    <geom name="shank_{n}" type="capsule" fromto="0 0 0 0 0 -.17" size=".02" mass=".3"/>
    <geom name="ball_{n}" size=".03" pos="0 0 -.2" mass=".05"/>
  </body>
</body>"""
LEGS = [("fl", 0.2, 0.1), ("fr", 0.2, -0.1), ("hl", -0.2, 0.1), ("hr", -0.2, -0.1)]


def dog(tmp_path, actuator="", floor='<geom name="floor" type="plane" size="0 0 1"/>', rest="", inside="", legs=LEGS):
    """A robot with four legs of two joints; ``{n}`` in ``actuator`` is each joint's name."""
    joints = [f"{part}_{n}" for n, *_ in legs for part in ("hip", "knee")]
    drives = "".join(actuator.format(n=joint) for joint in joints)
    path = tmp_path / "dog.xml"
    path.write_text(
        f"""<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>{floor}
        <body name="trunk" pos="0 0 .5"><freejoint/><geom name="trunk" type="box" size=".25 .08 .05" mass="6"/>
        {"".join(LEG.format(n=n, x=x, y=y) for n, x, y in legs)}{inside}</body></worldbody>
        <actuator>{drives}</actuator>{rest}</mujoco>"""
    )
    return path


def case(name):
    return RobotSettings(name=str(CASES / name))


def trains(robot, steps=20):
    """The simulation after some steps of random actions, which must stay finite."""
    simulation = Simulation(walking(robot, **STILL), 2, threads=1)
    simulation.reset(np.ones(2, dtype=bool))
    rng = np.random.default_rng(0)
    for _ in range(steps):
        simulation.step(rng.uniform(-0.1, 0.1, (2, len(robot.actuated))))
    assert np.isfinite(simulation.state).all()
    return simulation


def bits(model):
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer
