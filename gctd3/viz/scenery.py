"""What a picture needs and a robot's file may lack: something of each body to see, light, and a sky."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

_SHOWN_GROUPS = 3  # MuJoCo draws geoms of groups 0, 1 and 2; files put those for collisions alone into group 3
_INVISIBLE = 0.05  # alpha up to which nothing is to be seen
_GREY = (0.55, 0.57, 0.6, 1.0)
_DEFAULT_COLOUR = np.array([0.5, 0.5, 0.5, 1.0], np.float32)  # with it, a geom shows its material's colour
_DIM = 0.05
_AMBIENT, _DIFFUSE = 0.45, 0.6  # of the light at the camera, where a scene has none
_SHADOWED = 2.0  # half the width of what a directional light's shadows cover, in extents of the model
_SKY = np.array([[148, 185, 222], [236, 242, 250]], np.float32)  # colours at the top and at the bottom


def with_scenery(model: mujoco.MjModel) -> mujoco.MjModel:
    """Copy a model for pictures of it, with something to see of every body that has geoms, and with light.

    Geoms that MuJoCo hides (those for collisions) are shown on bodies that have no others. The copy moves as the model
    does.
    """
    seen, bodies = copy.deepcopy(model), model.geom_bodyid.tolist()
    visible = {bodies[geom] for geom in range(model.ngeom) if _is_shown(model, geom)}
    for geom in range(model.ngeom):
        if bodies[geom] not in visible:
            seen.geom_group[geom] = 0
            if _alpha(model, geom) <= _INVISIBLE:
                seen.geom_matid[geom], seen.geom_rgba[geom] = -1, _GREY
    if not _is_lit(model):
        seen.vis.headlight.active = 1
        seen.vis.headlight.ambient[:] = np.maximum(seen.vis.headlight.ambient, _AMBIENT)
        seen.vis.headlight.diffuse[:] = np.maximum(seen.vis.headlight.diffuse, _DIFFUSE)
    seen.vis.map.shadowclip = max(seen.vis.map.shadowclip, _SHADOWED)
    return seen


def _is_shown(model: mujoco.MjModel, geom: int) -> bool:
    return int(model.geom_group[geom]) < _SHOWN_GROUPS and _alpha(model, geom) > _INVISIBLE


def _alpha(model: mujoco.MjModel, geom: int) -> float:
    material, own = int(model.geom_matid[geom]), model.geom_rgba[geom]
    takes_material = material >= 0 and np.array_equal(own, _DEFAULT_COLOUR)
    return float(model.mat_rgba[material, 3] if takes_material else own[3])


def _is_lit(model: mujoco.MjModel) -> bool:
    """Tell whether a light of the model's own shines."""
    shines = model.light_active.astype(bool) & ((model.light_diffuse + model.light_ambient).max(axis=1) > _DIM)
    return bool(shines.any())


def light_up(scene: mujoco.MjvScene, place: np.ndarray) -> None:
    """Move the directional lights of a scene over a place, shape ``[3]`` (m): their shadows cover some metres only."""
    for light in scene.lights[: scene.nlight]:
        if light.type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL and not light.headlight:
            back = np.linalg.norm(light.pos - place)
            light.pos[:] = place - back * np.asarray(light.dir)


def has_sky(model: mujoco.MjModel) -> bool:
    """Tell whether a model brings a picture of the sky."""
    return bool((model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any())


def paint_sky(pixels: np.ndarray, nothing: np.ndarray) -> None:
    """Draw a sky where nothing else is.

    Args:
        pixels: Picture, shape ``[height, width, 3]``, 0 to 255, which is changed.
        nothing: Where nothing was drawn, shape ``[height, width]``.
    """
    share = np.linspace(0.0, 1.0, len(pixels), dtype=np.float32)[:, None]
    sky = (1.0 - share) * _SKY[0] + share * _SKY[1]
    pixels[nothing] = np.broadcast_to(sky[:, None].astype(np.uint8), pixels.shape)[nothing]
