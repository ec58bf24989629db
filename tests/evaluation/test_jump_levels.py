"""How jumps are summed up: by the commanded height, over episodes that are made up by hand."""

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule

from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings
from gctd3.evaluation.episode import Episode
from gctd3.evaluation.jumping import by_level, jump_errors
from gctd3.evaluation.rollout import evaluate
from gctd3.robots.settings import RobotSettings
from gctd3.runs.evaluate import jump_table
from gctd3.tasks.jump import JumpSettings


def episode(jump, success=False, fell=False, rise=0.0):
    return Episode(
        reward=np.zeros(2),
        position=np.zeros(2),
        height=np.array([0.0, rise]),
        hips=np.zeros((2, 2)),
        feet_down=np.ones((2, 2), dtype=bool),
        success=success,
        fell=fell,
        jump=jump,
    )


MADE_UP = [
    episode((0.2, 0.19), fell=True, rise=0.05),
    episode((0.1, 0.12), success=True, rise=0.02),
    episode((0.1, 0.08), rise=0.01),
    episode((0.2, 0.23), success=True, rise=0.07),
]


def test_jumps_are_summed_up_by_hand():
    errors = jump_errors(MADE_UP)
    assert errors == pytest.approx({"apex_mean": 0.155, "apex_error": 0.02, "fall_rate": 0.25})
    low, high = by_level(MADE_UP)
    assert (low.commanded, low.episodes, low.success_rate, low.fall_rate) == (0.1, 2, 0.5, 0.0)
    assert (low.apex_mean, low.apex_least, low.apex_most) == pytest.approx((0.1, 0.08, 0.12))
    assert low.rise_mean == pytest.approx(0.015) and high.rise_mean == pytest.approx(0.06)
    assert (high.commanded, high.success_rate, high.fall_rate) == (0.2, 0.5, 0.5)


def test_a_walk_has_no_jumps():
    walked = [episode(None), episode(None)]
    assert jump_errors(walked) == {} and by_level(walked) == [] and jump_table({}) == []


def test_a_level_is_a_line_of_the_table():
    lines = jump_table({"jumps": [vars(level) for level in by_level(MADE_UP)]})
    assert lines[1].split() == ["commanded,", "m", "episodes", "success", "falls", "apex,", "m", "least", "most"]
    assert lines[2].split() == ["0.100", "2", "0.50", "0.00", "0.100", "0.080", "0.120"]


def test_episodes_keep_what_the_simulator_did():
    """A robot that stands has an apex of 0, at whatever height it was asked for, and neither falls nor succeeds."""
    task = JumpSettings().build(RobotSettings("biped"))
    standing = torch.tensor((task.robot.home_angles - task.robot.action_map[0]) / task.robot.action_map[1]).float()
    policy = TensorDictModule(lambda nodes: standing.expand(len(nodes), -1), ["nodes"], ["action"])
    result = evaluate(policy, build_env(task, EnvSettings(num_envs=6, threads=1), 0), task, seed=1)
    assert {one.jump[0] for one in result.episodes} <= set(task.levels)
    assert [one.jump[1] for one in result.episodes] == pytest.approx([0.0] * 6, abs=0.003)
    summary = result.summary()
    assert summary["success_rate"] == 0.0 and summary["fall_rate"] == 0.0
    assert sum(level.episodes for level in by_level(result.episodes)) == 6
