"""Whether a robot may be mirrored, against simulations of it and of its mirror image, and random robots."""

import numpy as np
import pytest
from compositions import walking
from hypothesis import given, settings
from hypothesis import strategies as st
from two_sides import BOOM, biped, robot_of

from gctd3.envs.simulation import Simulation
from gctd3.errors import RobotError
from gctd3.robots import mirror_check
from gctd3.robots.mirror_check import MOST_RESIDUAL, check_mirror
from gctd3.robots.robot import Robot

TURNED = {"knee": "-0.1 1.4"}  # the range of a knee whose angles have the other sign
SYMMETRIC = {
    "plain": {},
    "gear": {"left_servos": {"gear": -1, **TURNED}},
    "axis": {"left": {"axis": "0 1 0", **TURNED}, "left_servos": TURNED},
    "axis and gear": {"left": {"axis": "0 1 0", **TURNED}, "left_servos": {"gear": -1}},
}
OTHERS = {
    "axis with the range of the other": ({"left": {"axis": "0 1 0"}}, "joint 'knee_right'"),
    "kp": ({"left_servos": {"kp": 90}}, "actuator 'a_hip_right'"),
    "force": ({"left_servos": {"force": "-20 40"}}, "actuator 'a_hip_right'"),
    "ctrlrange": ({"left_servos": {"hip": "-0.7 0.8"}}, "actuator 'a_hip_right'"),
    "gear with the range of the other": ({"left_servos": {"gear": -1}}, "actuator 'a_knee_right'"),
    "mass": ({"left": {"mass": 1.8}}, "the mass of body 'foot_right' and its mirror image 'foot_left'"),
    "damping": ({"left": {"dynamics": 'damping="2"'}}, "joint 'hip_right' and its mirror image 'hip_left': damping"),
    "friction": ({"left": {"dynamics": 'damping="1" frictionloss="0.3"'}}, "'hip_left': frictionloss 0 is not 0.3"),
}


def error_on_a_boom(robot, steps=10, robots=8):
    """Largest difference of the features after reflecting and stepping, and after stepping and reflecting."""
    task = walking(robot)
    joints = {joint.name: joint for joint in robot.joints}
    order, signs = robot.action_mirror
    pair = [Simulation(task, robots, seed=0, threads=1) for _ in range(2)]
    for simulation in pair:
        simulation.reset(np.ones(robots, dtype=bool))
    one, two = pair
    state, model = one.state.copy(), robot.model
    for joint in robot.joints:
        other, sign = joints[robot.mirror[joint.name]], robot.mirror_sign(joint.name)
        state[:, 1 + joint.qpos] = sign * one.state[:, 1 + other.qpos]
        state[:, 1 + model.nq + joint.qvel] = sign * one.state[:, 1 + model.nq + other.qvel]
    two.state = state
    rng, source, swapped = np.random.default_rng(1), *task.table.reflection()
    worst = 0.0
    for _ in range(steps):
        action = rng.uniform(-1.0, 1.0, (robots, len(order)))
        one.step(action)
        two.step(signs * action[:, order])
        seen, mirrored = (task.node_features(s.now).reshape(robots, -1) for s in pair)
        worst = max(worst, float(np.abs(swapped * seen[:, source] - mirrored).max()))
    return worst


@pytest.mark.parametrize("case", SYMMETRIC)
def test_other_conventions_are_the_same_robot(case):
    robot = robot_of(biped(**SYMMETRIC[case]))
    assert error_on_a_boom(robot) < 1e-5  # features are 32-bit
    verdict = check_mirror(robot, 0.02)
    assert verdict.symmetric and verdict.residual < 1e-9 and not verdict.reason
    walking(robot).reflection()


@pytest.mark.parametrize("case", OTHERS)
def test_other_robots_are_refused_by_the_name_of_what_differs(case):
    changes, named = OTHERS[case]
    robot = robot_of(biped(**changes))
    assert error_on_a_boom(robot) > 1e-3
    verdict = check_mirror(robot, 0.02)
    assert not verdict.symmetric and named in verdict.reason
    assert str(verdict).startswith("mirror: off, for ") and "\n" not in str(verdict)
    with pytest.raises(RobotError, match=r"replay\.mirror=false, .*equivariant=false if that is on; or mend"):
        walking(robot).reflection()


@pytest.mark.parametrize("base", ["<freejoint/>", BOOM + '<joint name="ry" axis="0 1 0"/>'], ids=["free", "planar"])
def test_the_same_on_other_bases(base):
    for changes in SYMMETRIC.values():
        verdict = check_mirror(robot_of(biped(base, **changes)), 0.02)
        assert verdict.symmetric and verdict.residual < 1e-9
    for changes, named in OTHERS.values():
        assert named in check_mirror(robot_of(biped(base, **changes)), 0.02).reason


def test_what_a_robot_may_differ_by_is_measured():
    verdict = check_mirror(robot_of(biped("<freejoint/>", trunk="0 0.002 0.12")), 0.02)
    assert verdict.symmetric and 1e-4 < verdict.residual < MOST_RESIDUAL
    # 6 of 9.2 kg, all of which the trunk carries.
    assert verdict.reason == "the centre of mass of body 'torso', 2 mm off the middle"
    assert str(verdict).startswith("mirror: on, residual ") and str(verdict).endswith(f"explained by {verdict.reason}")
    farther = check_mirror(robot_of(biped("<freejoint/>", trunk="0 0.03 0.12")), 0.02)
    assert not farther.symmetric and "the centre of mass of body 'torso', 30 mm off the middle" in farther.reason
    assert farther.residual > MOST_RESIDUAL > verdict.residual
    # Sideways it moves nothing on a boom.
    assert check_mirror(robot_of(biped(trunk="0 0.03 0.12")), 0.02).residual < 1e-9


def test_what_no_number_says_shows_in_the_motion():
    sites = '<site name="above"/>', '<site name="below" pos="0 0 -0.2"/>'
    text = biped("<freejoint/>", more=TENDON).replace('<body name="foot_left" pos="0 0 -0.25">', FOOT.format(*sites))
    text = text.replace('<body name="torso" pos="0 0 0.53">', f'<body name="torso" pos="0 0 0.53">{sites[0]}')
    verdict = check_mirror(robot_of(text), 0.02)
    assert not verdict.symmetric and "something beside masses that acts on it is not the same" in verdict.reason
    assert "_left" in verdict.reason


FOOT = '<body name="foot_left" pos="0 0 -0.25">{1}'
TENDON = """<tendon><spatial name="spring" stiffness="300" springlength="0.1">
  <site site="above"/><site site="below"/></spatial></tendon>"""


def test_feet_that_slip_otherwise():
    text = biped("<freejoint/>").replace('name="sole_left"', 'name="sole_left" friction="0.2 0.005 0.0001"')
    reason = check_mirror(robot_of(text), 0.02).reason
    assert reason == "foot 'foot_right' and its mirror image 'foot_left': their friction is not the same"


def test_feet_of_another_shape_are_told_of():
    text = biped("<freejoint/>").replace('fromto="0 0 -0.03 0 0 -0.25" size="0.025" mass="0.6"', "{}")
    sole = 'fromto="0 0 -0.03 0 0 -0.25" size="{}" mass="0.6"'
    verdict = check_mirror(robot_of(text.format(sole.format(0.025), sole.format(0.026))), 0.02)
    assert "the outline of foot 'foot_right' and its mirror image 'foot_left', 1 mm off" in verdict.reason


def test_passive_joints_count():
    # A rod hangs on each thigh by a ball, and the task knows nothing of either.
    rod = (
        '<body name="rod_{0}"><joint name="rod_{0}" type="ball"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="{1}" contype="0" conaffinity="0"/></body>'
    )

    def with_rods(left):
        text = biped("<freejoint/>")
        for side, mass in (("right", 0.05), ("left", left)):
            text = text.replace(f'<body name="foot_{side}"', f'{rod.format(side, mass)}<body name="foot_{side}"')
        robot = robot_of(text, feet=["foot_right", "foot_left"])
        driven = tuple(joint for joint in robot.joints if joint.kind != "ball")
        return Robot(robot.model, robot.path, robot.root, driven, robot.actuated, robot.feet, robot.forward_axis)

    verdict = check_mirror(with_rods(0.05), 0.02)
    assert verdict.symmetric and verdict.residual < 1e-9
    assert "body 'rod_right' and its mirror image 'rod_left'" in check_mirror(with_rods(2.0), 0.02).reason


def test_it_is_decided_once(monkeypatch):
    robot, decided = robot_of(biped()), []
    monkeypatch.setattr(mirror_check, "_check", lambda *given: decided.append(given[1]) or "verdict")
    assert [check_mirror(robot, dt) for dt in (0.02, 0.02, 0.01)] == ["verdict"] * 3 and decided == [0.02, 0.01]


# Random robots: legs of any joints about any axes, each pair in a convention of its own.


def numbers(*values):
    return " ".join(f"{value:.17g}" for value in values)


def random_robot(seed, change=None):
    """A robot whose right side mirrors its left one; ``change`` maps attributes of one right joint to others."""
    rng = np.random.default_rng(seed)
    pairs = int(rng.integers(1, 4))
    bodies, actuators = [], []
    flip, turn = np.array([1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0])
    perturbed = (int(rng.integers(pairs)), 0)
    for pair in range(pairs):
        start = np.array([0.4 * (pair - (pairs - 1) / 2), rng.uniform(0.1, 0.2), rng.uniform(-0.05, 0.05)])
        links = []
        for _ in range(int(rng.integers(1, 4))):
            axis, end = rng.normal(size=3), np.array([*rng.uniform(-0.05, 0.05, 2), -rng.uniform(0.1, 0.2)])
            low, high = -rng.uniform(0.2, 1.0), rng.uniform(0.2, 1.0)
            links.append((axis / np.linalg.norm(axis), end, low, high, *rng.uniform((0.2, 0.1, 10), (1, 2, 80))))
        for side, name in ((1, "left"), (-1, "right")):
            place, text, close = start * (flip if side < 0 else 1), "", ""
            for depth, (axis, end, low, high, mass, damping, kp) in enumerate(links):
                limits, gear, about, out = [low, high], 1, axis, end
                if side < 0:
                    about, out = turn * axis, flip * end
                    if rng.integers(2):
                        about, limits = -about, [-high, -low]
                    gear = int(rng.choice([1, -1]))
                values = {"kp": kp, "damping": damping, "armature": 0.01, "mass": mass, "range": limits, "axis": about}
                values["force"], values["at"] = 30.0, np.zeros(3)
                if side < 0 and change is not None and (pair, depth) == perturbed:
                    values = {key: change[1](value) if key == change[0] else value for key, value in values.items()}
                joint = f"{name}_{pair}_{depth}"
                text += f"""<body name="link_{joint}" pos="{numbers(*place)}">
                  <joint name="{joint}" axis="{numbers(*values["axis"])}" pos="{numbers(*values["at"])}"
                    range="{numbers(*values["range"])}" damping="{numbers(values["damping"])}"
                    armature="{numbers(values["armature"])}"/>
                  <geom type="capsule" fromto="0 0 0 {numbers(*out)}" size="0.02" mass="{numbers(values["mass"])}"
                    contype="1" conaffinity="0"/>"""
                drawn = limits if gear > 0 else [-limits[1], -limits[0]]
                actuators.append(
                    f'<position name="servo_{joint}" joint="{joint}" kp="{numbers(values["kp"])}" kv="1" gear="{gear}" '
                    f'ctrlrange="{numbers(*drawn)}" forcerange="{numbers(-values["force"], values["force"])}"/>'
                )
                place, close = out, close + "</body>"
            bodies.append(text + close)
    text = f"""<mujoco><compiler angle="radian"/> <option timestep="0.005" integrator="implicitfast"/>
      <worldbody><geom name="floor" type="plane" size="0 0 1" contype="0" conaffinity="1"/>
      <body name="trunk" pos="0 0 1"><freejoint/><geom type="box" size="0.3 0.1 0.05" mass="5" contype="1"
      conaffinity="0"/>{"".join(bodies)}</body></worldbody><actuator>{"".join(actuators)}</actuator></mujoco>"""
    return robot_of(text, forward="x"), f"right_{perturbed[0]}_0"


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6))
def test_a_random_symmetric_robot_passes(seed):
    robot, _ = random_robot(seed)
    assert all(robot.mirror[name] == swapped(name) for name in robot.mirror)
    verdict = check_mirror(robot, 0.02)
    assert verdict.symmetric and verdict.residual < 1e-9 and not verdict.reason


def swapped(name):
    return name.replace("left", "right") if name.startswith("left") else name.replace("right", "left")


CHANGES = {
    "kp": lambda kp: 1.01 * kp,
    "damping": lambda damping: 1.001 * damping,
    "armature": lambda armature: 10 * armature,
    "range": lambda limits: [limits[0], limits[1] + 0.01],
    "force": lambda force: force + 0.1,
    "axis": lambda axis: axis + 0.02,
    "at": lambda at: at + 0.003,
    "mass": lambda mass: 8.0 * mass,
}


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 10**6))
@pytest.mark.parametrize("what", CHANGES)
def test_a_perturbed_one_is_refused_by_name(what, seed):
    robot, name = random_robot(seed, (what, CHANGES[what]))
    verdict = check_mirror(robot, 0.02)
    assert not verdict.symmetric and f"{name}'" in verdict.reason
