"""Draw a policy's walk: ``python -m gctd3.render run=DIR out=walk.png``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from omegaconf import DictConfig
from PIL import Image, ImageDraw, ImageFont
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from gctd3.cli import command
from gctd3.envs.dmc import Physics
from gctd3.envs.factory import EnvSettings, build_env
from gctd3.envs.library import LibrarySettings
from gctd3.envs.reward import Reward
from gctd3.errors import ConfigError, RenderError, RunError, check_seed
from gctd3.robot import Robot
from gctd3.settings import build


@dataclass(frozen=True)
class RenderSettings:
    """What ``gctd3.render`` is asked to do.

    Attributes:
        run: Directory of the run; the policy that ships with the library if ``None``.
        out: ``.png`` for a sheet of frames, ``.gif`` for an animation.
        seed: Of the start.
        camera: Of the MJCF.
        width: Of a frame (pixels).
        height: Of a frame (pixels).
        columns: Of the sheet.
        rows: Of the sheet.
        every: Control steps between the sheet's frames.
        begin: Distance at which the sheet begins (m), past the start.
        speed: Of the animation, as a multiple of real time.
    """

    run: str | None
    out: str
    seed: int = 10_000
    camera: str = "side"
    width: int = 320
    height: int = 320
    columns: int = 6
    rows: int = 2
    every: int = 3
    begin: float = 7.0
    speed: float = 1.0

    def __post_init__(self) -> None:
        for name in ("width", "height", "columns", "rows", "every"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)}.")
        check_seed("seed", self.seed)
        if not self.speed > 0:
            raise ConfigError(f"speed must be above 0, got {self.speed}.")
        if Path(self.out).suffix not in (".png", ".gif"):
            raise ConfigError(f"out must end in .png or .gif, got {self.out!r}.")
        folder = Path(self.out).absolute().parent
        if not folder.is_dir():
            raise ConfigError(f"out={self.out}: there is no folder {folder}.")


@dataclass(frozen=True)
class Walk:
    """One episode as the simulator saw it: a row for each control step.

    Attributes:
        qpos: Shape ``[T, nq]``.
        velocity: Forward, shape ``[T]`` (m/s).
        position: Distance walked, shape ``[T]`` (m).
        total: Return so far, shape ``[T]``.
    """

    qpos: np.ndarray
    velocity: np.ndarray
    position: np.ndarray
    total: np.ndarray


def record(policy: TensorDictModuleBase, robot: Robot, settings: EnvSettings, seed: int) -> Walk:
    """One episode of a policy, under the paper's reward."""
    env = build_env(robot, replace(settings, backend="batched", num_envs=1, threads=1), Reward(), seed)
    simulation = env.base_env.simulation
    rows = []
    with torch.random.fork_rng(devices=[]), torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        env.set_seed(seed)
        state, total, done = env.reset(), 0.0, False
        while not done:
            state = env.step(policy(state))
            total += float(state["next", "reward"])
            now = simulation.now
            rows.append((simulation.qpos[0].copy(), float(now.velocity[0]), float(now.position[0]), total))
            done = bool(state["next", "done"])
            state = step_mdp(state)
    qpos, velocity, position, totals = zip(*rows, strict=True)
    return Walk(np.stack(qpos), np.array(velocity), np.array(position), np.array(totals))


def draw(
    walk: Walk, robot: Robot, steps: np.ndarray, camera: str, size: tuple[int, int], dt: float
) -> list[Image.Image]:
    """The frames of ``steps``, each with its time, distance, speed and return.

    Raises:
        ConfigError: If the robot has no such camera.
        RenderError: If there is nothing to draw with.
    """
    model = robot.model
    cameras = [model.camera(i).name for i in range(model.ncam)]
    if camera not in cameras:
        raise ConfigError(f"{robot.path} has no camera {camera!r}; it has {', '.join(cameras)}.")
    # dm_control finds a GL by itself: the screen's, EGL or OSMesa.
    physics, font, frames = Physics.from_xml_path(str(robot.path)), ImageFont.load_default(13), []
    width, height = size
    for step in steps:
        physics.data.qpos[:] = walk.qpos[step]
        physics.forward()
        try:
            frame = Image.fromarray(physics.render(height, width, camera_id=camera))
        except (RuntimeError, ImportError) as error:
            raise RenderError(
                f"Nothing to draw with ({error}): this needs a screen, EGL or OSMesa; "
                "Debian's packages libegl1 or libosmesa6 bring one."
            ) from error
        text = (
            f"{(step + 1) * dt:.2f} s   {walk.position[step]:.2f} m\n"
            f"{walk.velocity[step]:.2f} m/s   return {walk.total[step]:.0f}"
        )
        ImageDraw.Draw(frame).text((8, 6), text, fill=(30, 30, 30), font=font)
        frames.append(frame)
    return frames


def sheet(frames: list[Image.Image], columns: int) -> Image.Image:
    """The frames in rows of ``columns``."""
    width, height = frames[0].size
    rows = -(-len(frames) // columns)
    page = Image.new("RGB", (columns * width, rows * height), "white")
    for i, frame in enumerate(frames):
        page.paste(frame, (i % columns * width, i // columns * height))
    return page


def render_run(settings: RenderSettings) -> Path:
    """Draw the best policy of a run.

    Returns:
        The file written.
    """
    from gctd3.checkpoint import load_policy
    from gctd3.run_config import find_run, load_settings

    run = find_run(settings.run)
    trained = load_settings(run)
    if isinstance(trained.env, LibrarySettings):
        raise RunError(f"{run} was trained on {trained.env.task}: render draws the walking task only.")
    robot = trained.load_robot()
    walk = record(load_policy(run), robot, trained.env, settings.seed)
    dt, out, size = trained.env.control_dt, Path(settings.out), (settings.width, settings.height)
    if out.suffix == ".gif":
        # GIF players show 25 frames a second well, 50 badly.
        stride = max(1, round(settings.speed / 25 / dt))
        frames = draw(walk, robot, np.arange(0, len(walk.qpos), stride), settings.camera, size, dt)
        frames[0].save(
            out, save_all=True, append_images=frames[1:], duration=int(1000 * stride * dt / settings.speed), loop=0
        )
        return out
    first = int(np.argmax(walk.position >= min(settings.begin, walk.position[-1] / 2)))
    steps = first + settings.every * np.arange(settings.columns * settings.rows)
    frames = draw(walk, robot, steps[steps < len(walk.qpos)], settings.camera, size, dt)
    sheet(frames, settings.columns).save(out)
    return out


def _task(config: DictConfig) -> None:
    print(f"Written to {render_run(build(config))}")


def main() -> None:
    """Entry point of ``python -m gctd3.render``."""
    command("render", _task)


if __name__ == "__main__":
    main()
