"""The biped has the published numbers, comes to rest under its servos, and is read correctly by `Robot`."""

import mujoco
import numpy as np
import pytest

from gctd3 import Robot

SIDES = ("right", "left")
MASSES = {"body": 4.0200, "thigh": 1.7324, "shank": 0.7527, "foot": 0.4111}  # kg, Table 1
INERTIAS = {  # com (x, z) in m; Ixx, Iyy, Izz in kg m^2: the authors' URDF
    "body": ((0.0, -0.04), (0.0155, 0.0164, 0.0219)),
    "thigh": ((0.0, -0.0827), (0.0158, 0.0164, 0.0019)),
    "shank": ((0.0, -0.1098), (0.0057, 0.0056, 0.0005)),
    "foot": ((0.0229, -0.0416), (0.0006, 0.0012, 0.0013)),
}
RANGES = {"hip": (-0.7854, 0.7854), "knee": (-1.3962, 0.0012), "ankle": (-0.7854, 0.7854)}  # rad, Table 2
GAINS = {"hip": (50.0, 10.0), "knee": (50.0, 3.0), "ankle": (63.0, 1.0)}  # P, D: the authors' controllers
EFFORT, SPEED = 30.0, 7.0  # N m, rad/s: the authors' URDF
DROP = 0.0235  # m, soles above the ground at qpos 0
ACTIONS = ("hip_right", "knee_right", "ankle_right", "hip_left", "knee_left", "ankle_left")


@pytest.fixture
def floating() -> mujoco.MjModel:
    model = Robot.from_mjcf("biped").model
    model.opt.gravity[:] = 0.0
    return model


def in_the_air(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.joint("root_z").qpos[0] = 1.0
    return data


def kind(name: str) -> str:  # of a link or joint: its name without the side
    return name.split("_")[0]


# Published numbers.


@pytest.mark.parametrize("link", [f"{part}_{side}" for part in ("thigh", "shank", "foot") for side in SIDES] + ["body"])
def test_masses_and_inertias_are_the_published_ones(robot, link):
    body = robot.model.body(link)
    (x, z), inertia = INERTIAS[kind(link)]
    assert body.mass[0] == pytest.approx(MASSES[kind(link)])
    np.testing.assert_allclose(body.ipos, (x, 0.0, z))
    np.testing.assert_allclose(body.iquat, (1, 0, 0, 0))
    np.testing.assert_allclose(body.inertia, inertia)


def test_total_mass_and_heights_at_qpos_0(robot):
    # 4.0200 + 2 (1.7324 + 0.7527 + 0.4111) kg: geoms add none
    assert robot.model.body_mass.sum() == pytest.approx(9.8124)
    data = mujoco.MjData(robot.model)
    mujoco.mj_forward(robot.model, data)
    assert data.body("body").xpos[2] == pytest.approx(0.653)
    for side, y in zip(SIDES, (-0.1, 0.1), strict=True):
        np.testing.assert_allclose(data.joint(f"hip_{side}").xanchor, (0.0, y, 0.613), atol=1e-9)
        assert data.joint(f"ankle_{side}").xanchor[2] == pytest.approx(0.0935)
        sole = data.geom(f"foot_{side}").xpos[2] - robot.model.geom(f"foot_{side}").size[2]
        assert sole == pytest.approx(DROP)
        assert 2 * robot.model.geom(f"foot_{side}").size[0] == pytest.approx(0.153, abs=0.003)  # its length
    assert robot.standing_qpos[robot.vertical] == pytest.approx(-DROP)


def test_joints_servos_and_limits(robot):
    assert tuple(joint.name for joint in robot.joints) == ACTIONS  # depth first: right leg, left leg
    assert robot.actuated == robot.action_names == ACTIONS
    np.testing.assert_allclose(robot.action_range, [RANGES[kind(name)] for name in ACTIONS])
    for joint in robot.joints:
        assert joint.range == pytest.approx(RANGES[kind(joint.name)])
        p, d = GAINS[kind(joint.name)]
        servo = robot.model.actuator(joint.name)
        np.testing.assert_allclose(servo.gainprm[:3], (p, 0, 0))
        np.testing.assert_allclose(servo.biasprm[:3], (0, -p, -d))
        np.testing.assert_allclose(servo.forcerange, (-EFFORT, EFFORT))
        back_emf = 0.0 if kind(joint.name) == "hip" else EFFORT / SPEED
        assert robot.model.joint(joint.name).damping[0] == pytest.approx(back_emf, rel=1e-4)
        assert robot.model.joint(joint.name).frictionloss[0] == 0.0


def test_physics_steps_fit_50_hz_and_depend_on_the_state_alone(robot):
    assert robot.model.opt.timestep == pytest.approx(0.02 / 4)
    assert robot.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_WARMSTART
    assert robot.model.geom("ground").friction[0] == robot.model.geom("foot_right").friction[0] == 1.0


@pytest.mark.parametrize("joint, axis", [("hip", 0), ("knee", 0), ("ankle", 2)])
def test_positive_is_thigh_forward_knee_stretched_toes_up(robot, joint, axis):
    data = mujoco.MjData(robot.model)
    sole = []
    for angle in (-0.1, 0.0):
        data.joint(f"{joint}_right").qpos[0] = angle
        mujoco.mj_forward(robot.model, data)
        sole.append(data.geom("foot_right").xpos[axis])
    assert sole[1] - sole[0] > 1e-3


def test_every_element_is_named(robot):
    counts = {"body": "nbody", "joint": "njnt", "geom": "ngeom", "actuator": "nu", "sensor": "nsensor"}
    for element, count in counts.items():
        names = [getattr(robot.model, element)(i).name for i in range(getattr(robot.model, count))]
        assert names and all(names), f"{element}: {names}"
    assert {robot.model.camera(i).name for i in range(robot.model.ncam)} == {"side", "three_quarter"}


# Behaviour.


def test_stands_still_for_5_s(robot):
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    for _ in range(1000):
        mujoco.mj_step(robot.model, data)
        assert abs(data.qpos[robot.vertical] + DROP) < 0.002
    assert (data.sensordata[robot.contact_sensors(robot.feet)] > 0).all()


@pytest.mark.parametrize("pose", [(0, 0.6, 0), (0.3, -0.5, 0.2), (-0.3, 0.2, 0.3), (0, 0, 0.5)])
def test_held_servos_come_to_rest(robot, pose):
    """A robot with held servos loses energy and comes to rest; contacts that add energy would keep it hopping."""
    model, data = robot.model, mujoco.MjData(robot.model)
    low, high = robot.action_range.T
    data.ctrl[:] = (low + high) / 2 + (high - low) / 2 * np.tile(pose, 2)
    heights = []
    for step in range(1200):  # 6 s
        mujoco.mj_step(model, data)
        if step >= 800:
            heights.append(data.qpos[robot.vertical])
    assert np.ptp(heights) < 1e-3
    assert np.abs(data.qvel).max() < 0.05
    assert (data.sensordata[robot.contact_sensors(robot.feet)] > 0).all()


@pytest.mark.parametrize("name", ACTIONS)
def test_servo_follows_a_step_within_1_s(floating, name):
    target = -0.3 if kind(name) == "knee" else 0.3
    data = in_the_air(floating)
    data.actuator(name).ctrl[0] = target
    for _ in range(200):
        mujoco.mj_step(floating, data)
    assert data.joint(name).qpos[0] == pytest.approx(target, rel=0.02)


@pytest.mark.parametrize("name", ACTIONS)
@pytest.mark.parametrize("start, end", [(0, 1), (1, 0)])
def test_servo_driven_full_swing_stays_below_7_rad_s(floating, name, start, end):
    data = in_the_air(floating)
    limits = RANGES[kind(name)]
    data.joint(name).qpos[0], data.actuator(name).ctrl[0] = limits[start], limits[end]
    fastest = 0.0
    for _ in range(400):
        mujoco.mj_step(floating, data)
        fastest = max(fastest, abs(data.joint(name).qvel[0]))
    assert 5.0 < fastest <= SPEED


def test_nothing_explodes_under_random_targets(robot):
    model, (low, high) = robot.model, robot.action_range.T
    fallen = robot.contact_sensors(robot.other_contact_bodies)
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    speeds = []
    for step in range(10_000):
        if step % 5 == 0:
            data.ctrl[:] = rng.uniform(low, high)
        for _ in range(4):
            mujoco.mj_step(model, data)
            speeds.append(np.abs(data.qvel))
        if data.qpos[robot.vertical] + DROP < -0.1 or data.sensordata[fallen].any():
            mujoco.mj_resetData(model, data)
    speeds = np.array(speeds)
    assert np.isfinite(speeds).all() and not any(warning.number for warning in data.warning)
    joints = speeds[:, [joint.qvel for joint in robot.joints]]
    assert speeds[:, [robot.forward, robot.vertical]].max() < 5.0
    assert joints.max() < 20.0
    assert (np.percentile(joints, 99, axis=0) < 7.5).all()


# The left/right mirror.


def test_mirror_names_and_actions(robot):
    assert robot.mirror_name("hip_right") == "hip_left" and robot.mirror_name("foot_left") == "foot_right"
    assert robot.mirror_name("body") == "body"
    order, sign = robot.action_mirror
    assert order.tolist() == [3, 4, 5, 0, 1, 2] and sign.tolist() == [1.0] * 6


def test_mirrored_actions_make_the_mirrored_walk(robot):
    order, sign = robot.action_mirror
    rng = np.random.default_rng(0)
    data, mirrored = mujoco.MjData(robot.model), mujoco.MjData(robot.model)
    for _ in range(20):
        action = rng.uniform(-0.3, 0.3, 6)
        data.ctrl[:], mirrored.ctrl[:] = action, sign * action[order]
        mujoco.mj_step(robot.model, data, 4)
        mujoco.mj_step(robot.model, mirrored, 4)
    joints = [joint.qpos for joint in robot.joints]
    assert np.abs(data.qpos[joints] - mirrored.qpos[joints]).max() > 0.05
    np.testing.assert_allclose(data.qpos[joints], (sign * mirrored.qpos[joints][order]), atol=1e-5)
    np.testing.assert_allclose(data.qpos[:2], mirrored.qpos[:2], atol=1e-5)


# Properties that `Robot` reads.


def test_reads_base_legs_feet_and_sensors(robot):
    assert (robot.root, robot.forward, robot.vertical) == ("body", 0, 1)
    assert robot.feet == ("foot_right", "foot_left")
    assert [[joint.name for joint in leg] for leg in robot.legs] == [list(ACTIONS[:3]), list(ACTIONS[3:])]
    assert robot.joint("knee_left").parent == "hip_left" and robot.joint("hip_left").parent is None
    assert robot.contact_sensors(robot.feet).tolist() == [0, 1]
    assert set(robot.other_contact_bodies) == {"body", *(f"{part}_{s}" for part in ("thigh", "shank") for s in SIDES)}
