"""A gait is measured by motion, not by the signs of angles, where left and right axes point opposite ways."""

from dataclasses import replace

import numpy as np
import pytest
from compositions import reward, walking
from robots import opposite_axes


@pytest.fixture(scope="module")
def opposite(robot, tmp_path_factory):
    return opposite_axes(robot, tmp_path_factory.mktemp("robot"))


# Right hip 0.3 rad forward, left hip 0.3 rad back: on the biped as it is, and with the left axis turned round.
@pytest.mark.parametrize(("left", "turned"), [(-0.3, False), (0.3, True)])
def test_antiphase_penalises_legs_together_not_legs_apart(robot, opposite, left, turned):
    task = walking(opposite if turned else robot, reward(antiphase=0.5))
    ground = task.measure(np.zeros(8), np.zeros(8), np.zeros(7))
    angles = np.zeros(6)
    angles[task.facts.hips] = 0.3, left
    apart = replace(ground, angles=angles)
    angles = np.zeros(6)
    angles[task.facts.hips] = 0.3, -left
    together = replace(ground, angles=angles)
    _, outcome = task.advance(task.begin(ground), apart)
    assert outcome.terms["antiphase"] == pytest.approx(0.0)
    _, outcome = task.advance(task.begin(ground), together)
    assert outcome.terms["antiphase"] == pytest.approx(-0.5 * 0.6)


def test_hip_signs(robot, opposite):
    assert robot.hip_signs.tolist() == [1.0, 1.0]
    assert opposite.hip_signs.tolist() == [1.0, -1.0]
