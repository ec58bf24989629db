"""The warm-up whose feet step: where feet go, how gaits evolve, and that it can be continued."""

import json

import mujoco
import numpy as np
import pytest
import torch
from running import command, tiny
from tensordict import TensorDict

from gctd3.data.foot_paths import foot_height, foot_way
from gctd3.data.gait_policy import OpenLoop
from gctd3.data.stepping import Stepping
from gctd3.data.trials import Trials
from gctd3.envs.simulation import Simulation
from gctd3.robots.gait_pattern import GaitPattern, alternating_phases
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.terminations import Fall
from gctd3.tasks.walk import WalkingTask, WalkSettings, paper_terminations


@pytest.fixture(scope="module")
def quadruped():
    return RobotSettings("quadruped", action_scale=0.5).load()


def stepping(robot, robots=4, trial=0.2):
    torch.manual_seed(0)
    return Stepping(robot, robots, Trials(trial, 0.02))


def foot_places(robot, action):
    """Return the places of the feet in the base's frame (m) where every joint is at its desired angle: by MuJoCo."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    data.qpos[[robot.joint(name).qpos for name in robot.actuated]] = robot.desired_angles(action)
    mujoco.mj_kinematics(robot.model, data)
    return np.array([robot.base.frame @ robot.foot_place(data, foot) for foot in robot.feet])


def test_a_foot_goes_where_the_path_says(quadruped):
    """Small displacements, as asked of the feet, are those that MuJoCo's kinematics give; other feet stay."""
    gaits, still = stepping(quadruped), np.zeros(len(quadruped.actuated))
    home = foot_places(quadruped, still)
    for foot in range(len(quadruped.feet)):
        # Forwards; to lift a foot, straight legs would need endless angles, which the damping holds back.
        asked = np.zeros((1, len(quadruped.feet), 3))
        asked[0, foot, 0] = 0.005
        action = torch.einsum("nfd,fda->na", torch.from_numpy(asked).float(), gaits.joints)[0].numpy()
        moved = foot_places(quadruped, action) - home
        assert moved[foot, 0] == pytest.approx(0.005, rel=0.4)
        others = np.delete(moved, foot, axis=0)
        assert np.abs(others).max() < 1e-9


def test_left_and_right_feet_step_half_a_period_apart(quadruped):
    gaits = stepping(quadruped)
    first, other = 0, quadruped.mirror_feet[0]
    assert other != first
    genes = {name: getattr(gaits, name).clone() for name in gaits.GENES}
    genes["sway"] = torch.zeros_like(genes["sway"])
    now, later = (gaits.act(genes, torch.full((4,), cycles)) for cycles in (0.3, 0.8))
    order, sign = quadruped.action_mirror
    mirrored = torch.from_numpy(sign).float() * later[:, torch.from_numpy(order)]
    torch.testing.assert_close(now, mirrored, rtol=1e-4, atol=1e-4)


def test_the_fitter_gaits_are_remembered_and_inherited(quadruped):
    """Rewards make a gait fit: the memory of each robot holds the mean reward of its best trial."""
    gaits = stepping(quadruped, trial=0.1)
    begins, nothing = torch.ones(4, dtype=torch.bool), torch.zeros(4, dtype=torch.bool)
    gaits(begins, torch.zeros(4))
    tried = gaits.frequency.clone()
    speeds = torch.tensor([0.0, 0.05, 0.1, 0.2])
    # A trial of 0.1 s lasts five control steps.
    for step in range(1, 6):
        gaits(nothing, 0.1 * step * speeds)
    torch.testing.assert_close(gaits.fitness, 0.1 * speeds)
    torch.testing.assert_close(gaits.best_frequency, tried)
    # A second trial, of other gaits, that stands still leaves the memory.
    gaits.again.fill_(False)
    for _ in range(5):
        gaits(nothing, 0.5 * speeds)
    torch.testing.assert_close(gaits.fitness, 0.1 * speeds)
    torch.testing.assert_close(gaits.best_frequency, tried)


def test_luck_does_not_stay(quadruped):
    """A gait that is tried again counts by the mean of both trials, and remains the robot's own."""
    gaits = stepping(quadruped, trial=0.1)
    nothing = torch.zeros(4, dtype=torch.bool)
    gaits.fitness.fill_(0.3)
    gaits.best_frequency.copy_(torch.tensor([1.0, 1.5, 2.0, 2.5]))
    gaits(torch.ones(4, dtype=torch.bool), torch.zeros(4))
    gaits.again.fill_(True)
    for step in range(1, 6):
        gaits(nothing, 0.004 * step * torch.tensor([0.0, 1.0, 2.0, 4.0]))
    # Of 0.3 and a fifth of the last sum of rewards.
    torch.testing.assert_close(gaits.fitness, 0.15 + 0.002 * torch.tensor([0.0, 1.0, 2.0, 4.0]))
    assert gaits.best_frequency.tolist() == [1.0, 1.5, 2.0, 2.5]


def test_in_the_last_round_robots_try_what_they_remember(quadruped):
    torch.manual_seed(0)
    gaits = Stepping(quadruped, 8, Trials(0.04, 0.02, steps=20))
    position = torch.zeros(8)
    begins, nothing = torch.ones(8, dtype=torch.bool), torch.zeros(8, dtype=torch.bool)
    for step in range(20):
        gaits(nothing if step else begins, position)
        position = position + 0.01 * torch.rand(8)
    assert gaits.again.all()
    for name in gaits.GENES:
        torch.testing.assert_close(getattr(gaits, name), getattr(gaits, f"best_{name}"))


def test_the_last_round_is_between_the_fittest(quadruped, monkeypatch):
    """Robots share the fittest few gaits, and one that does well with all its robots wins over one that was lucky."""
    monkeypatch.setattr(Stepping, "FINALISTS", 2)
    torch.manual_seed(0)
    gaits = Stepping(quadruped, 8, Trials(0.04, 0.02, steps=10))
    nothing, returned = torch.zeros(8, dtype=torch.bool), torch.zeros(8)
    gaits(~nothing, returned)
    gaits.fitness.copy_(torch.tensor([0.1, 0.9, 0.2, 0.8, 0.3, 0.0, 0.0, 0.0]))
    strides = gaits.best_stride.clone()
    gaits.taken.fill_(7)
    gaits(nothing, returned)
    assert gaits.best_stride.tolist() == strides[[1, 3] * 4].tolist()
    assert gaits.stride.tolist() == gaits.best_stride.tolist()
    # Of the first one's robots one does well; of the second one's all do.
    for _ in range(6):
        returned = returned + torch.tensor([0.9, 0.8, 0.0, 0.8, 0.0, 0.8, 0.0, 0.8])
        gaits(nothing, returned)
    assert float(gaits.fitness[0]) > float(gaits.fitness[1]) > float(gaits.fitness[2])
    assert gaits._fittest(1)["stride"].tolist() == strides[[3]].tolist()


def test_a_fall_makes_a_gait_less_fit(quadruped):
    gaits = stepping(quadruped, trial=0.1)
    begins, nothing = torch.ones(4, dtype=torch.bool), torch.zeros(4, dtype=torch.bool)
    gaits(begins, torch.zeros(4))
    gaits(nothing, torch.full((4,), 0.05))
    gaits(torch.tensor([True, False, False, False]), torch.zeros(4))
    # Rewards that it got before count as if the others of the trial's five were 0.
    assert gaits.fitness[0] == pytest.approx(0.05 / 5 - 1.0)
    assert not gaits.fitness[1:].isfinite().any()


def test_genes_stay_within_their_bounds(quadruped):
    gaits = stepping(quadruped, robots=32, trial=0.02)
    position = torch.zeros(32)
    gaits(torch.ones(32, dtype=torch.bool), position)
    for _ in range(100):
        position = position + torch.rand(32)
        action = gaits(torch.rand(32) < 0.1, position)
        assert action.abs().max() <= 1.0
    for name, (low, high, _) in gaits.GENES.items():
        values = getattr(gaits, name)
        assert (values >= low).all() and (values <= high).all(), name


def test_it_goes_on_from_its_state(quadruped):
    def play(gaits, steps, seed):
        torch.manual_seed(seed)
        generator = torch.Generator().manual_seed(seed)
        return [
            gaits(torch.rand(4, generator=generator) < 0.1, torch.rand(4, generator=generator)) for _ in range(steps)
        ]

    first = stepping(quadruped)
    play(first, 30, 1)
    second = stepping(quadruped)
    second.load_state_dict(first.state_dict())
    for a, b in zip(play(first, 30, 2), play(second, 30, 2), strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=0.0)


@pytest.mark.nightly
def test_gaits_that_evolve_walk(quadruped):
    """On the quadruped the gaits that robots remember after 10,000 control steps cover more ground than at first."""
    ends = {"long_contact": None, "stuck_hip": None, "fall": Fall(height=None)}
    task = WalkingTask(quadruped, settings=WalkSettings(terminations={**paper_terminations(), **ends}))
    robots = 16
    simulation, gaits = Simulation(task, robots, threads=1), Stepping(quadruped, robots, Trials(2.0, 0.02))
    begins, fittest = torch.ones(robots, dtype=torch.bool), []
    simulation.reset(begins.numpy())
    returned = torch.zeros(robots)
    for step in range(630):
        outcome = simulation.step(gaits(begins, returned).numpy().astype(float))
        returned = returned + torch.from_numpy(outcome.reward).float()
        begins = torch.from_numpy(outcome.terminated | outcome.truncated)
        simulation.reset(begins.numpy())
        returned = torch.where(begins, 0.0, returned)
        if step in (105, 629):
            fittest.append(float(gaits.fitness.median()))
    # What half of the robots remember is fitter than at first, and covers ground; to stand costs 0.1.
    assert fittest[1] > max(fittest[0], 0.05)


def test_the_fittest_gait_can_be_played_without_noise(quadruped):
    """Before a trial there is none; then its actions are those of the gait from the start of an episode."""
    gaits = stepping(quadruped, trial=0.04)
    assert not gaits.tried
    nothing = torch.zeros(4, dtype=torch.bool)
    gaits(torch.ones(4, dtype=torch.bool), torch.zeros(4))
    for step in range(1, 3):
        gaits(nothing, 0.01 * step * torch.tensor([0.0, 1.0, 3.0, 2.0]))
    assert int(gaits.fitness.argmax()) == 2
    played = OpenLoop(gaits.fittest_actions(5))
    genes = {name: getattr(gaits, f"best_{name}")[2:3] for name in gaits.GENES}
    cycle = 0.02 * gaits._unit * float(genes["frequency"])
    for step in range(1, 5):
        action = played(TensorDict({}, [7]))["action"]
        expected = gaits.act(genes, torch.tensor([step * cycle])).clamp(-1.0, 1.0)
        torch.testing.assert_close(action, expected.expand(7, -1), rtol=1e-4, atol=1e-5)


@pytest.mark.nightly
def test_a_training_says_how_far_that_gait_gets(tmp_path, capsys):
    run = tmp_path / "run"
    asked = ["robot=quadruped", "exploration.warmup=stepping", "exploration.gait_time=0.2", "robot.action_scale=0.3"]
    assert command("train", *tiny(run, *asked)) == 0
    assert capsys.readouterr().out.count("The fittest gait of the warm-up: ") == 1
    reached = json.loads((run / "warmup_gait.json").read_text())
    assert reached["episodes"] == 2 and reached["distance_mean"] < 15.1


def clocked(robot, robots=8, trial=0.1):
    torch.manual_seed(0)
    pattern = GaitPattern(2.0, alternating_phases(robot))
    return pattern, Stepping(robot, robots, Trials(trial, 0.02), pattern)


def test_with_a_clock_all_gaits_keep_to_it(quadruped):
    """However the gaits evolve, their frequency and their feet's phases are the clock's."""
    pattern, gaits = clocked(quadruped)
    begins = torch.ones(8, dtype=torch.bool)
    position = torch.zeros(8)
    for _ in range(40):
        gaits(begins, position)
        begins, position = torch.rand(8) < 0.05, position + torch.rand(8)
    pendulum = gaits._unit
    torch.testing.assert_close(gaits.frequency * pendulum, torch.full((8,), 2.0))
    phases = (gaits.phase[:, gaits.pair_of] + gaits.lagging) % 1.0
    torch.testing.assert_close(phases, torch.from_numpy(pattern.phases).float().expand(8, -1))
    assert gaits.stride.std() > 0


def test_feet_are_lifted_while_the_clock_lets_them_swing(quadruped):
    pattern, gaits = clocked(quadruped)
    gaits.lag.zero_()
    genes = {name: getattr(gaits, name) for name in gaits.GENES}
    for cycles in (0.1, 0.3, 0.6, 0.9):
        phases = (cycles + pattern.phases) % 1.0
        flat = genes | {"lift": torch.zeros_like(gaits.lift)}
        lifted, walked = (gaits.act(g, torch.full((8,), cycles)) for g in (genes, flat))
        for foot, leg in enumerate(quadruped.legs):
            columns = [quadruped.actuated.index(joint.name) for joint in leg]
            moved = (lifted - walked)[:, columns].abs().max()
            assert (moved > 1e-3) == (phases[foot] < 0.5), (cycles, foot)


@pytest.mark.parametrize("duty", [0.5, 0.65])
def test_feet_stand_at_the_speed_of_the_ground(duty):
    """On the ground a foot goes back evenly, and the path has no corner where it lifts off or touches down."""
    phase = torch.linspace(0.0, 1.0, 2001, dtype=torch.float64)
    way = foot_way(phase, torch.tensor(duty, dtype=torch.float64))
    height = foot_height(phase, torch.tensor(1.5))
    speed = torch.diff(way) / torch.diff(phase)
    middle = (phase[1:] + phase[:-1]) / 2
    stands = (middle - 0.25).abs() > (1.0 - duty) / 2 + 1e-3
    torch.testing.assert_close(speed[stands], torch.full_like(speed[stands], -2.0 / duty))
    assert torch.diff(speed).abs().max() < 0.05 * speed.max()
    # To the front in the air, from end to end, and up in the first half of the period alone.
    assert way[phase < 0.25].min() < -1.0 < 1.0 < way[(phase > 0.25) & (phase < 0.5)].max()
    assert height.max() == pytest.approx(1.0) and not height[phase > 0.5].any()


def test_feet_go_along_a_line_and_not_an_arc(quadruped):
    """What joint angles in proportion to a foot's way would raise it by is taken back, by MuJoCo's kinematics."""
    gaits, data = stepping(quadruped), mujoco.MjData(quadruped.model)
    address = [quadruped.joint(name).qpos for name in quadruped.actuated]
    for foot, name in enumerate(quadruped.feet):
        heights = []
        for share in (-0.1, 0.0, 0.1):
            way = torch.zeros(1, len(quadruped.feet), 3)
            way[0, foot, 0] = share * quadruped.leg_length
            action = torch.einsum("nfd,fda->na", way, gaits.joints)[0].numpy()
            data.qpos[:] = quadruped.standing_qpos
            data.qpos[address] += quadruped.action_map[1] * action
            mujoco.mj_kinematics(quadruped.model, data)
            heights.append(quadruped.foot_place(data, name)[2])
        # As far as a parabola, measured over three times the way, is that arc.
        rise = (heights[0] + heights[2]) / 2 - heights[1]
        assert float(gaits.arc[foot]) * 0.1**2 * quadruped.leg_length == pytest.approx(rise, rel=0.1)


def test_the_fittest_action_is_that_of_its_time(quadruped):
    """By the phase of a state, however it came about, the same actions as in the list from an episode's start."""
    _, gaits = clocked(quadruped, trial=0.04)
    assert not gaits.tried
    gaits(torch.ones(8, dtype=torch.bool), torch.zeros(8))
    for step in range(1, 4):
        gaits(torch.zeros(8, dtype=torch.bool), 0.01 * step * torch.rand(8))
    assert gaits.tried
    played = OpenLoop(gaits.fittest_actions(30))
    listed = torch.stack([played(TensorDict({}, [1]))["action"][0] for _ in range(30)])
    phases = (torch.arange(30) * 0.02 * 2.0) % 1.0
    torch.testing.assert_close(gaits.fittest_action(phases), listed, rtol=1e-4, atol=1e-4)
