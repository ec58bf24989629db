"""A walk under commanded velocities is steered from the page: sliders and keys, within the ranges of the training."""

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule

from gctd3.robots.settings import RobotSettings
from gctd3.tasks.velocity import VelocitySettings
from gctd3.viz.live_session import LiveWalk


@pytest.fixture
def walk():
    task = VelocitySettings().build(RobotSettings("quadruped"))
    stand = TensorDictModule(lambda nodes: torch.zeros(*nodes.shape[:-2], 12), ["nodes"], ["action"])
    return LiveWalk(stand, task.evaluated(task.reward).without_end(), seed=5)


def test_a_command_is_observed_and_holds(walk):
    drawn = walk.asked
    np.testing.assert_array_equal(walk.now.command, 0.0)
    walk.steer(np.array([0.5, -0.2, 0.4]))
    # By 2 m/s^2 and 4 rad/s^2, in steps of 0.02 s.
    np.testing.assert_allclose(walk.step().command, [0.04, -0.04, 0.08])
    np.testing.assert_allclose(walk.step().command, [0.08, -0.08, 0.16])
    names = walk.simulation.task.graph.nodes
    for _ in range(300):
        now = walk.step()
    # Longer than the five seconds after which the task draws another one.
    np.testing.assert_allclose(now.command, [0.5, -0.2, 0.4])
    assert not np.allclose(drawn, now.command)
    frame = walk._state["nodes"][0, :, -3:].numpy()
    assert frame[0, 1] == pytest.approx(0.5)
    assert frame[names.index(f"{names[0]}_side"), 2] == pytest.approx(-0.2)
    assert frame[names.index(f"{names[0]}_yaw"), 2] == pytest.approx(0.4)
    np.testing.assert_allclose(now.moved, 0.0, atol=0.02)
    # A new episode, which begins with standing, keeps it, and beyond the ranges it is the nearest.
    np.testing.assert_allclose(walk.reset(6).command, 0.0)
    np.testing.assert_allclose(walk.asked, [0.5, -0.2, 0.4])
    walk.steer(np.array([9.0, -9.0, 0.0]))
    np.testing.assert_allclose(walk.asked, [1.0, -0.4, 0.0])
    np.testing.assert_allclose(walk.step().command, [0.04, -0.04, 0.0])


def test_sliders_and_keys(walk):
    viser = pytest.importorskip("viser")
    pytest.importorskip("mjviser")
    from gctd3.viz.browser_messages import Gate
    from gctd3.viz.command_panel import add_command_controls, commanded

    server = viser.ViserServer(port=0, verbose=False)
    wishes, handles = {}, {}

    def slider(name, between, step, value, hint):
        return server.gui.add_slider(name, min=between[0], max=between[1], step=step, initial_value=value, hint=hint)

    def on(register, wish):
        wishes.setdefault(getattr(register.__self__, "label", ""), []).append(wish)
        handles[getattr(register.__self__, "label", "")] = register.__self__
        register(lambda event: wish())

    try:
        walk.steer(np.zeros(3))
        walk.step()
        add_command_controls(server.gui, walk, slider, on)
        # A tenth of the range, -0.5 to 1, for each press.
        for label, expected in (
            ("Forward, more", [0.15, 0, 0]),
            ("Forward, more", [0.3, 0, 0]),
            ("To the left, less", [0.3, -0.08, 0]),
            ("Turn left, more", [0.3, -0.08, 0.16]),
            ("Forward, less", [0.15, -0.08, 0.16]),
            ("Forward, less", [0, -0.08, 0.16]),
            ("Forward, less", [-0.15, -0.08, 0.16]),
        ):
            wishes[label][0]()
            # No press asks for more than eight steps of 0.02 s bring.
            commands = [walk.step().command for _ in range(8)]
            np.testing.assert_allclose(commands[-1], expected, atol=1e-9, err_msg=label)
        # A browser may press these keys, and may set the sliders within their ranges.
        gate = Gate({"key": handles["Forward, more"], "slider": handles["Forward, m/s"]}.get)
        press, value = {"type": "CommandTriggerMessage", "uuid": "key"}, {"type": "GuiUpdateMessage", "uuid": "slider"}
        assert gate.is_key(press) and gate.is_value({**value, "updates": {"value": -0.5}})
        for lie in ({"uuid": "slider"}, {"uuid": "nobody"}, {"uuid": 1}, {"more": 1}, {"type": "GuiUpdateMessage"}):
            assert not gate.is_key({**press, **lie}), lie
        assert not gate.is_key({"type": "CommandTriggerMessage"})
        for lie in (-0.51, 1.01, np.nan, "0", None, True, [0.0]):
            assert not gate.is_value({**value, "updates": {"value": lie}}), lie
        assert not gate.is_value({**value, "uuid": "key", "updates": {"value": 1.0}})
        rows = commanded(walk.now)
        assert rows[0][0] == ("command", "-0.15 m/s, -0.08 m/s, +0.16 rad/s") and rows[1][0][0] == "follows"
        wishes["Stand still"][0]()
        np.testing.assert_allclose([walk.step().command for _ in range(8)][-1], 0.0)
    finally:
        server.stop()


def test_a_walk_without_commands_has_no_controls(task):
    from gctd3.viz.command_panel import add_command_controls, commanded

    still = TensorDictModule(lambda nodes: torch.zeros(*nodes.shape[:-2], 6), ["nodes"], ["action"])
    walk = LiveWalk(still, task, seed=0)
    assert walk.ranges == {} and walk.now.command is None and commanded(walk.now) == []
    add_command_controls(None, walk, None, None)
