"""A walk as pictures: frames with marks on the floor and numbers on top, as a sheet, an animation or a video."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from tensordict.nn import TensorDictModuleBase

from gctd3.errors import ConfigError, RenderError
from gctd3.files import new_file
from gctd3.robots.geometry import lowest_point
from gctd3.robots.robot import Robot
from gctd3.tasks.ground import Ground
from gctd3.tasks.jump_memory import jumped
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.viz.live_session import LiveWalk, Moment, foot_geoms
from gctd3.viz.offscreen import Canvas, find_backend
from gctd3.viz.scenery import light_up
from gctd3.viz.terrain_view import draw_rays, mark_height, name_of, start_of

FPS = 25  # GIF players show 25 frames a second well, 50 badly
# Views of a robot whose MJCF names no such camera: azimuth from its forward axis, elevation (degrees).
VIEWS = {"side": (90.0, -8.0), "three_quarter": (130.0, -18.0)}
CLIP, CLIP_SIZE = 5.0, (320, 240)  # of a training's policies (s; pixels)
MARK = 0.6  # half the length of a mark (m)
MARKS = range(-3, 8)  # metres that are marked, from the last one walked
LARGEST, SMALLEST, LEFT = 13, 7, 8  # of the numbers on top, which fit the picture's width: heights, margin (pixels)
_INK, _PAPER = (30, 30, 30), (255, 255, 255)  # of the numbers, and around them: readable on any ground
_PAINT, _EDGE = (np.array(colour, np.float32) for colour in ([0.25, 0.27, 0.30, 1.0], [0.9, 0.91, 0.92, 1.0]))


@dataclass(frozen=True)
class Walk:
    """Hold one simulated episode, a row for each control step.

    Attributes:
        qpos: Generalised positions, shape ``[T, nq]``.
        velocity: Forward velocity, shape ``[T]`` (m/s).
        position: Distance walked, shape ``[T]`` (m).
        reward: Reward of the step, shape ``[T]``.
        rays: Where the rays of height scans meet the terrain, shape ``[T, K, 3]`` (m); ``None`` without terrain.
        origin: Place on the terrain from which distance counts, shape ``[2]`` (m).
        ground: The terrain; ``None`` for a plane.
        words: Kind and level of the terrain, and the commanded height of a jump, in words.
    """

    qpos: np.ndarray
    velocity: np.ndarray
    position: np.ndarray
    reward: np.ndarray
    rays: np.ndarray | None = None
    origin: np.ndarray = field(default_factory=lambda: np.zeros(2))
    ground: Ground | None = None
    words: str = ""

    @property
    def total(self) -> np.ndarray:
        """Return the cumulative reward after each step, shape ``[T]``."""
        return np.cumsum(self.reward)


def record(policy: TensorDictModuleBase, task: SimulatedTask, seed: int, most_steps: int | None = None) -> Walk:
    """Record one episode of a policy, or its first ``most_steps`` control steps."""
    live = LiveWalk(policy, task, seed)
    rows: list[Moment] = []
    memory = live.simulation.memory
    jump = jumped(memory)
    asked = "" if jump is None else f"asked for {jump[0, 0]:.2f} m"
    origin, words = start_of(task, memory), "   ".join(filter(None, (name_of(task, memory), asked)))
    while not live.now.done and (most_steps is None or len(rows) < most_steps):
        rows.append(live.step())
    return Walk(
        np.stack([row.qpos for row in rows]),
        np.array([row.velocity for row in rows]),
        np.array([row.position for row in rows]),
        np.array([row.reward for row in rows]),
        np.stack([row.rays for row in rows]),
        origin,
        task.ground,
        words,
    )


def check_camera(robot: Robot, camera: str) -> None:
    """Raise a :class:`.ConfigError` unless the robot can be seen from ``camera``."""
    cameras = [robot.model.camera(i).name for i in range(robot.model.ncam)]
    if camera not in cameras and camera not in VIEWS:
        known = ", ".join(dict.fromkeys([*cameras, *VIEWS]))
        raise ConfigError(f"{robot.path} has no camera {camera!r}; there are {known}.")


def draw(
    walk: Walk,
    robot: Robot,
    steps: Sequence[int] | np.ndarray,
    camera: str,
    size: tuple[int, int],
    dt: float,
    words: bool = True,
) -> Iterator[Image.Image]:
    """Draw the frames of ``steps``, each with its time, distance, speed, reward and return, and a mark at every metre.

    Args:
        walk: The walk from :func:`record`.
        robot: The robot of the walk.
        steps: Rows of the walk.
        camera: A camera of the MJCF, or one of :data:`VIEWS`.
        size: Width and height (pixels).
        dt: Control period (s).
        words: Whether to draw numbers, those of the marks too.

    Raises:
        ConfigError: If the robot has no such camera.
        RenderError: If no OpenGL backend works.
    """
    check_camera(robot, camera)
    model, data = robot.model, mujoco.MjData(robot.model)
    origin = start_point(robot) + walk.origin @ robot.base.frame[:2]
    texts = [_numbers(walk, step, dt) for step in steps] if words else []
    font = _font(texts, size[0] - 2 * LEFT)
    with Canvas(model, *size) as canvas:
        for number, step in enumerate(steps):
            data.qpos[:] = walk.qpos[step]
            mujoco.mj_forward(model, data)
            canvas.look(data, _camera(robot, data, camera))
            light_up(canvas.scene, data.subtree_com[robot.base.root])
            for metre in MARKS:
                place = int(walk.position[step]) + metre
                above = mark_height(walk.ground, walk.origin + np.array([place, 0.0]), MARK)
                _mark(canvas.scene, robot, origin + np.array([0.0, 0.0, above]), place, words)
            if walk.rays is not None:
                draw_rays(canvas.scene, walk.rays[step])
            frame = Image.fromarray(canvas.draw())
            if words:
                ink = ImageDraw.Draw(frame)
                ink.text((LEFT, 6), texts[number], fill=_INK, font=font, stroke_width=2, stroke_fill=_PAPER)
            yield frame


def _numbers(walk: Walk, step: int, dt: float) -> str:
    return (
        f"{(step + 1) * dt:.2f} s   {walk.position[step]:.2f} m   {walk.velocity[step]:.2f} m/s\n"
        f"reward {walk.reward[step]:.2f}   return {walk.total[step]:.0f}" + (f"\n{walk.words}" if walk.words else "")
    )


def _font(texts: Iterable[str], width: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return the font in which all lines of all texts fit into a width (pixels), the smallest if none does."""
    lines = {line for text in texts for line in text.splitlines()}
    for points in range(LARGEST, SMALLEST, -1):
        font = ImageFont.load_default(points)
        if all(font.getlength(line) <= width for line in lines):
            return font
    return ImageFont.load_default(SMALLEST)


def start_point(robot: Robot) -> np.ndarray:
    """Return the point of the ground from which distance is measured, shape ``[3]`` (m)."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(robot.model, data)
    feet, root = foot_geoms(robot), data.xpos[robot.base.root]
    return np.array([root[0], root[1], lowest_point(robot.model, data, feet) if feet else 0.0])


def _mark(scene: mujoco.MjvScene, robot: Robot, origin: np.ndarray, metre: int, words: bool) -> None:
    """Draw a line across the way, with its distance from the start if ``words`` is set."""
    if metre < 0 or scene.ngeom + 3 > scene.maxgeom:
        return
    forward, side, up = robot.base.frame
    # A millimetre above the ground, or the two would flicker.
    place, turn = origin + metre * forward + 1e-3 * up, np.stack([forward, side, up], axis=1)
    half = np.array([0.01 if metre % 5 else 0.025, MARK, 5e-4])
    # A dark line on a wider bright one, so that it is seen on any ground.
    for more, above, colour in ((0.012, 0.0, _EDGE), (0.0, 1e-3, _PAINT)):
        line, size = scene.geoms[scene.ngeom], half + np.array([more, more, 0.0])
        mujoco.mjv_initGeom(line, mujoco.mjtGeom.mjGEOM_BOX, size, place + above * up, turn.ravel(), colour)
        scene.ngeom += 1
    if words:
        label = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(label, mujoco.mjtGeom.mjGEOM_LABEL, half, place - half[1] * side, turn.ravel(), _PAINT)
        label.label = f"{metre} m"
        scene.ngeom += 1


def _camera(robot: Robot, data: mujoco.MjData, name: str) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    for i in range(robot.model.ncam):
        if robot.model.camera(i).name == name:
            camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, i
            return camera
    forward = robot.base.frame[0]
    camera.type, camera.distance = mujoco.mjtCamera.mjCAMERA_FREE, 2.0 * robot.model.stat.extent
    azimuth, camera.elevation = VIEWS[name]
    camera.azimuth = azimuth + np.degrees(np.arctan2(forward[1], forward[0]))
    camera.lookat[:] = data.subtree_com[robot.base.root]
    return camera


def sheet(frames: Sequence[Image.Image], columns: int) -> Image.Image:
    """Place the frames on one image, in rows of ``columns``."""
    width, height = frames[0].size
    rows = -(-len(frames) // columns)
    page = Image.new("RGB", (columns * width, rows * height), "white")
    for i, frame in enumerate(frames):
        page.paste(frame, (i % columns * width, i // columns * height))
    return page


def stride(speed: float, dt: float) -> int:
    """Return the number of control steps between frames of an animation at ``speed`` times real time."""
    return max(1, round(speed / FPS / dt))


def clip(policy: TensorDictModuleBase, task: SimulatedTask, seed: int) -> list[Image.Image]:
    """Render the first :data:`CLIP` seconds of a policy's walk, :data:`FPS` frames a second in real time."""
    dt = task.control_dt
    walk = record(policy, task, seed, round(CLIP / dt))
    return list(draw(walk, task.stage, np.arange(0, len(walk.qpos), stride(1.0, dt)), "side", CLIP_SIZE, dt))


def check_film() -> None:
    """Raise a :class:`.RenderError` unless videos can be drawn and written here."""
    check_video()
    find_backend()


def check_video() -> None:
    """Raise a :class:`.RenderError` unless the package that writes videos is installed."""
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        raise RenderError("Videos need imageio-ffmpeg: pip install 'gctd3[video]'.")


def write_animation(path: Path, frames: Iterator[Image.Image], fps: float) -> None:
    """Write frames as a ``.gif`` or as a ``.mp4`` (H.264), which appears only once it is complete.

    Raises:
        RenderError: If the package for videos is missing, or ffmpeg fails.
    """
    with new_file(path) as aside:
        if path.suffix == ".mp4":
            check_video()
            _write_mp4(aside, frames, fps)
        else:
            aside.write_bytes(gif(frames, fps))
        with aside.open("rb") as written:
            os.fsync(written.fileno())


def gif(frames: Iterable[Image.Image], fps: float) -> bytes:
    """Encode frames as an animated GIF that repeats."""
    first, *more = frames
    file = io.BytesIO()
    first.save(file, format="GIF", save_all=True, append_images=more, duration=round(1000 / fps), loop=0)
    return file.getvalue()


def _write_mp4(path: Path, frames: Iterator[Image.Image], fps: float) -> None:
    import imageio_ffmpeg

    first = next(frames)
    # H.264 takes even sizes only.
    even = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-f", "mp4"]
    writer = imageio_ffmpeg.write_frames(
        str(path), first.size, fps=fps, codec="libx264", macro_block_size=1, output_params=even
    )
    try:
        with contextlib.closing(writer):
            writer.send(None)
            writer.send(first.tobytes())
            for frame in frames:
                writer.send(frame.tobytes())
    except OSError as error:
        raise RenderError(f"ffmpeg could not write {path.name}: {error}") from error
