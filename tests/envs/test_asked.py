"""The Python API takes what the command line takes, with the same meaning."""

import math

import gymnasium
import mujoco
import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from robots import FREE_LEGS, TWO_LEGS, write

import gctd3
from gctd3.config.build import build
from gctd3.envs import dmc
from gctd3.envs.asked import ask, ask_simulated
from gctd3.errors import ConfigError, RobotError
from gctd3.robots.command_line import robot_file
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.reward import Reward
from gctd3.tasks.terminations import Fall, TimeLimit
from gctd3.tasks.walk import WalkSettings

BIPED = "gctd3/Biped-v0"
FEW_LINES = ["robot=biped", "robot=quadruped", "robot=hexapod", "robot=biped_planar"]


def of_command_line(*arguments):
    """Return the settings of robot, task and reward that gctd3.train makes of its arguments."""
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        settings = build(compose("config", robot_file(list(arguments))))
    return settings.robot, settings.task, settings.reward


@pytest.mark.parametrize("line", FEW_LINES)
def test_a_name_brings_what_it_brings_on_the_command_line(line):
    robot, task, reward = of_command_line(line)
    asked = ask(line.partition("=")[2], reward="walk")
    wanted = task.build(robot, reward)
    assert asked.settings == wanted.settings and asked.reward == wanted.reward
    np.testing.assert_array_equal(asked.robot.action_range, wanted.robot.action_range)
    np.testing.assert_array_equal(asked.robot.action_map, wanted.robot.action_map)
    # The paper's reward unless one is asked for.
    assert ask(line.partition("=")[2]).reward == Reward()


def test_the_paper_s_robot_is_what_it_was():
    """By the command line's way and by the dataclasses' defaults."""
    asked, built = ask("biped"), WalkSettings().build(RobotSettings("biped"))
    assert asked.settings == built.settings and asked.reward == built.reward


@pytest.mark.parametrize("text", [TWO_LEGS, FREE_LEGS])
def test_a_file_is_read_as_on_the_command_line(tmp_path, text):
    file = write(tmp_path, text)
    robot, task, _ = of_command_line(f"robot={file}")
    asked, wanted = ask(file), task.build(robot, Reward())
    assert asked.settings == wanted.settings and asked.robot.feet == wanted.robot.feet
    assert asked.robot.model.nu == wanted.robot.model.nu and asked.graph.nodes == wanted.graph.nodes


def test_a_file_of_any_name(tmp_path):
    folder = tmp_path / "ein Roboter, 'für' {mich}=1"
    folder.mkdir()
    assert ask(write(folder, TWO_LEGS)).robot.feet == ("leg_r", "leg_l")


FEET, STEPS = ("foot_left", "foot_right"), 7
SAME = {
    "control_dt": ({"control_dt": 0.01}, ["task.control_dt=0.01"]),
    "feet": ({"feet": FEET}, ["robot.feet=[foot_left,foot_right]"]),
    "forward": ({"forward": "x"}, ["robot.forward=x"]),
    "history": ({"history": 3}, ["task.history=3"]),
    "terminations": (
        {"terminations": {"fall": Fall(height=-0.2), "stuck_hip": None, "time_limit": TimeLimit(STEPS)}},
        [
            "task.terminations.fall.height=-0.2",
            "task.terminations.stuck_hip=null",
            f"task.terminations.time_limit.steps={STEPS}",
        ],
    ),
}


@pytest.mark.parametrize("option", SAME)
def test_an_option_means_what_its_override_means(option):
    given, overrides = SAME[option]
    one, other = ask("biped", **given), ask("biped", overrides=overrides)
    assert (one.robot.feet, one.robot.forward_axis) == (other.robot.feet, other.robot.forward_axis)
    assert (one.control_dt, one.history, one.time_limit) == (other.control_dt, other.history, other.time_limit)
    assert list(one.terminations.values()) == list(other.terminations.values())
    assert one.settings != ask("biped").settings or option in ("feet", "forward")


@pytest.mark.parametrize("option", SAME)
def test_every_way_to_an_environment_takes_the_options(option):
    given, _ = SAME[option]
    wanted = ask("biped", **given)
    batched = gctd3.make_env(num_envs=1, **given)
    serial = gctd3.make_env(num_envs=1, backend="dm_control", **given)
    suite = dmc.load("biped", random=0, **given).task.task
    vector = gymnasium.make_vec(BIPED, num_envs=2, **given).unwrapped.simulation.task
    single = gymnasium.make(BIPED, **given).unwrapped
    tasks = [batched.base_env.simulation.task, suite, vector, single._one.simulation.task]
    for task in tasks:
        assert task.settings == wanted.settings and task.robot.feet == wanted.robot.feet
    shape = (wanted.graph.num_nodes, wanted.features * wanted.history)
    assert batched.reset()["nodes"].shape[1:] == serial.reset()["nodes"].shape[1:] == shape
    # Flat by default.
    assert single.observation_space.shape == (math.prod(shape),)


@pytest.mark.parametrize("backend", ["batched", "dm_control"])
@pytest.mark.parametrize("kind", ["name", "settings", "robot", "model"])
def test_a_robot_in_memory_is_the_robot(backend, kind):
    given = {
        "name": "biped",
        "settings": RobotSettings("biped"),
        "robot": Robot.from_mjcf("biped"),
        "model": mujoco.MjModel.from_xml_path(str(Robot.from_mjcf("biped").path)),
    }[kind]
    wanted = gctd3.make_env("biped", 1, backend, seed=4)
    env = gctd3.make_env(given, 1, backend, seed=4)
    action = torch.full((1, 6), 0.2)
    states = [one.step(one.reset().set("action", action))["next"] for one in (env, wanted)]
    assert (states[0]["nodes"] == states[1]["nodes"]).all() and (states[0]["reward"] == states[1]["reward"]).all()


def test_feet_of_a_robot_in_memory():
    model = mujoco.MjModel.from_xml_path(str(Robot.from_mjcf("biped").path))
    assert ask(model, feet=FEET).robot.feet == FEET
    with pytest.raises(RobotError, match="nothing"):
        ask(model, feet=["nothing"])


@pytest.mark.parametrize("backend", ["batched", "dm_control"])
def test_a_model_that_cannot_walk_is_answered_in_a_line(backend):
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(RobotError) as refused:
        gctd3.make_env(model, 1, backend)
    assert "\n" not in str(refused.value)


def test_max_episode_steps():
    """Gymnasium wraps a single environment by itself; a vector environment has to truncate by itself."""
    vector = gymnasium.make_vec(BIPED, num_envs=3, max_episode_steps=STEPS)
    single = gymnasium.make(BIPED, max_episode_steps=STEPS)
    for env in (vector, single):
        env.reset(seed=0)
        ends = [env.step(np.zeros(env.action_space.shape))[2:4] for _ in range(STEPS)]
        assert [np.any(truncated) for _, truncated in ends] == [False] * (STEPS - 1) + [True]
        assert np.all(ends[-1][1]) and not np.any([terminated for terminated, _ in ends])
    # A longer one leaves the task's own.
    assert gymnasium.make_vec(BIPED, num_envs=1, max_episode_steps=10**6).unwrapped.simulation.task.time_limit == 1600


WRONG = {
    "robot": ({"robot": 3}, "robot must be a name, a file, RobotSettings, a Robot or an MjModel, got 3"),
    "nobody": ({"robot": "nobody"}, "No robot 'nobody'"),
    "file": ({"robot": "no/such.urdf"}, "No URDF file at no/such.urdf"),
    "reward": ({"reward": "wlak"}, "reward/wlak"),
    "override": ({"overrides": ["task.historie=3"]}, "Unknown key 'task.historie'"),
    "value": ({"overrides": ["task.history=many"]}, "task.history must be a whole number, got 'many'"),
    "forward": ({"forward": "up"}, "forward must be"),
    "feet": ({"feet": ["hand"]}, "hand"),
    "period": ({"control_dt": 3.0}, "control_dt must be above 0 s and at most 1 s, got 3.0"),
    "termination": ({"terminations": {"fall": 3}}, "terminations"),
    "memory": ({"robot": RobotSettings("biped"), "overrides": ["task.history=2"]}, "overrides must be empty"),
    "named reward": ({"robot": RobotSettings("biped"), "reward": "walk"}, "reward must be a Reward"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_are_named(case):
    given, said = WRONG[case]
    with pytest.raises((ConfigError, RobotError)) as refused:
        gctd3.make_env(num_envs=1, **given)
    assert said in str(refused.value) and "\n" not in str(refused.value).strip()


def test_wrong_arguments_of_environments_are_named():
    with pytest.raises(
        ConfigError, match=r"backend must be batched, dm_control, library, got 'dmcontrol'\. Did you mean"
    ):
        gctd3.make_env(backend="dmcontrol")
    with pytest.raises(ConfigError, match="max_episode_steps must be at least 1, got 0"):
        gymnasium.make_vec(BIPED, num_envs=1, max_episode_steps=0)
    with pytest.raises(ConfigError, match=r"Unknown argument 'feat'\. Did you mean 'feet'"):
        gymnasium.make(BIPED, feat=FEET)
    with pytest.raises(ConfigError, match="control_dt must be left out for a task that is built already"):
        dmc.load(ask_simulated("biped"), control_dt=0.01)


def test_inside_a_command_hydra_stays_as_it_is():
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        before = GlobalHydra.instance().hydra
        ask("biped", overrides=["task.history=4"])
        assert GlobalHydra.instance().hydra is before
        assert compose("config", ["task.history=6"]).task.history == 6
