"""Motion that is recorded during evaluation equals MuJoCo's own numbers and distances."""

import csv
import json
import math

import mujoco
import numpy as np
import pytest
import torch
from compositions import env_of
from running import command
from tensordict.nn import TensorDictModule

from gctd3.envs.simulation import Simulation
from gctd3.evaluation.episode import Episode
from gctd3.evaluation.gait_metrics import strides
from gctd3.evaluation.quantities import QUANTITIES, quantity
from gctd3.evaluation.recorder import Motion, Recorder, Servos, soles, total_mass
from gctd3.evaluation.rollout import evaluate
from gctd3.evaluation.summary import OF_STRIDES, summarize
from gctd3.robots.robot import Robot
from gctd3.runs.evaluate import table, trace

DT = 0.02


@pytest.fixture(params=["biped", "biped_planar", "quadruped"])
def any_robot(request):
    return Robot.from_mjcf(request.param)


def test_servo_forces_are_mujocos(any_robot):
    model, rng = any_robot.model, np.random.default_rng(0)
    data, servos = mujoco.MjData(model), Servos(any_robot.model)
    clipped = 0
    for _ in range(50):
        data.qpos[:] = any_robot.standing_qpos
        for joint in any_robot.joints:
            data.qpos[joint.qpos] += rng.uniform(-1, 1)
        data.qvel[:] = rng.uniform(-5, 5, model.nv)
        data.ctrl[:] = rng.uniform(*any_robot.action_range.T)
        mujoco.mj_forward(model, data)
        found = servos.force(np.array(data.qpos), np.array(data.qvel), np.array(data.ctrl))
        assert found == pytest.approx(np.array(data.actuator_force))
        clipped += (np.abs(found) == 30.0).sum()
    assert clipped > 50  # both cases occur


@pytest.mark.parametrize("gear", [1.0, 3.0, -2.0])
@pytest.mark.parametrize("own", ["", 'forcerange="-6 9"'])
@pytest.mark.parametrize("at_joint", ["", 'actuatorfrcrange="-5 8"'])
def test_servo_forces_are_what_the_joint_gets(gear, own, at_joint):
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><worldbody><body><joint name="hip" axis="0 1 0" {at_joint}/><geom size="0.05" pos="0 0 -0.3"/></body>
    </worldbody><actuator><position joint="hip" kp="20" kv="1" gear="{gear}" {own}/></actuator></mujoco>""")
    data, servos, rng, bounds = mujoco.MjData(model), Servos(model), np.random.default_rng(0), set()
    for _ in range(100):
        data.qpos[:], data.qvel[:], data.ctrl[:] = rng.uniform(-1, 1), rng.uniform(-5, 5), rng.uniform(-1, 1)
        mujoco.mj_forward(model, data)
        found = servos.force(np.array(data.qpos), np.array(data.qvel), np.array(data.ctrl))
        assert found * gear == pytest.approx(np.array(data.qfrc_actuator))
        if servos.saturated(found)[0]:
            bounds.add(round(found[0] * gear, 6))
    low, high = sorted(np.array([-6, 9]) * gear) if own else (-np.inf, np.inf)
    if at_joint:
        low, high = max(low, -5.0), min(high, 8.0)
    assert bounds == {bound for bound in (low, high) if np.isfinite(bound)}


FILTERED = """
<mujoco><option timestep="0.005"/><worldbody>
 <body name="base"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/>
  <body name="leg"><joint name="hip" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.3" mass="0.5"/></body></body>
</worldbody><actuator>
 <position joint="hip" kp="20" kv="1" gear="2" timeconst="0.05" ctrlrange="-1 1" forcerange="-8 8"/></actuator></mujoco>
"""


def test_servos_with_a_gear_and_a_filter():
    model = mujoco.MjModel.from_xml_string(FILTERED)
    data, servos = mujoco.MjData(model), Servos(model)
    data.ctrl[:] = 0.9
    for _ in range(5):
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        assert servos.filtered.all() and servos.act.tolist() == [0]
        found = servos.force(np.array(data.qpos), np.array(data.qvel), np.array(data.act))
        assert found == pytest.approx(np.array(data.actuator_force))


def test_work_lifts_the_robot(task):
    """Without ground, gravity and damping, the servos' work equals the change of the robot's kinetic energy."""
    xml = task.robot.path.read_text().replace('damping="4.2857"', "").replace("gravity=", 'viscosity="0" gravity=')
    xml = xml.replace("0 0 -9.81", "0 0 0").replace('range="-1.3962 0.0012"/>', 'range="-9 9"/>', 1)
    robot = Robot.from_mjcf(mujoco.MjSpec.from_string(xml))
    model = robot.model
    model.opt.timestep = 0.0005
    model.jnt_limited[:] = 0
    model.geom_contype[:] = 0
    simulation = Simulation(type(task)(robot), 1, seed=0, threads=1)
    simulation.reset(np.ones(1, dtype=bool))
    recorder, data = Recorder(robot, simulation), mujoco.MjData(model)

    def energy():
        data.qpos[:], data.qvel[:] = simulation.state[0, 1:9], simulation.state[0, 9:17]
        mujoco.mj_forward(model, data)
        mujoco.mj_energyVel(model, data)
        return float(data.energy[1])

    before = energy()
    signed = 0.0
    for step in range(10):
        action = np.full((1, 6), 0.3 * (-1) ** (step // 3))
        simulation.step(action)
        recorder.add(action)
        states = simulation.trail()[0]
        force = recorder.servos.force(states[:-1, 1:9], states[1:, 9:17], simulation.desired(action))
        driven = [robot.joint(name).qvel + 9 for name in robot.actuated]
        signed += (force * (states[:-1, driven] + states[1:, driven]) / 2).sum() * 0.0005
    motion = recorder.motions([10])[0]
    assert signed == pytest.approx(energy() - before, rel=0.03)
    absolute, positive = motion.work.sum(axis=0)
    # |w| = 2 max(w, 0) - w, term by term.
    assert absolute == pytest.approx(2 * positive - signed)
    assert absolute > positive > 0


def test_soles_by_a_ruler(robot):
    qpos = np.repeat(robot.standing_qpos[None], 4, axis=0)
    qpos[:, robot.forward] = [0.0, 0.0, 0.03, 0.03]  # slides 3 cm in one sample
    qpos[3, robot.vertical] += 0.05
    height, speed = soles(robot, qpos, DT)
    assert height == pytest.approx(np.array([[0.0, 0.0]] * 3 + [[0.05, 0.05]]))
    assert speed == pytest.approx(np.array([[0.0, 0.0], [1.5, 1.5], [0.0, 0.0], [0.0, 0.0]]))


def test_a_foot_that_rolls_over_its_toe_does_not_slip(robot):
    """A turn about the sole's front edge, which stays in place, gives no slip."""
    model, data = robot.model, mujoco.MjData(robot.model)
    ankle, foot = robot.joint("ankle_right"), model.body("foot_right").id
    qpos = np.repeat(robot.standing_qpos[None], 3, axis=0)
    qpos[:, ankle.qpos] = [-0.2, -0.3, -0.4]
    for pose in qpos:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        toe = data.xpos[foot] + data.xmat[foot].reshape(3, 3) @ [0.1, 0.0, -0.07]
        pose[robot.forward] -= toe[0] - 0.1
        pose[robot.vertical] -= toe[2]
    height, speed = soles(robot, qpos, DT)
    assert height[:, 0] == pytest.approx(0.0, abs=1e-9)
    assert speed[:, 0] == pytest.approx(0.0, abs=1e-9)
    assert (speed[:, 1] > 0.1).all()  # the other foot goes with the body


def test_size_and_mass_of_the_biped(robot):
    assert robot.leg_length == pytest.approx(0.613 - 0.0235)
    assert total_mass(robot) == pytest.approx(4.02 + 2 * (1.7324 + 0.7527 + 0.4111))


# The table of numbers.


def made_up(robot, period=30, duty=0.6, lag=15, steps=700, speed=1.0, left_extra=0.0):
    """Make an episode at constant speed: joints swing as sines, half a stride apart, and feet step with them."""
    time = np.arange(steps)
    phase = time / period
    other = phase - lag / period
    right, left = 0.4 * np.sin(2 * np.pi * phase), 0.4 * np.sin(2 * np.pi * other) + left_extra
    angles = np.stack([right if "right" in joint.name else left for joint in robot.joints], axis=1)
    down = {"right": time % period < duty * period, "left": (time - lag) % period < duty * period}
    feet = np.stack([down["right" if "right" in foot else "left"] for foot in robot.feet], axis=1)
    count = len(robot.actuated)
    motion = Motion(
        action=np.stack([0.5 * np.sin(2 * np.pi * phase)] * count, axis=1),
        angles=angles,
        velocities=np.gradient(angles, DT, axis=0),
        velocity=np.full(steps, speed),
        state=np.concatenate([angles, np.gradient(angles, DT, axis=0)], axis=1),
        work=np.tile([2.0, 1.5], (steps, 1)),
        saturated=np.tile([0.25, *[0] * (count - 2), 0.5], (steps, 1)),
        sole_height=np.where(feet, 0.0, 0.04),
        sole_speed=np.where(feet, 0.01, 2.0),
    )
    position = speed * DT * (time + 1)
    pairs = tuple((i, other) for i, other in enumerate(robot.mirror_feet) if i < other)
    return Episode(np.ones(steps), position, np.zeros(steps), np.where(feet, 0.1, 0.0), feet, True, pairs, motion)


def test_the_metrics_of_a_made_up_walk(robot):
    found = summarize([made_up(robot), made_up(robot)], robot, DT)
    assert found["periodic_fraction"] == 1.0
    # 500 steps from step 200 on: whole strides of 30 between the touchdowns at 210 and 690 (right), 225 and 675 (left).
    assert found["strides"] == 2 * (16 + 15)
    assert found["stride_variation"] == pytest.approx(0.0)
    assert found["duty_factor"] == pytest.approx(0.6)
    assert found["phase_offset"] == pytest.approx(0.5)
    assert found["duty_symmetry"] == pytest.approx(0.0) and found["step_symmetry"] == pytest.approx(0.0)
    assert found["regularity"] == pytest.approx(1.0)
    assert found["foot_clearance"] == pytest.approx(0.04)
    assert found["asymmetry_hip_right"] == pytest.approx(0.0, abs=1e-9)
    assert found["froude"] == pytest.approx(1.0 / (9.81 * 0.5895))
    # 2 J in 0.02 m of 9.8124 kg.
    assert found["cost_of_transport"] == pytest.approx(100.0 / (9.8124 * 9.81))
    assert found["cost_of_transport_positive"] == pytest.approx(75.0 / (9.8124 * 9.81))
    assert found["torque_saturation"] == pytest.approx(12.5)
    assert found["slip_speed"] == pytest.approx(0.01)
    # A sine of 1 / 0.6 Hz; differences of a sine of amplitude a are 2 a sin(w dt / 2) in size.
    step = 2 * math.sin(math.pi / 30)
    assert found["action_rate"] == pytest.approx(0.5 / math.sqrt(2) * step / DT, rel=0.01)
    assert found["action_jerk"] == pytest.approx(0.5 / math.sqrt(2) * (step / DT) ** 3, rel=0.01)


def test_four_legs_are_measured_in_pairs():
    quadruped = Robot.from_mjcf("quadruped")
    found = summarize([made_up(quadruped)], quadruped, DT)
    assert found["strides"] == 2 * (16 + 15)
    assert found["phase_offset"] == pytest.approx(0.5) and found["duty_factor"] == pytest.approx(0.6)
    asymmetry = {key: value for key, value in found.items() if key.startswith("asymmetry_")}
    assert len(asymmetry) == len(quadruped.joints) / 2
    assert max(asymmetry.values()) == pytest.approx(0.0, abs=1e-9)


def test_a_limp_is_seen(robot):
    # The left foot comes after a third of the stride, and the left joints stand 0.1 rad further forward.
    found = summarize([made_up(robot, lag=10, left_extra=0.1)], robot, DT)
    assert found["phase_offset"] == pytest.approx(1 / 3)
    assert found["step_symmetry"] == pytest.approx(200 * (1 / 3 - 2 / 3))
    # L = A sin(p - 1/3) + 0.1 seen half a stride later: R - L = A (sin p - sin(p + 1/6)) - 0.1.
    expected = math.sqrt((0.4 * 2 * math.sin(math.pi / 6)) ** 2 / 2 + 0.01)
    assert found["asymmetry_knee_right"] == pytest.approx(expected, rel=0.01)


def test_a_bounce_of_four_samples_is_no_stride(robot):
    walk = made_up(robot, period=44, lag=22)
    plain = summarize([walk], robot, DT)
    for foot in walk.feet_down.T:
        foot[np.flatnonzero(foot[1:] & ~foot[:-1])[1:, None] + [6, 7, 8, 9]] = False
    bounced = summarize([walk], robot, DT)
    assert bounced["stride_time"] == pytest.approx(44 * DT)
    for name in ("strides", "duty_factor", "phase_offset", "stride_variation"):
        assert bounced[name] == plain[name]


@pytest.mark.parametrize("duty", [0.1, 0.15, 0.175, 0.225])
def test_a_run_whose_feet_are_hardly_down_has_strides(robot, duty):
    found = summarize([made_up(robot, period=40, duty=duty, lag=20)], robot, DT)
    assert found["periodic_fraction"] == 1.0
    assert found["duty_factor"] == pytest.approx(duty)
    assert found["stride_time"] == pytest.approx(40 * DT)
    assert found["stride_frequency"] == pytest.approx(1.25)
    assert found["phase_offset"] == pytest.approx(0.5)


def test_a_gait_without_strides_has_no_number_for_them(robot):
    found = summarize([made_up(robot, duty=1.0)], robot, DT)
    assert found["periodic_fraction"] == 0.0 and found["strides"] == 0.0
    assert all(found[key] is None for key in OF_STRIDES)
    assert found["cost_of_transport"] > 0
    assert summarize([made_up(robot, steps=300)], robot, DT) == {}  # 6 m


def test_only_periodic_episodes_count(robot):
    walks, slides = made_up(robot), made_up(robot, duty=1.0)
    found = summarize([walks, slides], robot, DT)
    assert found["periodic_fraction"] == 0.5 and found["strides"] == 31
    assert found["duty_factor"] == pytest.approx(0.6)
    mostly = summarize([walks, slides, slides], robot, DT)
    assert mostly["periodic_fraction"] == pytest.approx(1 / 3) and mostly["strides"] == 0
    assert all(mostly[key] is None for key in OF_STRIDES)


# From the simulator.


def swing(state):
    """Return open-loop steps, right and left half a period apart."""
    now = state[:, 0, 0] * 0 + 1
    return torch.stack([now * 0.2] * 6, dim=-1)


def test_episodes_are_recorded_as_long_as_they_last(robot, task):
    env = env_of(task, num_envs=3)
    policy = TensorDictModule(swing, in_keys=["nodes"], out_keys=["action"])
    result = evaluate(policy, env, task, 5, record=True)
    plain = evaluate(policy, env, task, 5)
    for episode, other in zip(result.episodes, plain.episodes, strict=True):
        assert episode.reward == pytest.approx(other.reward) and other.motion is None
        motion = episode.motion
        assert len(motion.angles) == len(motion.sole_speed) == len(motion.work) == len(episode.reward)
        # The first leg's hip, as the nodes have it.
        assert motion.angles[:, 0] == pytest.approx(episode.hips[:, 0], abs=1e-6)
        assert motion.velocity == pytest.approx(np.gradient(episode.position, DT), abs=0.3)
        # Recorded heights agree with contacts, which are those of a physics step before.
        assert np.abs(motion.sole_height[episode.feet_down]).max() < 0.01
        assert (motion.sole_height[~episode.feet_down] > -5e-3).all()
    text = trace(result.typical, robot, DT).splitlines()
    assert len(text) == 1 + len(result.typical.reward)
    with pytest.raises(ValueError, match="record=True"):
        trace(plain.typical, robot, DT)


def test_evaluation_writes_gait_and_trace(finished, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = finished.copy("gctd3", tmp_path / "run")
    assert command("evaluate", f"run={run}", "episodes=2", "threads=1") == 0
    report = json.loads((run / "evaluation.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert report["gait"] == {} and report["reward"]["fall"] == {"term": "Ended", "weight": -10.0, "by": "fall"}
    with (run / "trace.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert rows and float(rows[0]["time_s"]) == DT
    assert {"angle_hip_right_rad", "velocity_ankle_left_rad_s", "down_foot_left", "height_m"} <= set(rows[0])


def test_the_table_says_when_a_gait_is_not_periodic():
    def said(**gait):
        return table({"gait": {"episodes": 2, **gait}, "episodes": 2, "return_mean": 1.0, "return_std": 0.0})

    slides = said(hip_correlation=0.25, floquet_max=None, stride_time=None)
    assert slides.count("not periodic") == 2 and "0.25" in slides
    short = said(periodic_fraction=1.0, stride_time=0.5, floquet_max=None)
    assert "too few strides" in short and "not periodic" not in short


def test_every_line_of_the_table_has_one_quantity_with_its_unit(robot):
    """Made-up feet whose bounces are touchdowns, but no strides: two quantities with two numbers and two names."""
    gait = {**made_up(robot).gait(DT), **summarize([made_up(robot)], robot, DT)}
    shown = table({"gait": {"episodes": 1, **gait}, "episodes": 1, "return_mean": 1.0, "return_std": 0.0})
    names = [line[:34].strip() for line in shown.split("Gait over")[1].splitlines()[1:]]
    assert len(names) == len(set(names)) == len(gait)
    assert {"stride frequency, Hz", "touchdown frequency, Hz", "stride time, s", "asymmetry, hip right, rad"} <= set(
        names
    )
    assert "hz" not in [word for name in names for word in name.split()]
    # Every key is known, so that none is shown without its unit.
    assert all(quantity(key).meaning for key in gait)


def test_quantities_are_different_from_one_another():
    for field in ("key", "name", "meaning"):
        assert len({getattr(known, field) for known in QUANTITIES}) == len(QUANTITIES), field


def test_strides_of_made_up_feet(robot):
    assert len(strides(made_up(robot).feet_down[:, 0], drop=0)) == 22
