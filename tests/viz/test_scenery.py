"""A picture shows the robot whatever its file lacks: visual geoms, a light, a sky, or a bright ground for the words."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from compositions import walking
from tensordict.nn import TensorDictModule

from gctd3.robots.robot import Robot
from gctd3.viz.film import Walk, draw
from gctd3.viz.live_session import LiveWalk
from gctd3.viz.offscreen import Canvas
from gctd3.viz.scenery import with_scenery

SKY = '<asset><texture type="skybox" builtin="flat" rgb1="1 0 0" rgb2="1 0 0" width="8" height="48"/></asset>'
LIGHT = '<light pos="0 0 3" dir="0 0 -1"/>'


def model(geoms, more="", world=""):
    """Make a scene of one body, which fills the middle of the picture."""
    return mujoco.MjModel.from_xml_string(
        f"<mujoco>{more}<worldbody>{world}<body><freejoint/>{geoms}</body></worldbody></mujoco>"
    )


def ball(colour="0 0.6 0 1", size=0.3, more=""):
    return f'<geom size="{size}" rgba="{colour}" mass="1" {more}/>'


def picture(of, size=(64, 64)):
    """Draw a model from two metres, shape [H, W, 3], as whole numbers."""
    data = mujoco.MjData(of)
    mujoco.mj_forward(of, data)
    camera = mujoco.MjvCamera()
    camera.distance, camera.elevation = 2.0, -10.0
    with Canvas(of, *size) as canvas:
        canvas.look(data, camera)
        return canvas.draw().astype(int)


def is_green(pixels):
    """Tell of each pixel whether it is more green than anything else."""
    return pixels[..., 1] > np.maximum(pixels[..., 0], pixels[..., 2]) + 10


@pytest.mark.parametrize("hidden", ['group="3"', 'group="5"'])
def test_geoms_for_collisions_are_drawn_where_there_are_no_others(hidden):
    assert is_green(picture(model(ball(more=hidden))))[32, 32]
    # A body that has something to see keeps its other geoms out of the picture.
    both = picture(model(ball("0.6 0 0 1", 0.1) + ball(more=hidden)))
    assert not is_green(both).any() and both[32, 32, 0] > both[32, 32, 1] + 10


def test_geoms_without_any_colour_are_drawn_grey_where_there_are_no_others():
    seen = picture(model(ball("0 0 0 0")))
    assert np.ptp(seen[32, 32]) < 20 and np.abs(seen[32, 32] - seen[2, 32]).max() > 20
    material = '<asset><material name="glass" rgba="1 1 1 0"/></asset>'
    glass = picture(model('<geom size="0.3" mass="1" material="glass"/>', material))
    assert np.abs(glass[32, 32] - seen[32, 32]).max() < 5
    own_colour = picture(model(ball(more='material="glass"'), material))
    assert is_green(own_colour)[32, 32]


def test_every_body_counts_by_itself():
    child = (
        f'{ball("0.6 0 0 1", 0.1)}<body pos="0 0.5 0"><joint/>{ball(more="group=" + chr(34) + "3" + chr(34))}</body>'
    )
    assert is_green(picture(model(child))).any()


@pytest.mark.parametrize(
    "dark",
    [
        "",
        '<visual><headlight active="0"/></visual>',
        '<visual><headlight ambient="0 0 0" diffuse="0 0 0"/></visual>',
    ],
)
def test_a_scene_without_a_light_is_lit(dark):
    assert picture(model(ball("0.8 0.8 0.8 1"), dark))[32, 32].min() > 60
    off = '<light active="false" pos="0 0 3"/>'
    assert picture(model(ball("0.8 0.8 0.8 1"), dark, off))[32, 32].min() > 60


def test_a_light_of_the_scene_is_left_as_it_is():
    lit = model(ball(), "", LIGHT)
    before = lit.vis.headlight.diffuse.copy()
    np.testing.assert_array_equal(with_scenery(lit).vis.headlight.diffuse, before)


def test_a_sky_is_painted_where_a_scene_has_none():
    top = picture(model(ball()))[:4]
    assert top.min() > 100 and (top[..., 2] > top[..., 0] + 20).all()
    np.testing.assert_array_equal(picture(model(ball(), SKY))[:4].reshape(-1, 3), [[255, 0, 0]] * 256)


def test_the_model_of_the_walk_is_left_alone():
    of = model(ball("0 0 0 0", more='group="3"'))
    groups, size = of.geom_group.copy(), of.vis.global_.offwidth
    picture(of)
    np.testing.assert_array_equal(of.geom_group, groups)
    assert of.vis.global_.offwidth == size and of.vis.headlight.ambient[0] == pytest.approx(0.1)
    copied = with_scenery(of)
    one, other = mujoco.MjData(of), mujoco.MjData(copied)
    for _ in range(20):
        mujoco.mj_step(of, one)
        mujoco.mj_step(copied, other)
    np.testing.assert_array_equal(one.qpos, other.qpos)


@pytest.mark.parametrize("ground", ["0 0 0 1", "1 1 1 1", "0.5 0.5 0.5 1"])
def test_words_and_marks_are_readable_on_any_ground(tmp_path, ground):
    text = Path(Robot.from_mjcf("biped").path).read_text(encoding="utf-8")
    file = tmp_path / "biped.xml"
    file.write_text(text.replace('material="ground"', f'rgba="{ground}"'), encoding="utf-8")
    robot = Robot.from_mjcf(file)
    still = Walk(robot.standing_qpos[None], np.zeros(1), np.zeros(1), np.zeros(1))
    frames = [
        np.asarray(next(draw(still, robot, [0], "side", (200, 160), 0.02, words))).astype(int).mean(axis=-1)
        for words in (True, False)
    ]
    written = np.abs(frames[0] - frames[1]) > 0
    words = written[:40]
    # Dark letters with a bright rim: both are there, side by side.
    assert (frames[0][:40][words] < 60).sum() > 50 and (frames[0][:40][words] > 230).sum() > 50
    # Near the picture's middle a mark crosses the ground: a dark line between two bright ones.
    lower = frames[1][110:, 60:140]
    assert np.ptp(lower, axis=1).max() > 60


@pytest.mark.filterwarnings("ignore:.control_layout. is deprecated:DeprecationWarning")
def test_the_viewer_shows_what_pictures_show(monkeypatch):
    mjviser = pytest.importorskip("mjviser")
    from gctd3.viz import browser_panel
    from gctd3.viz.viewer_server import serve

    task, shown = walking(Robot.from_mjcf("quadruped")), []
    still = torch.zeros(len(task.robot.action_range))
    stand = TensorDictModule(lambda nodes: still.expand(*nodes.shape[:-2], -1), ["nodes"], ["action"])
    walk = LiveWalk(stand, task, seed=5)
    walk.robot.model.geom_group[:] = 3

    class Seen(mjviser.ViserMujocoScene):
        def __init__(self, server, model, num_envs):
            shown.append(model)
            super().__init__(server, model, num_envs)

    monkeypatch.setattr(mjviser, "ViserMujocoScene", Seen)
    server = serve("localhost", 0)
    try:
        browser_panel.Panel(server, lambda run: walk, ["only"], seed=1)
    finally:
        server.stop()
    (model,) = shown
    assert (model.geom_group == 0).all() and (walk.robot.model.geom_group == 3).all()
