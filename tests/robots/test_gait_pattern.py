"""The order in which feet step, and how often: known gaits, and Alexander's formula by hand."""

import mujoco
import numpy as np
import pytest

from gctd3.robots.gait_pattern import alternating_phases, stride_frequency
from gctd3.robots.settings import RobotSettings


def phases(robot):
    loaded = RobotSettings(robot).load()
    return loaded, alternating_phases(loaded)


def test_two_legs_take_turns():
    _, of_feet = phases("biped")
    assert sorted(of_feet) == [0.25, 0.75]


def test_four_legs_trot():
    """Diagonal feet step together: the left front one with the right hind one."""
    robot, of_feet = phases("quadruped")
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(robot.model, data)
    places = np.array([robot.base.frame @ robot.foot_place(data, foot) for foot in robot.feet])
    front, left = places[:, 0] > places[:, 0].mean(), places[:, 1] > places[:, 1].mean()
    assert front.sum() == left.sum() == 2
    np.testing.assert_array_equal(of_feet, np.where(front == left, 0.25, 0.75))


def test_six_legs_walk_on_tripods():
    """The feet of neighbouring legs of one side take turns, so that three feet step at a time."""
    robot, of_feet = phases("hexapod")
    assert np.sum(of_feet == 0.25) == np.sum(of_feet == 0.75) == 3
    firsts = [of_feet[pair[0]] for pair in robot.foot_pairs]
    assert len(set(firsts)) == 2
    for left, right in robot.foot_pairs:
        assert of_feet[left] != of_feet[right]


def test_stride_frequency_by_hand():
    # Legs of 0.3 m at Fr 0.25: v = sqrt(0.25 * 9.81 * 0.3) = 0.85776 m/s; stride 2.3 * 0.3 * 0.25^0.3 = 0.45523 m.
    assert stride_frequency(0.3, 0.25) == pytest.approx(0.85776 / 0.45523, rel=1e-4)


def test_long_legs_step_more_slowly():
    """Four times the length at the same Froude number: half the frequency, as of pendulums."""
    assert stride_frequency(0.8, 0.3) == pytest.approx(stride_frequency(0.2, 0.3) / 2)
