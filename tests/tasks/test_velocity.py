"""The task of following a commanded velocity: what is measured, paid, drawn, remembered and mirrored."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from gaits import sense

from gctd3.data.mirror_augmentation import MirrorAugmentation
from gctd3.envs.dmc import load
from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.features import Sensed
from gctd3.tasks.heading import gravity, heading_velocity, yaw_rate
from gctd3.tasks.memory import target_of
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.reward import Reward
from gctd3.tasks.terms import Step
from gctd3.tasks.velocity import VelocitySettings, velocity_terms
from gctd3.tasks.velocity_command import (
    SWAY,
    TRAVELLED,
    VELOCITY,
    WIDTH,
    HeldCommand,
    VelocityCommand,
    averaged,
    velocities,
)
from gctd3.tasks.velocity_features import velocity_features
from gctd3.tasks.velocity_terms import StandStill, TrackVelocity, TrackYawRate

STILL = {"joint_noise": JointNoise(0.0, 0.0)}


def task_of(robot="quadruped", **settings):
    return VelocitySettings(**settings).build(RobotSettings(robot))


@pytest.fixture(scope="module")
def quadruped():
    return task_of()


def everyone(simulation):
    simulation.reset(np.ones(simulation.num_robots, dtype=bool))
    return simulation


# Measuring.


def test_motion_of_the_body_is_as_the_simulator_says(quadruped):
    """Velocity, rates and gravity in the body's frame, from MuJoCo's own rotation matrices, for any orientation."""
    model, rng = quadruped.robot.model, np.random.default_rng(0)
    data, root = mujoco.MjData(model), quadruped.robot.base.root
    forward, _, up = quadruped.robot.base.frame
    # The body's own axes that point forward, left and up when it stands.
    data.qpos[:] = quadruped.robot.standing_qpos
    mujoco.mj_forward(model, data)
    still = data.xmat[root].reshape(3, 3).copy()
    for _ in range(50):
        data.qpos[:] = quadruped.robot.standing_qpos
        data.qpos[3:7] = rng.normal(size=4)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        data.qvel[:6] = rng.normal(size=6)
        mujoco.mj_forward(model, data)
        now = quadruped.measure(data.qpos.copy(), data.qvel.copy(), data.sensordata.copy())
        body = data.xmat[root].reshape(3, 3) @ still.T  # from the axes of the world to those of the turned body
        axes = {
            name: body @ axis for name, axis in zip(("forward", "side", "up"), quadruped.robot.base.frame, strict=True)
        }
        for name, value in gravity(now, quadruped.facts).items():
            assert value == pytest.approx(axes[name] @ [0.0, 0.0, -1.0], abs=1e-9)
        heading = axes["forward"] - (axes["forward"] @ up) * up
        heading /= np.linalg.norm(heading)
        left = np.cross(up, heading)
        found = heading_velocity(now, quadruped.facts)
        np.testing.assert_allclose(found, [heading @ data.qvel[:3], left @ data.qvel[:3]], atol=1e-9)
        spin = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, root, spin, 0)
        assert yaw_rate(now, quadruped.facts) == pytest.approx(axes["up"] @ spin[:3], abs=1e-9)
    assert forward.tolist() == [1.0, 0.0, 0.0]


def test_features_stand_at_the_nodes_to_which_they_belong(quadruped):
    names = dict(zip(quadruped.graph.nodes, quadruped.table.readings, strict=True))

    def read(node):
        return [one.name for one in names[node] if one is not None]

    root = quadruped.graph.nodes[0]
    assert read(root) == ["gravity_up", "command_forward_m_s"]
    assert read(f"{root}_pitch") == ["gravity_forward", "pitch_rate_rad_s"]
    assert read(f"{root}_roll") == ["gravity_side", "roll_rate_rad_s"]
    assert read(f"{root}_yaw") == ["yaw_rate_rad_s", "command_turn_rad_s"]
    assert read(f"{root}_side") == ["command_side_m_s"]
    joint = quadruped.robot.joints[0].name
    assert read(joint) == [f"angle_{joint}_rad", f"velocity_{joint}_rad_s", f"action_{joint}"]
    ranges = {"command_forward_m_s": (-0.5, 1.0), "command_side_m_s": (-0.4, 0.4), "command_turn_rad_s": (-0.8, 0.8)}
    assert quadruped.command_ranges() == ranges
    assert quadruped.privileged is not None and quadruped.num_counters == 6


def test_what_is_observed(quadruped):
    """Put distinct numbers into the command, the last action and the pose, and find them at their nodes."""
    simulation = everyone(Simulation(quadruped, 1, threads=1))
    memory = {**simulation.memory, VELOCITY: np.array([[0.7, -0.2, 0.4]])}
    memory["last_action"] = np.arange(1.0, 1.0 + quadruped.facts.actions)[None]
    nodes, names = quadruped.node_features(simulation.now, memory)[0], quadruped.graph.nodes
    root = names[0]
    assert nodes[0, 1] == pytest.approx(0.7) and nodes[0, 0] == pytest.approx(-1.0)
    assert nodes[names.index(f"{root}_side"), 2] == pytest.approx(-0.2)
    assert nodes[names.index(f"{root}_yaw"), 2] == pytest.approx(0.4)
    for i, joint in enumerate(quadruped.robot.actuated):
        assert nodes[names.index(joint), 2] == i + 1
    angles = dict(
        zip([j.name for j in quadruped.robot.joints], simulation.now.angles[0] - quadruped.facts.home, strict=True)
    )
    for joint, angle in angles.items():
        assert nodes[names.index(joint), 0] == pytest.approx(angle)
    counters = quadruped.counters(memory, simulation.now)[0]
    seen = simulation.now
    # Height, forward and side at the nodes root, yaw, side, with the averages, which begin as what is measured.
    expected = [seen.height[0], seen.velocity[0], seen.velocity[0], 0.0, 0.0, 0.0]
    np.testing.assert_allclose(counters, expected, atol=1e-6)
    # What gaits read of it, from the newest of the stacked frames.
    stacked = np.concatenate([np.zeros_like(nodes), nodes], axis=-1)
    older = task_of(history=2)
    np.testing.assert_allclose(older.shown_command(torch.from_numpy(stacked)), [0.7, -0.2, 0.4])
    moving = {**memory, averaged(SWAY).name: np.array([[0.6, -0.1, 0.3]])}
    averages = quadruped.shown_velocity(torch.from_numpy(quadruped.counters(moving, simulation.now)))
    np.testing.assert_allclose(averages, [[0.6, -0.1, 0.3]], atol=1e-6)
    with pytest.raises(ValueError, match="counters needs the measurement"):
        quadruped.counters(memory)


def test_gaits_read_a_command_where_it_is_observed():
    """A robot on a boom is commanded forward only; without the feature, or for critics' eyes only, there is none."""
    boom = task_of("biped")
    simulation = everyone(Simulation(boom, 2, threads=1))
    memory = {**simulation.memory, VELOCITY: np.array([[0.7, 0.0, 0.0], [-0.2, 0.0, 0.0]])}
    stacked = np.tile(boom.node_features(simulation.now, memory), boom.history)
    np.testing.assert_allclose(boom.shown_command(stacked), [[0.7, 0.0, 0.0], [-0.2, 0.0, 0.0]])
    assert boom.shown_velocity(boom.counters(memory, simulation.now)).shape == (2, 3)
    hidden = task_of(features={**velocity_features(), "command_base": None})
    assert hidden.shown_command is None and hidden.shown_velocity is not None
    assert task_of(privileged={}).shown_velocity is None


def test_a_robot_on_a_boom_is_asked_for_what_it_can_do():
    task = task_of("biped")
    command = task.commands["velocity"]
    assert command.box.tolist() == [[-0.5, 1.0], [0.0, 0.0], [0.0, 0.0]]
    assert "track" in task.terms and "track_turn" not in task.terms
    assert task.command_ranges() == {"command_forward_m_s": (-0.5, 1.0)}
    names = [one.name for row in task.table.readings for one in row if one is not None]
    assert "command_forward_m_s" in names and "command_turn_rad_s" not in names


# The reward.


def step_of(facts, command, velocity=0.0, side=0.0, turn=0.0, joints=None):
    base = np.zeros((len(facts.base), 2))
    base[facts.base.index("side"), 1], base[facts.base.index("yaw"), 1] = side, turn
    speeds = np.zeros(facts.joints) if joints is None else joints
    now = replace(sense(v=velocity), base=base, velocities=speeds, angles=np.zeros(facts.joints))
    after = {averaged(SWAY).name: np.array([velocity, side, turn])}
    return Step(now, {VELOCITY: np.array(command)}, after, np.zeros(facts.actions), np.array(False), facts, {})


@pytest.mark.parametrize(
    ("command", "moved", "linear"),
    [
        # 0.8 - |v - c|; 3-4-5 triangles.
        ((0.6, 0.0, 0.0), (0.6, 0.0), 0.8),
        ((0.6, 0.0, 0.0), (0.0, 0.0), 0.2),
        ((0.6, 0.0, 0.0), (1.2, 0.0), 0.2),
        ((0.6, 0.0, 0.0), (-0.6, 0.0), -0.4),
        ((0.3, 0.4, 0.0), (0.3, 0.4), 0.8),
        ((0.3, 0.4, 0.0), (0.0, 0.0), 0.3),
        ((0.0, 0.0, 0.0), (0.3, -0.4), 0.3),
    ],
)
def test_pay_of_velocity(quadruped, command, moved, linear):
    step = step_of(quadruped.facts, command, *moved)
    assert TrackVelocity(weight=2.0, within=0.8)(step) == pytest.approx(2.0 * linear)
    error = np.hypot(moved[0] - command[0], moved[1] - command[1])
    assert TrackVelocity(weight=2.0, scale=0.5)(step) == pytest.approx(2.0 * np.exp(-4.0 * error**2))


def test_pay_of_yaw_rate_and_of_standing(quadruped):
    facts = quadruped.facts
    assert TrackYawRate(weight=2.0, within=0.9)(step_of(facts, (0.0, 0.0, -0.5), turn=-0.2)) == pytest.approx(1.2)
    assert TrackYawRate(weight=1.0, scale=0.3)(step_of(facts, (0.0, 0.0, 0.5), turn=0.2)) == pytest.approx(np.exp(-1))
    speeds = np.zeros(facts.joints)
    speeds[0] = -2.0
    moving = step_of(facts, (0.0, 0.0, 0.1), joints=speeds)
    assert StandStill(weight=-0.5)(moving) == 0.0
    assert StandStill(weight=-0.5)(step_of(facts, (0.0,) * 3, joints=speeds)) == pytest.approx(-1.0 / facts.joints)


def test_velocities_are_averaged(quadruped):
    """From 0, under a constant velocity v, a filter with time constant T shows v (1 - exp(-t / T))."""
    facts, one = quadruped.facts, averaged(0.5)
    moving = step_of(facts, (0.0,) * 3, velocity=0.8, side=-0.2, turn=0.4)
    value = np.zeros(3)
    for _ in range(25):
        value = one.update(value, moving)
    np.testing.assert_allclose(value, np.array([0.8, -0.2, 0.4]) * (1 - np.exp(-1.0)))
    np.testing.assert_allclose(one.begin(moving.now, facts), [0.8, -0.2, 0.4])
    np.testing.assert_allclose(averaged(0.0).update(value, moving), velocities(moving.now, facts))


# The command.


def test_commands_lie_in_the_box_and_some_stand():
    command = VelocityCommand(forward=(-0.3, 0.9), side=(0.1, 0.2), turn=(-1.0, -0.5), standing=0.25, begin=None)
    drawn = command(np.random.default_rng(0), 4000)
    stands = (drawn == 0.0).all(axis=-1)
    assert stands.mean() == pytest.approx(0.25, abs=0.03)
    moving = drawn[~stands]
    assert (moving >= command.box[:, 0]).all() and (moving <= command.box[:, 1]).all()
    # Every corner of the box is reached: a uniform sample's extremes lie near its ends.
    np.testing.assert_allclose([moving.min(axis=0), moving.max(axis=0)], command.box.T, atol=0.02)


def test_some_commands_are_at_the_ends_of_the_box():
    """Each number is the lowest, 0 or the highest equally often, or drawn from between."""
    command = VelocityCommand(forward=(-0.5, 1.0), side=(-0.4, 0.4), turn=(0.2, 0.8), standing=0.0, extreme=0.3)
    drawn = command(np.random.default_rng(0), 6000)
    # No turn is as slow as 0.
    ends = np.array([[-0.5, 0.0, 1.0], [-0.4, 0.0, 0.4], [0.2, 0.2, 0.8]])
    at = (drawn[:, :, None] == ends).any(axis=-1)
    assert (at.all(axis=-1) == at.any(axis=-1)).all()
    assert at.all(axis=-1).mean() == pytest.approx(0.3, abs=0.02)
    for axis, values in enumerate(ends):
        for value in set(values):
            share = (values == value).mean()
            assert (drawn[:, axis] == value).mean() == pytest.approx(0.3 * share, abs=0.02)


def test_a_robot_is_told_by_how_much_a_second_it_is_to_speed_up(quadruped):
    """From standing to the drawn command by 0.5 m/s^2 forward, 10 to the side and 1 rad/s^2, then to the next one."""
    command = VelocityCommand(every=0.5, standing=0.0, extreme=0.0, acceleration=(0.5, 10.0, 1.0))
    simulation = everyone(Simulation(quadruped.with_commands({"velocity": command}), 3, threads=1))
    most, told, targets = np.array([0.01, 0.2, 0.02]), np.zeros((3, 3)), []
    np.testing.assert_array_equal(simulation.memory[VELOCITY], told)
    for _ in range(60):
        simulation.step(np.zeros((3, quadruped.facts.actions)))
        targets.append(simulation.memory[target_of(VELOCITY)])
        told = told + np.clip(targets[-1] - told, -most, most)
        np.testing.assert_allclose(simulation.memory[VELOCITY], told, atol=1e-12)
    assert len({tuple(target[0]) for target in targets}) == 3
    # To the side it gets there, to the digit.
    np.testing.assert_array_equal(simulation.memory[VELOCITY][:, 1], targets[-1][:, 1])
    jumping = quadruped.with_commands({"velocity": replace(command, acceleration=None)})
    memory = everyone(Simulation(jumping, 3, threads=1)).memory
    assert memory[VELOCITY].all() and target_of(VELOCITY) not in memory


@pytest.mark.parametrize("standing", [0.0, 0.1])
def test_an_episode_begins_with_standing_or_what_is_next_to_it(standing):
    command = VelocityCommand(forward=(0.3, 1.5), side=(-0.4, -0.1), turn=(-1.0, 1.0), standing=standing)
    assert command.still.tolist() == ([0.0, 0.0, 0.0] if standing else [0.3, -0.1, 0.0])
    held = HeldCommand(rows=((1.0, -0.2, 0.5),), like=command)
    np.testing.assert_array_equal(held.still, command.still)
    np.testing.assert_array_equal(held.slew_rates, [2.0, 2.0, 4.0])
    assert HeldCommand().slew_rates is None


@pytest.mark.parametrize("wrong", [(1.0, 2.0), (1.0, 0.0, 4.0), (2.0, 2.0, float("inf")), (2.0, 2.0, float("nan"))])
def test_an_acceleration_that_is_none_is_refused(wrong):
    with pytest.raises(ConfigError, match="acceleration must be three numbers above 0, or null, got"):
        VelocityCommand(acceleration=wrong)


def test_the_box_widens_from_straight_ahead_to_the_whole():
    command = VelocityCommand(forward=(-1.0, 1.0), side=(-0.4, 0.4), turn=(-0.8, 0.8), begin=(0.5, 1.0), standing=0.0)
    rng = np.random.default_rng(0)
    for width, low, high in ((0.0, [0.5, 0, 0], [1, 0, 0]), (0.5, [-0.25, -0.2, -0.4], [1, 0.2, 0.4])):
        drawn = command.draw(rng, 4000, {WIDTH: np.full(4000, width)})
        np.testing.assert_allclose([drawn.min(axis=0), drawn.max(axis=0)], [low, high], atol=0.01)
    np.testing.assert_array_equal(command.evaluated().box, command.box)
    assert command.evaluated().remembers() == ()


def curriculum(command, velocities):
    """Return each robot's share of the box after one command under constant velocities ``[robots, 3]``."""
    facts = SimpleNamespace(control_dt=0.02, base=("yaw", "side"))
    arrays = {one.name: one for one in command.remembers()}
    count, steps = len(velocities), 5
    base = np.zeros((count, 2, 2))
    base[:, 0, 1], base[:, 1, 1] = velocities[:, 2], velocities[:, 1]
    now = replace(sense(v=velocities[:, 0]), base=base, position=velocities[:, 0])
    memory = {TRAVELLED: np.full((count, 3), 99.0), WIDTH: np.full(count, 0.5)}
    memory[VELOCITY] = np.tile([0.6, 0.0, 0.3], (count, 1))
    for left in range(steps, 0, -1):
        memory[f"{VELOCITY}.left"] = np.full(count, left)
        step = Step(now, memory, {}, None, None, facts, {})
        memory = {**memory, **{name: one.update(memory[name], step) for name, one in arrays.items()}}
        if left > 1:
            np.testing.assert_array_equal(memory[WIDTH], 0.5)
        np.testing.assert_allclose(memory[TRAVELLED], (velocities - [0.6, 0.0, 0.3]) * (steps + 1 - left), atol=1e-12)
    return memory[WIDTH]


def test_a_robot_that_follows_gets_a_wider_box():
    command = VelocityCommand(every=0.1, begin=(0.4, 1.0), widen=0.2, error=0.25, turn_error=0.3)
    moved = np.array(
        [
            [0.6, 0.0, 0.3],  # exactly
            [0.45, 0.19, 0.55],  # off by 0.242 m/s and 0.25 rad/s
            [0.40, 0.19, 0.3],  # off by 0.276 m/s
            [0.6, 0.0, -0.1],  # off by 0.4 rad/s
        ]
    )
    np.testing.assert_allclose(curriculum(command, moved), [0.7, 0.7, 0.4, 0.4])
    np.testing.assert_allclose(curriculum(replace(command, widen=1.0), moved), [1.0, 1.0, 0.0, 0.0])


def test_the_width_of_the_box_outlasts_an_episode(quadruped):
    task = quadruped.with_commands({"velocity": VelocityCommand(begin=(0.4, 1.0))})
    simulation = everyone(Simulation(task, 3, threads=1))
    assert simulation.memory[WIDTH].tolist() == [0.0, 0.0, 0.0]
    simulation.memory = {**simulation.memory, WIDTH: np.array([0.2, 0.4, 1.0])}
    simulation.reset(np.array([True, False, True]))
    assert simulation.memory[WIDTH].tolist() == [0.2, 0.4, 1.0]
    assert simulation.memory["step"].tolist() == [0, 0, 0]
    evaluated = task.evaluated(task.reward)
    assert WIDTH not in everyone(Simulation(evaluated, 1, threads=1)).memory


def test_a_task_goes_on_exactly_as_it_was(quadruped):
    """Restored in the middle of an episode, a simulation draws the same commands and pays the same."""
    command = VelocityCommand(every=0.1)
    task = quadruped.with_commands({"velocity": command})
    one, other = (everyone(Simulation(task, 3, seed=s, threads=1)) for s in (1, 2))
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.2, 0.2, (20, 3, quadruped.facts.actions))
    for action in actions[:7]:
        one.step(action)
    other.load_state_dict(one.state_dict())
    changed = 0
    for action in actions[7:]:
        before = one.memory[VELOCITY]
        first, second = one.step(action), other.step(action)
        np.testing.assert_array_equal(first.reward, second.reward)
        changed += int((one.memory[VELOCITY] != before).any())
        for name, values in one.memory.items():
            np.testing.assert_array_equal(values, other.memory[name])
    assert changed >= 2


# The mirror, and the backends.


@pytest.mark.parametrize("robot", ["quadruped", "biped_planar"])
def test_a_reflected_robot_is_paid_the_same(robot):
    """Reflect state, command and action, then step; or step, then reflect: the same observation and the same reward."""
    task = task_of(robot, randomisations=STILL)
    rows = np.array([[0.4, 0.3, 0.5], [0.4, -0.3, -0.5]])
    held = HeldCommand(rows=tuple(map(tuple, rows)))
    task = task.with_commands({"velocity": held})
    mirror, pair = MirrorAugmentation(task.reflection(), history=1), everyone(Simulation(task, 2, threads=1))
    torch.manual_seed(0)
    moved, turned = 0.0, 0.0
    for _ in range(15):
        action = 0.4 * torch.rand(task.facts.actions) - 0.2
        outcome = pair.step(torch.stack([action, mirror.reflect("action", action)]).numpy().astype(float))
        nodes = torch.from_numpy(task.node_features(pair.now, pair.memory))
        counters = torch.from_numpy(task.counters(pair.memory, pair.now))
        torch.testing.assert_close(mirror.reflect("nodes", nodes[0]), nodes[1], atol=1e-3, rtol=1e-3)
        torch.testing.assert_close(mirror.reflect("counters", counters[0]), counters[1], atol=1e-3, rtol=1e-3)
        for name, paid in outcome.terms.items():
            assert paid[0] == pytest.approx(paid[1], abs=2e-3), name
        moved = max(moved, float((nodes[0] - nodes[1]).abs().max()))
        turned = max(turned, float(np.abs(yaw_rate(pair.now, task.facts)).max()))
    assert moved > 0.05 and (turned > 0.01) == (robot == "quadruped")


def test_both_backends_agree(quadruped):
    task = quadruped.with_commands({"velocity": HeldCommand(rows=((0.5, -0.2, 0.3),))})
    simulation, env = everyone(Simulation(task, 1, threads=1)), load(task)
    env.reset()
    nq, nv = task.robot.model.nq, task.robot.model.nv
    with env.physics.reset_context():
        env.physics.data.qpos[:] = simulation.qpos[0]
        env.physics.data.qvel[:] = simulation.state[0, 1 + nq : 1 + nq + nv]
    env.task.restart(env.physics)
    rng = np.random.default_rng(0)
    for _ in range(10):
        action = rng.uniform(-0.3, 0.3, task.facts.actions)
        outcome, step = simulation.step(action[None]), env.step(action)
        nodes = task.node_features(simulation.now, simulation.memory)[0]
        np.testing.assert_allclose(step.observation["nodes"], nodes, atol=1e-5)
        counters = task.counters(simulation.memory, simulation.now)[0]
        np.testing.assert_allclose(step.observation["counters"], counters, atol=1e-5)
        assert step.reward == pytest.approx(float(outcome.reward[0]), abs=1e-5)


def test_features_are_checked_by_their_own_key(quadruped):
    table = quadruped.privileged
    source, sign = table.flat_reflection()
    # Height and forward velocities stay, turning and velocities to the side change their signs.
    assert source.tolist() == [0, 1, 2, 3, 4, 5] and sign.tolist() == [1.0, 1.0, 1.0, -1.0, -1.0, -1.0]
    simulation = everyone(Simulation(quadruped, 2, threads=1))
    assert table.flat(Sensed(simulation.now, simulation.memory, quadruped.facts)).shape == (2, 6)


# Wrong settings.


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"forward": (1.0, 0.5)}, r"forward must be \[lowest, highest\], got \[1.0, 0.5\]"),
        ({"side": ()}, r"side must be \[lowest, highest\], got \[\]"),
        ({"turn": (0.0,)}, r"turn must be \[lowest, highest\], got \[0.0\]"),
        ({"begin": (0.9, 0.4)}, r"begin must be \[lowest, highest\]"),
        ({"begin": (0.4, 2.0)}, r"begin must lie within forward, \[-0.5, 1.0\], got \[0.4, 2.0\]"),
        ({"standing": 1.5}, "standing must be"),
        ({"error": 0.0}, "error must be above 0, got 0.0"),
        ({"every": -1.0}, "every must be above 0 s"),
    ],
)
def test_wrong_commands_are_named(wrong, said):
    with pytest.raises(ConfigError, match=said):
        VelocityCommand(**wrong)


def test_a_task_without_its_command_is_named():
    with pytest.raises(ConfigError, match="commands must hold a command by the name velocity"):
        VelocitySettings(commands={"velocity": None})


def test_a_term_without_a_command_is_named(robot):
    from gctd3.tasks.walk import WalkingTask

    with pytest.raises(ConfigError, match=r"reward\.terms\.track reads 'command\.velocity', which is not remembered"):
        WalkingTask(robot, Reward({"track": TrackVelocity()}))


def test_the_reward_of_the_yaml_is_that_of_the_class():
    from configs import composed

    config = composed("task=velocity")
    assert list(config["reward"]["terms"])[: len(velocity_terms())] == list(velocity_terms())
