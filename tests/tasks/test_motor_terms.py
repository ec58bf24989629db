"""Terms for motors and joints, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from gaits import sense

from gctd3.errors import ConfigError
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.motor_terms import (
    LAST_ACTION,
    ActionRate,
    Effort,
    EndStops,
    FootSlip,
    HeightFromStanding,
    HomePose,
    ShankContact,
)
from gctd3.tasks.reward_terms import ForwardVelocity
from gctd3.tasks.terminations import Fall
from gctd3.tasks.terms import Step
from gctd3.tasks.walk import WalkingTask


@pytest.fixture(scope="module")
def facts():
    return WalkingTask(RobotSettings("biped").load()).facts


def step(facts, now, action=None, before=None):
    action = np.zeros(6) if action is None else np.asarray(action, dtype=float)
    after = {LAST_ACTION.name: action}
    return Step(
        now, {LAST_ACTION.name: np.zeros(6) if before is None else before}, after, action, np.array(False), facts, {}
    )


def test_action_rate(facts):
    """A change of 0.3 in one and of 0.6 in another of six actions: mean of squares (0.09 + 0.36) / 6 = 0.075."""
    action = [0.3, 0.0, -0.6, 0.0, 0.0, 0.0]
    assert ActionRate(weight=-2.0)(step(facts, sense(), action)) == pytest.approx(-0.15)
    assert ActionRate(weight=-2.0)(step(facts, sense(), action, before=np.array(action))) == 0.0


def test_effort(facts):
    """Torques by the servo's law over the limit: 50 (0.4 - 0.1) - 2 * 1.5 = 12 N m of 24; one limited of six."""
    servos = replace(
        facts.servos,
        centre=np.zeros(6),
        scale=np.full(6, 0.8),
        stiffness=np.full(6, 50.0),
        damping=np.full(6, 2.0),
        effort=np.array([24.0, *[np.inf] * 5]),
        limited=np.array([0]),
    )
    now = sense(hips=(0.1, 0.0))
    now = replace(now, velocities=np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    own = replace(facts, servos=servos)
    term = Effort(weight=-1.0)
    assert term(step(own, now, [0.5, 0, 0, 0, 0, 0])) == pytest.approx(-0.25)
    # An action beyond 1 counts as 1: 50 * 0.7 - 3 = 32 N m, more than there is.
    assert term(step(own, now, [9.0, 0, 0, 0, 0, 0])) == pytest.approx(-1.0)
    assert term.applies(own) and not term.applies(
        replace(facts, servos=replace(servos, limited=np.array([], dtype=int)))
    )


def test_end_stops(facts):
    """Nine tenths of a range of -1 to 1 are free: 0.95 rad is 0.05 too far, on either side; no limit is never near."""
    ranges = np.array([[-1.0, 1.0], [-np.inf, np.inf], *[[-5.0, 5.0]] * 4])
    own = replace(facts, ranges=ranges)
    now = replace(sense(), angles=np.array([-0.95, 40.0, 0.0, 0.0, 0.0, 4.6]))
    assert EndStops(weight=-2.0, share=0.9)(step(own, now)) == pytest.approx(-2.0 * (0.05 + 0.1))
    with pytest.raises(ConfigError, match="share must be above 0"):
        EndStops(share=0.0)


def test_home_pose(facts):
    now = replace(sense(), angles=facts.home + np.array([0.3, 0.0, 0.0, -0.3, 0.0, 0.0]))
    assert HomePose(weight=-1.0)(step(facts, now)) == pytest.approx(-0.03)


def test_foot_slip_counts_feet_that_are_down(facts):
    """0.3 and 0.4 m/s across the ground are 0.5 m/s; up and down is not sliding, and a foot in the air swings."""
    now = replace(sense(feet=(True, False)), feet_velocity=np.array([[0.3, 0.4, 9.0], [5.0, 5.0, 5.0]]))
    assert FootSlip(weight=-0.2)(step(facts, now)) == pytest.approx(-0.1)
    assert not FootSlip().applies(facts) and FootSlip().applies(replace(facts, foot_velocities=True))


def test_height_in_leg_lengths(facts):
    own = replace(facts, leg_length=0.5)
    for height, expected in ((-0.15, -2.0 * 0.2), (0.15, -2.0 * 0.2), (-0.05, 0.0), (0.0, 0.0)):
        assert HeightFromStanding(weight=-2.0, free=0.1)(step(own, sense(z=height))) == pytest.approx(expected)


def test_shanks_graze_or_fall(facts):
    now = replace(sense(), shank_down=np.array(True))
    assert ShankContact(weight=-0.5)(step(facts, now)) == -0.5
    assert Fall()(step(facts, now)) and not Fall(shanks=False)(step(facts, now))


def test_heights_and_speeds_by_the_leg(facts):
    """A Froude number of 0.3 on legs of 0.5 m: v = sqrt(0.3 * 9.81 * 0.5) = 1.213 m/s; a drop of 40 %: 0.2 m."""
    own = replace(facts, leg_length=0.5)
    paid = [float(ForwardVelocity(target=None)(step(own, sense(v=v)))) for v in (1.0, 1.3, 9.0)]
    assert paid == pytest.approx([1.0, 1.2130, 1.2130], abs=1e-4)
    assert Fall(height=None)(step(own, sense(z=-0.21))) and not Fall(height=None)(step(own, sense(z=-0.19)))
    for wrong, message in ((lambda: ForwardVelocity(froude=0.0), "froude"), (lambda: Fall(drop=-1.0), "drop")):
        with pytest.raises(ConfigError, match=f"{message} must be above 0"):
            wrong()
