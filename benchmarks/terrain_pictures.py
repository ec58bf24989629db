"""Pictures of a robot on each kind of terrain, with the rays of its height scan: docs/terrain.png.

    python benchmarks/terrain_pictures.py [out=terrain.png] [robot=quadruped] [place=2.4]

The robot is held in its standing pose with its feet about on the ground, ``place`` metres after the start.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from common import options
from PIL import Image

from gctd3.files import new_file
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.height_scan import HeightScan
from gctd3.tasks.terrain import Terrain, TerrainKind
from gctd3.tasks.terrain_kinds import Boxes, Gaps, RoughGround, Slopes, Stairs, SteppingStones
from gctd3.tasks.walk import WalkSettings
from gctd3.viz.film import Walk, draw, sheet
from gctd3.viz.terrain_view import name_of, ray_points

KINDS: dict[str, TerrainKind] = {
    "rough": RoughGround(),
    "slopes": Slopes(),
    "stairs": Stairs(),
    "gaps": Gaps(),
    "stones": SteppingStones(),
    "boxes": Boxes(share=0.25),
}
SIZE, COLUMNS = (420, 320), 3


def picture(robot: str, name: str, place: float) -> Image.Image:
    """Draw the robot on one kind of ground."""
    base = WalkSettings()
    terrain = Terrain(kinds={name: KINDS[name]}, levels=1)
    features = {**base.features, "scan": HeightScan(noise=0.0)}
    task = replace(base, terrain=terrain, features=features).build(RobotSettings(robot))
    ground, model, spot = task.ground, task.robot.model, task.ground.first((1,))
    qpos = task.put(task.robot.standing_qpos.copy(), {key: values[0] for key, values in spot.items()})
    # Above the highest ground under the feet, then down to the first contact.
    start = spot["terrain.origin"][0] + np.array([place, 0.0])
    qpos[:3] += place * task.robot.base.frame[0]
    qpos[task.robot.vertical] += ground.level(start + ground.feet).max()
    data = mujoco.MjData(task.stage.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(task.stage.model, data)
    now = task.measure(qpos[None], np.zeros((1, model.nv)), data.sensordata[None], spot)
    memory = task.begin(now, spot=spot)
    still = np.zeros(1)
    walk = Walk(
        qpos[None],
        still,
        np.full(1, place),
        still,
        ray_points(task, now, memory)[None],
        spot["terrain.origin"][0],
        ground,
        name_of(task, memory),
    )
    return next(iter(draw(walk, task.stage, [0], "three_quarter", SIZE, task.control_dt, words=False)))


def main() -> None:
    """Draw all kinds on a sheet."""
    given = options(out="terrain.png", robot="quadruped", place="2.4")
    frames = [picture(given["robot"], name, float(given["place"])) for name in KINDS]
    with new_file(Path(given["out"])) as aside, aside.open("wb") as file:
        sheet(frames, COLUMNS).save(file, format="PNG")


if __name__ == "__main__":
    main()
