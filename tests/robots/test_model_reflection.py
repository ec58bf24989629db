"""The reflection of states, against the places of parts in simulations and against itself."""

import mujoco
import numpy as np
import pytest
from robots import FREE_LEGS, TWO_LEGS
from two_sides import biped, robot_of

from gctd3.robots.model_reflection import ModelReflection
from gctd3.robots.random_states import RandomStates
from gctd3.robots.robot import Robot


def places_apart(robot, ground, rng):
    """Return how far a robot's parts are from the reflections of their images (m), 0.1 s after a reflected state.

    In places, not in the coordinates that the check compares.
    """
    image, model = ModelReflection(robot), robot.model
    order, signs = robot.action_mirror
    qpos, qvel = RandomStates(image).draw(rng, ground)
    action = rng.uniform(-1.0, 1.0, len(order))
    low, high = robot.action_range.T
    seen = []
    for pose, speed, taken in ((qpos, qvel, action), (*image.states(qpos, qvel), signs * action[order])):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = pose, speed
        data.ctrl[:] = (low + high) / 2 + (high - low) / 2 * taken
        mujoco.mj_step(model, data, nstep=round(0.1 / model.opt.timestep))
        mujoco.mj_kinematics(model, data)
        seen.append(data.xipos.copy())
    bodies = {model.body(b).name: b for b in range(1, model.nbody)}
    return max(
        float(np.linalg.norm(seen[0][b] * (1, -1, 1) - seen[1][bodies[robot.mirror_name(name)]]))
        for name, b in bodies.items()
    )


@pytest.mark.parametrize("ground", [None, 0.0], ids=["air", "ground"])
@pytest.mark.parametrize("name", ["quadruped", "hexapod", "biped"])
def test_reflected_states_move_to_reflected_places(name, ground):
    rng = np.random.default_rng(3)
    assert max(places_apart(Robot.from_mjcf(name), ground, rng) for _ in range(5)) < 1e-6


@pytest.mark.parametrize("text", [TWO_LEGS, FREE_LEGS, biped("<freejoint/>")], ids=["boom", "free", "knees"])
def test_reflecting_a_state_twice_changes_nothing(text):
    robot = robot_of(text)
    image, rng = ModelReflection(robot), np.random.default_rng(0)
    for _ in range(5):
        qpos, qvel = RandomStates(image).draw(rng, None)
        again = image.states(*image.states(qpos, qvel))
        np.testing.assert_allclose(again[1], qvel, atol=1e-12)
        apart = np.zeros(robot.model.nv)
        mujoco.mj_differentiatePos(robot.model, apart, 1.0, again[0], qpos)
        np.testing.assert_allclose(apart, 0.0, atol=1e-12)
