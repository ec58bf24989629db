"""The clock of a gait: its phases by hand, its mirror image, and the reward for steps that keep to it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gctd3.errors import ConfigError
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.features import paper_features
from gctd3.tasks.gait_clock import PHASES, GaitClock, GaitSchedule
from gctd3.tasks.reward import Reward
from gctd3.tasks.terms import Step
from gctd3.tasks.velocity_command import VELOCITY
from gctd3.tasks.walk import WalkingTask, WalkSettings

DT = 0.02


@pytest.fixture(scope="module")
def robot():
    return RobotSettings("quadruped").load()


def walking(robot, clock, reward=None):
    return WalkingTask(robot, reward, WalkSettings(features={**paper_features(), "clock": clock}))


def standing(task, robots=2):
    model = task.robot.model
    qpos = np.broadcast_to(task.robot.standing_qpos, (robots, model.nq))
    return task.measure(qpos, np.zeros((robots, model.nv)), np.zeros((robots, model.nsensordata)))


def step(task, phases, down, xp=np):
    """Return a step at whose end the feet have phases and contacts."""
    now = standing(task, len(down))
    given = {name: value for name, value in vars(now).items()}
    given["feet_down"] = np.asarray(down)
    if xp is torch:
        given = {name: torch.from_numpy(np.array(value)) for name, value in given.items()}
        phases = torch.as_tensor(phases)
    nothing = xp.zeros((len(down), task.facts.actions)), xp.zeros(len(down), dtype=xp.bool)
    return Step(replace(now, **given), {}, {PHASES: phases}, *nothing, task.facts, {})


def test_phases_go_round_by_hand(robot):
    """At 2 Hz and 50 control steps a second, a stride takes 25 steps; feet that take turns are half of that apart."""
    task = walking(robot, GaitClock(frequency=2.0))
    now = standing(task)
    memory = task.begin(now)
    start = memory[PHASES].copy()
    for _ in range(5):
        memory, _ = task.advance(memory, now)
    np.testing.assert_allclose(memory[PHASES], (start + 5 / 25) % 1.0, atol=1e-12)
    for _ in range(20):
        memory, _ = task.advance(memory, now)
    turn = np.abs(memory[PHASES] - start)
    np.testing.assert_allclose(np.minimum(turn, 1.0 - turn), 0.0, atol=1e-12)
    assert set(start[0]) == {0.25, 0.75}


def test_the_policy_sees_sine_and_cosine(robot):
    task = walking(robot, GaitClock(frequency=2.0))
    now = standing(task)
    memory = task.begin(now)
    for _ in range(3):
        memory, _ = task.advance(memory, now)
    frame = task.node_features(now, memory)
    for foot, name in enumerate(robot.feet):
        try:
            places = [task.table.place(f"{wave}_{name}") for wave in ("clock_sin", "clock_cos")]
        except KeyError:
            continue
        angle = 2 * np.pi * memory[PHASES][0, foot]
        seen = [frame[(0, *place)] for place in places]
        np.testing.assert_allclose(seen, [np.sin(angle), np.cos(angle)], atol=1e-6)
    names = [reading.name for row in task.table.readings for reading in row if reading]
    assert sum("clock" in name for name in names) == 2 * len(robot.foot_pairs)


@pytest.mark.parametrize("array", [np.asarray, torch.as_tensor], ids=["numpy", "torch"])
def test_observations_tell_the_phase(robot, array):
    task = walking(robot, GaitClock(frequency=2.0))
    now = standing(task)
    memory = task.begin(now)
    for count in range(1, 40):
        memory, _ = task.advance(memory, now)
        frame = task.node_features(now, memory)
        older = np.zeros((*frame.shape[:-1], (task.history - 1) * task.features), dtype=frame.dtype)
        nodes = array(np.concatenate([older, frame], axis=-1))
        off = (np.asarray(task.phase(nodes)) - count / 25 + 0.5) % 1.0 - 0.5
        np.testing.assert_allclose(off, 0.0, atol=1e-6)


def test_in_the_mirror_feet_have_each_others_phases(robot):
    """Half a period later the robot's clock is that of its mirror image."""
    task = walking(robot, GaitClock(frequency=2.0))
    now = standing(task)
    clock = [
        place for name in robot.feet for place in (_place(task, f"clock_sin_{name}"), _place(task, f"clock_cos_{name}"))
    ]
    node, number = np.array([place for place in clock if place is not None]).T
    source, sign = task.table.reflection()
    memory = task.begin(now)
    for count in range(8):
        frame = task.node_features(now, memory)
        mirrored = (sign * frame.reshape(len(frame), -1)[:, source]).reshape(frame.shape)
        later = {**memory, PHASES: (memory[PHASES] + 0.5) % 1.0}
        np.testing.assert_allclose(
            mirrored[:, node, number], task.node_features(now, later)[:, node, number], atol=1e-6, err_msg=str(count)
        )
        np.testing.assert_allclose(later[PHASES], memory[PHASES][:, list(robot.mirror_feet)], atol=1e-12)
        memory, _ = task.advance(memory, now)


def _place(task, name):
    try:
        return task.table.place(name)
    except KeyError:
        return None


@pytest.mark.parametrize("xp", [np, torch], ids=["numpy", "torch"])
def test_feet_out_of_time_cost_by_hand(robot, xp):
    """Two feet swing (phase 0.25) and two stand (0.75): each foot that is elsewhere costs a quarter of the weight."""
    task = walking(robot, GaitClock())
    phases = np.array([[0.25, 0.75, 0.75, 0.25]] * 4)
    down = [
        [False, True, True, False],  # as the clock has it
        [True, True, True, True],  # stands still: two feet
        [True, False, False, True],  # all four
        [False, False, True, False],  # one is up that should stand
    ]
    rewards = GaitSchedule(weight=-2.0)(step(task, phases, down, xp))
    np.testing.assert_allclose(np.asarray(rewards), [0.0, -1.0, -2.0, -0.5])


@pytest.mark.parametrize("xp", [np, torch], ids=["numpy", "torch"])
def test_feet_may_stay_down_while_the_command_is_to_stand(robot, xp):
    """As above; the first robot is to stand, the second to turn: a foot in the air costs both of them."""
    task = walking(robot, GaitClock())
    command = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    for down, expected in (([True] * 4, [0.0, -1.0]), ([False, False, True, False], [-0.5, -0.5])):
        now = step(task, np.array([[0.25, 0.75, 0.75, 0.25]] * 2), [down] * 2, xp)
        commanded = replace(now, before={**now.before, VELOCITY: xp.asarray(command)})
        np.testing.assert_allclose(np.asarray(GaitSchedule(weight=-2.0)(commanded)), expected)


def test_near_a_change_a_foot_may_be_up_or_down(robot):
    task, term = walking(robot, GaitClock()), GaitSchedule(margin=0.08)
    for phase in (0.0, 0.07, 0.43, 0.5, 0.57, 0.93, 0.99):
        for foot_down in (False, True):
            assert term(step(task, np.full((1, 4), phase), [[foot_down] * 4]))[0] == 0.0
    assert term(step(task, np.full((1, 4), 0.1), [[True] * 4]))[0] == -1.0
    assert term(step(task, np.full((1, 4), 0.9), [[False] * 4]))[0] == -1.0


def test_a_reward_without_a_clock_is_refused(robot):
    with pytest.raises(ConfigError, match=r"reward\.terms\.schedule reads 'foot_phases'"):
        WalkingTask(robot, Reward(terms={"schedule": GaitSchedule()}), WalkSettings())


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: GaitClock(frequency=0.0), "frequency must be above 0"),
        (lambda: GaitClock(froude=-1.0), "froude must be above 0"),
        (lambda: GaitSchedule(margin=0.3), "margin must be at least 0 and below 0.25"),
    ],
)
def test_wrong_settings(build, said):
    with pytest.raises(ConfigError, match=said):
        build()
