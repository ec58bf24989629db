"""Friction cones and impedances of contacts, as a robot's settings ask for them."""

import math

import mujoco
import numpy as np
import pytest

from gctd3.errors import ConfigError
from gctd3.robots.settings import RobotSettings

ELLIPTIC = {"cone": "elliptic", "impratio": 100.0}


def creep(robot):
    """Return how far the feet of a standing robot move in a second while a force of a fifth of its weight pushes it."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    data.ctrl[:] = robot.standing_qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]]
    feet = [model.body(name).id for name in robot.feet]
    data.xfrc_applied[robot.base.root, 1] = 0.2 * model.body_mass.sum() * 9.81
    places = []
    for _ in range(2):
        mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
        places.append(data.xpos[feet].copy())
    return float(np.linalg.norm(places[1] - places[0], axis=1).max())


def test_feet_that_stand_creep_less():
    as_filed, elliptic = RobotSettings(name="quadruped").load(), RobotSettings(name="quadruped", **ELLIPTIC).load()
    assert as_filed.model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL and as_filed.model.opt.impratio == 1
    assert elliptic.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC and elliptic.model.opt.impratio == 100
    assert creep(elliptic) < creep(as_filed) / 3


def test_what_is_changed_is_said_and_nothing_else_changes():
    robot = RobotSettings(name="quadruped", **ELLIPTIC).load()
    assert robot.notes[0] == "Contacts as the settings ask for: friction cones are elliptic, impratio is 100."
    again = RobotSettings(name="quadruped", cone="pyramidal", impratio=1.0).load()
    assert again.notes == ()


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.inf, math.nan])
def test_a_ratio_that_is_none_is_refused(wrong):
    with pytest.raises(ConfigError, match=r"robot\.impratio=.*: must be greater than 0 and finite"):
        RobotSettings(impratio=wrong)
