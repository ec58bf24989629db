"""Reflexes of the warm-up's gaits: what they sense, by hand; where feet go for it, by MuJoCo's kinematics."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from gctd3.data.exploration import Explorer
from gctd3.data.foot_paths import foot_places, joint_paths
from gctd3.data.reflexes import GENES, reflexes
from gctd3.data.settings import ExplorationSettings
from gctd3.data.stepping import Stepping
from gctd3.data.trials import Shown, Trials
from gctd3.nn import make_actor
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.features import Sensed
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.velocity import VelocitySettings
from gctd3.tasks.velocity_features import HeadingBase, HeadingForward, velocity_features
from gctd3.tasks.walk import WalkSettings

LEG = """
<body name="hip_{side}" pos="0 {y} 0"><joint name="roll_{side}" axis="1 0 0"/>
  <geom type="sphere" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
  <body name="thigh_{side}"><joint name="yaw_{side}" axis="0 0 1"/><joint name="pitch_{side}" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.05 0 -0.2" size="0.03" mass="1"/>
    <body name="shank_{side}" pos="0.05 0 -0.2"><joint name="knee_{side}" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 -0.05 0 -0.2" size="0.025" mass="0.5"/>
      <body name="sole_{side}" pos="-0.05 0 -0.2"><joint name="tip_{side}" axis="0 1 0"/>
        <joint name="edge_{side}" axis="1 0 0"/>
        <geom name="sole_{side}" type="box" pos="0.02 0 -0.03" size="0.08 0.04 0.01" mass="0.3"/>
      </body></body></body></body>"""
JOINTS = ("roll", "yaw", "pitch", "knee", "tip", "edge")
HUMANOID = """
<mujoco><compiler autolimits="true" angle="radian"/><default><joint range="-1 1"/></default>
<worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="trunk" pos="0 0 0.44"><freejoint name="root"/><geom type="box" size="0.06 0.1 0.1" pos="0 0 0.1" mass="4"/>
{legs}</body></worldbody><actuator>{servos}</actuator></mujoco>"""


@pytest.fixture(scope="module")
def humanoid(tmp_path_factory):
    """Read a robot on two legs of six joints each, as a person might write it."""
    names = [f"{joint}_{side}" for side in ("left", "right") for joint in JOINTS]
    legs = "".join(LEG.format(side=side, y=y) for side, y in (("left", 0.08), ("right", -0.08)))
    servos = "".join(f'<position joint="{n}" kp="60" kv="2" ctrlrange="-1 1" forcerange="-40 40"/>' for n in names)
    path = tmp_path_factory.mktemp("humanoid") / "humanoid.xml"
    path.write_text(HUMANOID.format(legs=legs, servos=servos))
    return RobotSettings(str(path), action_scale=0.5).load()


def task_of(settings, name="quadruped"):
    still = {"joint_noise": JointNoise(0.0, 0.0)}
    return replace(settings, randomisations=still).build(RobotSettings(name, action_scale=0.5))


def observed(task, pitch=0.0, roll=0.0, rates=(0.0, 0.0), speed=0.0, drift=0.0):
    """Return the observation of a standing robot that is tilted and moves, the same frame in all of its history."""
    data = mujoco.MjData(task.robot.model)
    data.qpos[:] = task.robot.standing_qpos
    for axis, angle in (((0.0, 1.0, 0.0), pitch), ((1.0, 0.0, 0.0), roll)):
        turn, before = np.zeros(4), data.qpos[3:7].copy()
        mujoco.mju_axisAngle2Quat(turn, np.array(axis), angle)
        mujoco.mju_mulQuat(data.qpos[3:7], turn, before)
    data.qvel[:2] = speed, drift
    data.qvel[3:5] = rates[1], rates[0]
    mujoco.mj_forward(task.robot.model, data)
    now = task.measure(data.qpos, data.qvel, data.sensordata)
    memory = task.begin(now, np.random.default_rng(0))
    frame = torch.from_numpy(task.table(Sensed(now, memory, task.facts))).float()
    return frame.repeat(1, task.history)


KNOWN = VelocitySettings(features={**velocity_features(), "forward": HeadingForward(), "side": HeadingBase()})


@pytest.mark.parametrize(
    "settings, angle", [(WalkSettings(), lambda x: x), (VelocitySettings(), math.sin), (KNOWN, math.sin)]
)
def test_what_is_sensed(settings, angle):
    """Nose down, right side down, forward and to the left are positive, whatever the task observes of it."""
    task = task_of(settings)
    length = task.robot.leg_length
    rate, velocity = math.sqrt(9.81 / length), math.sqrt(9.81 * length)
    nose = task.posture(observed(task, pitch=0.2, rates=(0.5, 0.0), speed=0.7)).tolist()
    side = task.posture(observed(task, roll=0.1, rates=(0.0, -0.4), drift=0.3)).tolist()
    seen = task.posture.observed
    blind = settings == VelocitySettings()
    assert seen == ((True, True, False, True, True, False) if blind else (True,) * 6)
    for got, expected in (
        (nose, [angle(0.2), 0.5 / rate, 0.7 / velocity, 0.0, 0.0, 0.0]),
        (side, [0.0, 0.0, 0.0, angle(0.1), -0.4 / rate, 0.3 / velocity]),
    ):
        shown = [one if s else math.nan for one, s in zip(expected, seen, strict=True)]
        assert got == pytest.approx(shown, abs=1e-5, nan_ok=True)


def test_on_a_boom_there_is_but_a_speed():
    task = WalkSettings().build(RobotSettings("biped"))
    assert task.posture.observed == (False, False, True, False, False, False)


@pytest.mark.parametrize(
    "gene, sense, expected",
    [
        # Of two feet the first one, on the left, is in the air.
        ("stance_pitch", 0, [[0, 0, 0, 0, 0], [0.06, 0, 0, 0, 0]]),
        ("swing_speed", 2, [[0.06, 0, 0, 0, 0], [0, 0, 0, 0, 0]]),
        ("swing_drift", 5, [[0, 0.06, 0, 0, 0], [0, 0, 0, 0, 0]]),
        ("stance_roll_rate", 4, [[0, 0, 0, 0, 0], [0, 0.06, 0, 0, 0]]),
        ("sole_pitch_rate", 1, [[0, 0, 0, 0, 0], [0, 0, 0, 0.06, 0]]),
        ("sole_roll", 3, [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0.06]]),
        ("level_roll", 3, [[0, 0, 0.06, 0, 0], [0, 0, -0.06, 0, 0]]),
    ],
)
def test_each_gain_moves_what_it_says(gene, sense, expected):
    genes = {name: torch.zeros(1) for name in GENES} | {gene: torch.tensor([0.3])}
    posture = torch.zeros(1, 6)
    posture[0, sense] = 0.2
    moved = reflexes(genes, posture, torch.tensor([[1.0, 0.0]]), torch.tensor([1.0, -1.0]))[0]
    torch.testing.assert_close(moved, torch.tensor(expected, dtype=torch.float32))


def soles(robot, action):
    """Return place (m) and rotation of each sole where every joint is at its desired angle: by MuJoCo."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    data.qpos[[robot.joint(name).qpos for name in robot.actuated]] = robot.desired_angles(action)
    mujoco.mj_kinematics(robot.model, data)
    return [(robot.foot_place(data, foot), data.body(foot).xmat.reshape(3, 3).copy()) for foot in robot.feet]


def test_soles_stay_level_and_turn_where_they_are(humanoid):
    paths = joint_paths(humanoid, 0.001, soles=True)
    home = soles(humanoid, np.zeros(12))
    for foot in range(2):
        for row, asked in enumerate([0.01, 0.01, 0.01, 0.05, 0.05]):
            place, turned = soles(humanoid, asked * paths[foot, row].numpy())[foot]
            moved, turn = place - home[foot][0], turned @ home[foot][1].T
            angles = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0]]) / 2
            assert moved == pytest.approx(asked * np.eye(5)[row, :3], abs=6e-4), row
            # About the axes forward and to the left.
            assert angles == pytest.approx(asked * np.eye(5)[row, [4, 3]], abs=2e-3), row
    assert foot_places(humanoid).numpy() == pytest.approx(np.array([[0.0, 0.08], [0.0, -0.08]]), abs=1e-6)


def test_legs_with_few_joints_turn_no_sole():
    quadruped = RobotSettings("quadruped", action_scale=0.5).load()
    paths = joint_paths(quadruped, 0.03, soles=True)
    assert not paths[:, 3:].any()
    torch.testing.assert_close(paths[:, :3], joint_paths(quadruped, 0.03), rtol=0, atol=0)


def balanced(robot, robots=4):
    task = WalkSettings().build(RobotSettings(str(robot.path), action_scale=0.5))
    torch.manual_seed(0)
    return task, Stepping(robot, robots, Trials(0.2, 0.02), balances=True)


def test_a_mirrored_posture_gets_the_mirrored_answer(humanoid):
    task, gaits = balanced(humanoid)
    genes = {name: getattr(gaits, name) for name in gaits.genes} | {"sway": torch.zeros(4)}
    assert all(name in genes for name in GENES)
    for name, (low, high, _) in GENES.items():
        genes[name] = low + (high - low) * torch.rand(4)
    seen = torch.randn(4, len(task.graph.nodes), task.features * task.history)
    mirror = task.reflection().nodes(seen.shape[-1])
    reflected = torch.from_numpy(mirror.sign).float() * seen.flatten(1)[:, torch.from_numpy(mirror.source)]
    now = gaits.act(genes, torch.full((4,), 0.3), Shown(posture=task.posture(seen)))
    later = gaits.act(genes, torch.full((4,), 0.8), Shown(posture=task.posture(reflected.reshape(seen.shape))))
    order, sign = humanoid.action_mirror
    mirrored = torch.from_numpy(sign).float() * later[:, torch.from_numpy(order)]
    torch.testing.assert_close(now, mirrored, rtol=1e-3, atol=1e-3)
    with pytest.raises(ValueError, match="need the body's posture"):
        gaits.act(genes, torch.zeros(4))


def test_in_the_steady_gait_speed_moves_nothing(humanoid):
    """The speed at which feet push the ground back is the one that is expected."""
    _, gaits = balanced(humanoid)
    genes = {name: getattr(gaits, name) for name in gaits.genes}
    posture = torch.zeros(4, 6)
    # Of a foot: twice the stride in a share of the period, in leg lengths and times of a pendulum.
    hertz = genes["frequency"] * gaits._unit
    posture[:, 2] = 2 * genes["stride"] * hertz / genes["duty"] * math.sqrt(humanoid.leg_length / 9.81)
    calm = genes | {name: torch.zeros(4) for name in GENES}
    phase = torch.full((4,), 0.3)
    alike, faster = (Shown(posture=seen) for seen in (posture, posture + 0.1 * torch.eye(6)[2]))
    torch.testing.assert_close(gaits.act(genes, phase, alike), gaits.act(calm, phase, alike))
    assert not torch.allclose(gaits.act(genes, phase, faster), gaits.act(calm, phase, faster), atol=1e-3)


def test_gaits_with_reflexes_are_tried_for_longer():
    settings = ExplorationSettings(warmup="stepping")
    assert (settings.answers, settings.trial) == (True, 4.0)
    without = ExplorationSettings(warmup="stepping", reflexes=False)
    assert (without.answers, without.trial) == (False, 2.0)
    assert ExplorationSettings(warmup="stepping", reflexes=None).answers
    # Only feet that step have them.
    assert not ExplorationSettings(warmup="swinging").answers
    assert ExplorationSettings(warmup="stepping", gait_time=1.0).trial == 1.0


@pytest.mark.parametrize("reflexes", [True, False])
def test_the_explorer_hands_them_what_they_sense(humanoid, reflexes):
    task = WalkSettings().build(RobotSettings(str(humanoid.path), action_scale=0.5))
    settings = ExplorationSettings(warmup="stepping", reflexes=reflexes, learning_starts=400)
    explorer = Explorer(make_actor(task.graph), humanoid, 4, settings, gait=task.gait, posture=task.posture)
    assert explorer.rhythm.balances == reflexes
    assert "nodes" in explorer.in_keys
    seen = {
        "nodes": torch.zeros(4, len(task.graph.nodes), task.features * task.history),
        "is_init": torch.ones(4, 1, dtype=torch.bool),
        "episode_reward": torch.zeros(4, 1),
    }
    torch.manual_seed(0)
    upright = explorer(TensorDict(seen, [4]))["action"].clone()
    explorer.rhythm.age.fill_(3)
    assert upright.shape == (4, 12)
    tilted = seen | {"nodes": torch.full_like(seen["nodes"], 0.3), "is_init": torch.zeros(4, 1, dtype=torch.bool)}
    state = {key: value.clone() for key, value in explorer.state_dict().items()}
    actions = []
    for nodes in (seen["nodes"], tilted["nodes"]):
        explorer.load_state_dict(state)
        torch.manual_seed(1)
        actions.append(explorer(TensorDict(tilted | {"nodes": nodes}, [4]))["action"].clone())
    assert torch.equal(*actions) != reflexes
