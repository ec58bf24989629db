"""Differences between robots in a training, against hand arithmetic, MuJoCo and simulations without them."""

import mujoco
import numpy as np
import pytest
from configs import composed
from running import command, rows, train

from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings
from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError
from gctd3.robots.altered import altered_model, resting_action
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.domain_randomisation import BIAS, DELAY, MODEL, PUSH, DomainRandomisation
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.velocity import VelocitySettings
from gctd3.tasks.velocity_command import HeldCommand

STILL = {
    "randomisations": {"joint_noise": JointNoise(0.0, 0.0)},
    "commands": {"velocity": HeldCommand()},
}
QUIET = {"push_every": (100.0, 100.0)}


@pytest.fixture(scope="module")
def quadruped():
    return Robot.from_mjcf("quadruped")


def simulated(robots=2, seed=0, threads=1, **differences):
    """Return a simulation at its start; without differences if none are named."""
    domain = DomainRandomisation(**{**QUIET, **differences}) if differences else None
    task = VelocitySettings(domain_randomisation=domain, **STILL).build(RobotSettings("quadruped"))
    simulation = Simulation(task, robots, seed, threads)
    simulation.reset(np.ones(robots, dtype=bool))
    return simulation


def actions(steps, robots=2, size=12, seed=0):
    return np.random.default_rng(seed).uniform(-0.3, 0.3, (steps, robots, size))


def test_nothing_differs_unless_it_is_asked_for():
    for overrides in ((), ("experiment=paper",), ("task=velocity", "robot=quadruped")):
        assert composed(*overrides)["task"]["domain_randomisation"] is None
    asked = composed("task=velocity", "robot=quadruped", "randomisation=real")["task"]["domain_randomisation"]
    assert asked["masses"] == [0.9, 1.1] and asked["models"] == 16
    plain, none = simulated(), simulated(models=1)
    for action in actions(10):
        plain.step(action)
        none.step(action)
    np.testing.assert_array_equal(plain.state, none.state)


def test_each_number_of_the_models_is_spread_over_its_range():
    settings = DomainRandomisation(
        masses=(0.8, 1.2), frictions=(0.5, 1.5), gains=(0.9, 1.0), centre_of_mass=0.03, models=8
    )
    numbers = settings.draw_models(np.random.default_rng(0))
    assert numbers.shape == (8, 6)
    bounds = [(0.8, 1.2), (0.5, 1.5), (0.9, 1.0), *[(-0.03, 0.03)] * 3]
    for column, (low, high) in zip(numbers.T, bounds, strict=True):
        # One in each eighth of the range.
        assert sorted(np.floor((column - low) / (high - low) * 8).astype(int)) == list(range(8))


def test_a_model_has_its_numbers(quadruped):
    shift = np.array([0.02, -0.01, 0.005])
    model, own = altered_model(quadruped, 1.1, 0.7, 0.9, shift), quadruped.model
    root = quadruped.base.root
    assert model.body_subtreemass[root] == pytest.approx(1.1 * own.body_subtreemass[root])
    np.testing.assert_allclose(model.geom_friction, 0.7 * own.geom_friction)
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], 0.9 * own.actuator_gainprm[:, 0])
    np.testing.assert_allclose(model.actuator_biasprm[:, 1:3], 0.9 * own.actuator_biasprm[:, 1:3])
    places = []
    for one in (own, model):
        data = mujoco.MjData(one)
        data.qpos[:] = quadruped.standing_qpos
        mujoco.mj_kinematics(one, data)
        places.append(data.xipos[root].copy())
    np.testing.assert_allclose(places[1] - places[0], shift, atol=1e-12)


def test_robots_are_stepped_with_their_own_models():
    """Each robot moves as MuJoCo moves its model: the state after a control step, stepped here by hand."""
    simulation = simulated(6, masses=(0.5, 2.0), gains=(0.5, 2.0), models=4)
    used, own = simulation.memory[MODEL], simulation.task.robot
    assert len(set(used.tolist())) > 1
    before, action = simulation.state.copy(), actions(1, 6)[0]
    simulation.step(action)
    for robot, which in enumerate(used):
        mass, friction, gains, *shift = simulation._numbers[which]
        model = altered_model(own, mass, friction, gains, np.array(shift))
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, before[robot], mujoco.mjtState.mjSTATE_FULLPHYSICS)
        data.ctrl[:] = own.desired_angles(action[robot])
        for _ in range(simulation.substeps):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(simulation.qpos[robot], data.qpos, atol=1e-9)


def test_actions_arrive_late():
    """With a delay of two steps robots move as without one under actions that come two steps later."""
    plain, late = simulated(), simulated(delays=(2, 2))
    assert late.memory[DELAY].tolist() == [2, 2]
    taken, rest = actions(12), np.broadcast_to(resting_action(late.task.robot), (2, 12))
    for step, action in enumerate(taken):
        late.step(action)
        plain.step(taken[step - 2] if step >= 2 else rest)
        np.testing.assert_array_equal(late.state, plain.state)
    drawn = simulated(300, delays=(0, 2)).memory[DELAY]
    assert sorted(set(drawn.tolist())) == [0, 1, 2]


def test_encoders_err_in_what_is_observed_and_in_what_is_held():
    """Robots move as without the error under angles less by it, and observe angles more by it."""
    biased, plain = simulated(encoder_bias=0.05), simulated()
    bias, task = biased.memory[BIAS], biased.task
    assert np.abs(bias).max() <= 0.05 and np.abs(bias).std() > 0.01
    servos, robot = task.facts.servos, task.robot
    plain.desired = lambda action: robot.desired_angles(action) - bias[:, servos.joints]
    for action in actions(8):
        biased.step(action)
        plain.step(action)
        np.testing.assert_allclose(biased.qpos, plain.qpos, atol=1e-9)
        seen, true = (s.task.node_features(s.now, s.memory) for s in (biased, plain))
        for i, joint in enumerate(task.robot.joints):
            node = task.graph.nodes.index(joint.name)
            np.testing.assert_allclose(seen[:, node, 0] - true[:, node, 0], bias[:, i], atol=1e-5)
            np.testing.assert_allclose(seen[:, node, 1], true[:, node, 1], atol=1e-4)
    # Critics, and the rest of the observation, err in nothing.
    np.testing.assert_array_equal(seen[:, 0], true[:, 0])


def test_noise_has_the_size_that_is_asked_for():
    noisy = simulated(400, angle_noise=0.02, velocity_noise=0.5)
    true = noisy.task.table
    names, facts = noisy.task.graph.nodes, noisy.task.facts
    errors = noisy.task.node_features(noisy.now, noisy.memory) - noisy.task.node_features(
        noisy.now, {k: v for k, v in noisy.memory.items() if k != "domain.noise"}
    )
    joints = [names.index(joint.name) for joint in noisy.task.robot.joints]
    assert errors[:, joints, 0].std() == pytest.approx(0.02, rel=0.05)
    assert errors[:, joints, 1].std() == pytest.approx(0.5, rel=0.05)
    # Gravity errs by the angle; a command, the last action and contacts do not.
    assert errors[:, 0, 0].std() == pytest.approx(0.02, rel=0.1)
    assert (errors[:, joints, 2] == 0).all() and (errors[:, 0, 1] == 0).all()
    assert (errors[:, [i for i, kind in enumerate(noisy.task.graph.kinds) if kind == "ground"]] == 0).all()
    # A new frame has new errors.
    before = noisy.memory["domain.noise"]
    noisy.step(np.zeros((400, facts.actions)))
    assert (
        abs(np.corrcoef(before[:, joints, 0].ravel(), noisy.memory["domain.noise"][:, joints, 0].ravel())[0, 1]) < 0.1
    )
    assert true is noisy.task.table


def test_a_push_gives_its_momentum(quadruped):
    """Before a push the robot's momentum is computed by MuJoCo, and after it: the difference is mass times the push."""
    simulation = simulated(1, pushes=(0.4, 0.4), push_every=(0.1, 0.1))
    assert simulation.memory[PUSH].tolist() == [5]
    model, root = quadruped.model, quadruped.base.root

    def momentum(state):
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_subtreeVel(model, data)
        return model.body_subtreemass[root] * data.subtree_linvel[root]

    pushed = 0
    for _ in range(11):
        left, before = int(simulation.memory[PUSH][0]), momentum(simulation.state[0])
        simulation.step(np.zeros((1, 12)))
        # The state from which the step began, after a push.
        gained = momentum(simulation.trail()[0, 0]) - before
        if left == 1:
            assert np.linalg.norm(gained) == pytest.approx(0.4 * model.body_subtreemass[root]) and abs(gained[2]) < 1e-9
            pushed += 1
        else:
            np.testing.assert_allclose(gained, 0.0, atol=1e-9)
    assert pushed == 2


def test_it_goes_on_exactly_and_does_not_depend_on_threads():
    everything = {
        "masses": (0.8, 1.2),
        "frictions": (0.5, 1.5),
        "centre_of_mass": 0.02,
        "delays": (0, 2),
        "encoder_bias": 0.02,
        "angle_noise": 0.02,
        "pushes": (0.1, 0.5),
        "push_every": (0.04, 0.1),
        "models": 3,
    }
    one, other = simulated(3, seed=1, **everything), simulated(3, seed=2, threads=2, **everything)
    taken = actions(16, 3)
    for action in taken[:6]:
        one.step(action)
    other.load_state_dict(one.state_dict())
    for action in taken[6:]:
        one.step(action)
        other.step(action)
        np.testing.assert_array_equal(one.state, other.state)
        for name, values in one.memory.items():
            np.testing.assert_array_equal(values, other.memory[name])
    one.reset(np.ones(3, dtype=bool))
    other.reset(np.ones(3, dtype=bool))
    np.testing.assert_array_equal(one.memory[MODEL], other.memory[MODEL])


def test_evaluations_are_on_the_robot_of_the_file():
    task = simulated(masses=(0.5, 2.0), angle_noise=0.1).task
    assert task.domain is not None and task.evaluated(task.reward).domain is None
    with pytest.raises(ConfigError, match=r"env.backend must be batched for velocity, got dm_control"):
        build_env(task, EnvSettings(backend="dm_control", num_envs=1), 0)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"masses": (-0.1, 1.2)}, r"masses must be above 0, got \[-0.1, 1.2\]"),
        ({"masses": (1.2, 0.8)}, r"masses must be \[lowest, highest\], got \[1.2, 0.8\]"),
        ({"frictions": (0.0, 1.0)}, "frictions must be above 0"),
        ({"gains": ()}, r"gains must be \[lowest, highest\], got \[\]"),
        ({"delays": (-1, 2)}, "delays must be between 0 and 100"),
        ({"pushes": (0.5, 0.1)}, r"pushes must be \[lowest, highest\]"),
        ({"encoder_bias": -0.1}, "encoder_bias must be"),
        ({"models": 0}, "models must be"),
        ({"push_every": (0.0, 1.0)}, "push_every must be above 0"),
    ],
)
def test_wrong_differences_are_named(wrong, said):
    with pytest.raises(ConfigError, match=said):
        DomainRandomisation(**wrong)


def test_a_training_with_all_of_them(tmp_path, capsys):
    asked = ["task=velocity", "robot=quadruped", "randomisation=real", "task.domain_randomisation.models=2"]
    brief = ["imitation.updates=3", "task.terminations.time_limit.steps=100"]
    assert rows(train(tmp_path / "run", "algo=td3", *brief, *asked))[-1]["error_forward"]
    wrong = "task.domain_randomisation.masses=[-0.5,1.0]"
    assert command("train", *asked, wrong, f"hydra.run.dir={tmp_path / 'wrong'}") == 2
    error = capsys.readouterr().err
    assert "task.domain_randomisation.masses must be above 0, got [-0.5, 1.0]" in error
