"""Pictures of a walk show the evaluated walk, with marks and sizes as asked, and need any one OpenGL."""

import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from compositions import env_of
from PIL import Image

import gctd3
from gctd3.errors import ConfigError
from gctd3.robots.robot import Robot
from gctd3.runs.evaluate import evaluate
from gctd3.viz import film
from gctd3.viz.film import Walk, draw, record, sheet, write_animation

ANT = Path(gymnasium.__file__).parent / "envs/mujoco/assets/ant.xml"


@pytest.fixture(scope="module")
def actor(graph):
    return gctd3.make_actor(graph, in_features=10, action_dim=6)


@pytest.fixture(scope="module")
def walk(actor, task):
    return record(actor, task, seed=3)


def test_the_walk_is_the_one_that_is_evaluated(actor, task, walk):
    (episode,) = evaluate(actor, env_of(task, num_envs=1), task, 3).episodes
    np.testing.assert_array_equal(walk.reward.astype(np.float32), episode.reward.astype(np.float32))
    np.testing.assert_allclose(walk.position, episode.position, atol=1e-6)
    assert walk.total[-1] == pytest.approx(episode.reward.sum(), abs=1e-4)
    assert len(record(actor, task, seed=3, most_steps=5).qpos) == 5


def frame(walk, robot, step=0, camera="side", size=(200, 160), words=True):
    (drawn,) = draw(walk, robot, [step], camera, size, 0.02, words)
    assert drawn.size == size
    return np.asarray(drawn).astype(int)


@pytest.mark.nightly
def test_marks_lie_on_the_ground(walk, robot, monkeypatch):
    marked = frame(walk, robot)
    monkeypatch.setattr(film, "MARKS", range(0))
    changed = np.argwhere(np.abs(marked - frame(walk, robot)).sum(axis=-1) > 60)
    # The horizon is above the middle.
    assert len(changed) > 20 and changed[:, 0].min() > 80


def test_numbers_are_on_top(walk, robot):
    before, after = frame(walk, robot, 0)[:40], frame(walk, robot, 9)[:40]
    assert (before < 80).all(axis=-1).sum() > 50 and (before != after).any()


@pytest.mark.parametrize("width", [120, 160, 640])
def test_numbers_fit_a_narrow_picture(walk, robot, monkeypatch, width):
    """They end before the picture's edge; in a wide one they have their full height."""
    monkeypatch.setattr(film, "MARKS", range(0))
    size = (width, 160)
    inked = (frame(walk, robot, 9, size=size) != frame(walk, robot, 9, size=size, words=False)).any(axis=-1)
    columns = np.flatnonzero(inked.any(axis=0))
    assert columns[0] >= 4 and columns[-1] < width - 4 and columns[-1] - columns[0] > min(0.6 * width, 120)


def test_a_picture_may_be_without_words(walk, robot, monkeypatch):
    wordless = frame(walk, robot, words=False)
    assert not (wordless[:40] < 80).all(axis=-1).any()
    # The marks are still there, without their numbers.
    assert (wordless != frame(walk, robot))[80:].any()
    monkeypatch.setattr(film, "MARKS", range(0))
    assert (wordless != frame(walk, robot, words=False))[80:].any()


def test_a_picture_may_be_larger_than_the_mjcfs_framebuffer(walk):
    robot = Robot.from_mjcf("biped")
    buffer = robot.model.vis.global_
    size = buffer.offwidth + 20, buffer.offheight + 10
    assert frame(walk, robot, size=size).std() > 10


@pytest.mark.parametrize("camera", ["side", "three_quarter"])
def test_a_robot_without_cameras_is_seen_too(camera):
    robot = Robot.from_mjcf(ANT)
    still = Walk(robot.standing_qpos[None], np.zeros(1), np.zeros(1), np.zeros(1))
    assert frame(still, robot, camera=camera).std() > 10
    with pytest.raises(ConfigError, match=r"no camera 'behind'; there are track, side, three_quarter"):
        frame(still, robot, camera="behind")


def colours(count, size=(8, 6)):
    return [Image.new("RGB", size, (40 * i, 0, 255 - 40 * i)) for i in range(count)]


def test_a_sheet_fills_row_by_row():
    page = np.asarray(sheet(colours(5), 3))
    assert page.shape == (12, 24, 3)
    assert page[0, 16, 0] == 80 and page[6, 8, 0] == 160 and tuple(page[6, 16]) == (255, 255, 255)


def test_a_gif_reads_back(tmp_path):
    write_animation(tmp_path / "a.gif", iter(colours(5)), 12.5)
    with Image.open(tmp_path / "a.gif") as read:
        assert read.n_frames == 5 and read.info["duration"] == 80 and read.info["loop"] == 0


@pytest.mark.parametrize("size", [(64, 48), (65, 47)])
def test_a_video_reads_back(tmp_path, size):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    write_animation(tmp_path / "a.mp4", iter(colours(6, size)), 25.0)
    frames, seconds = ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))
    assert frames == 6 and seconds == pytest.approx(0.24, abs=0.02)
    call = [ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "a.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    pixels = np.frombuffer(subprocess.run(call, capture_output=True, check=True).stdout, np.uint8)
    even = [side + side % 2 for side in size]
    pixels = pixels.reshape(6, even[1], even[0], 3).astype(int)
    # Colours survive, but for H.264's rounding.
    assert all(np.abs(pixels[i, 0, 0] - [40 * i, 0, 255 - 40 * i]).max() < 16 for i in range(6))


@pytest.mark.parametrize("name", ["a.gif", "a.mp4"])
def test_an_animation_that_breaks_off_leaves_nothing(tmp_path, name):
    def breaks():
        yield from colours(2)
        raise RuntimeError("the walk broke off")

    with pytest.raises(RuntimeError, match="broke off"):
        write_animation(tmp_path / name, breaks(), 25.0)
    assert list(tmp_path.iterdir()) == []


NO_EGL = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}
CODE = "from gctd3.viz.offscreen import find_backend; print(find_backend())"


def backend(**environment):
    """Return the backend that a fresh process without a screen finds."""
    kept = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "DISPLAY")}
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, env=kept | environment)
    return done.stdout.strip() or done.stderr.strip().splitlines()


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="EGL and OSMesa are Linux's")
def test_another_backend_takes_over():
    found = backend(**NO_EGL)
    if found != "osmesa":  # then OSMesa is missing too, and the error says so
        assert any("RenderError: There is no OpenGL" in line and "apt install libegl1" in line for line in found)


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="EGL and OSMesa are Linux's")
def test_no_opengl_says_what_to_install():
    # PyOpenGL, told to use EGL, refuses OSMesa.
    said = "\n".join(backend(**NO_EGL, PYOPENGL_PLATFORM="egl"))
    assert "There is no OpenGL to draw with" in said and "apt install libegl1" in said
    assert "egl: " in said and "osmesa: " in said
    assert "MUJOCO_GL=egl allows no other" in "\n".join(backend(**NO_EGL, MUJOCO_GL="egl"))
