"""Where a robot whose file is completed stands: its key, and its feet, named or else the ends of legs on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from gctd3.errors import RobotError, suggest
from gctd3.robots.draft import Draft, listed
from gctd3.robots.foot_bodies import foot_geoms
from gctd3.robots.ground import can_collide, contact_sensors, geoms_of
from gctd3.robots.mjcf import bodies_below, body_name
from gctd3.robots.pose_limits import clipped
from gctd3.robots.stance import below_feet, leg_ends, like_legs, stance
from gctd3.robots.standing_key import choose_key

if TYPE_CHECKING:
    from gctd3.robots.settings import RobotSettings


def choose_feet(
    draft: Draft, settings: RobotSettings, floor: int
) -> tuple[dict[str, np.ndarray] | None, str | None, list[str], list[list[int]]]:
    """Choose the key in which the robot stands, and its feet.

    Returns:
        The pose by the joints' names and the key's name, ``None`` without one; the feet's bodies; and for each the
        geoms that become a body of their own.
    """
    model, root = draft.model, draft.root
    ends = leg_ends(model, root, floor)
    named = _named_feet(draft, settings.feet, floor) if settings.feet is not None else None
    if named is not None:
        ends = list(dict.fromkeys(body for body, _ in named))
    if not ends:
        raise RobotError(f"{draft.file} has no foot: no leg ends in a body with a geom that can touch the ground.")
    chosen = choose_key(draft, settings.pose, floor, ends, named is not None)
    if chosen is not None:
        key, qpos = chosen
    else:
        key, qpos = None, _reference(draft)
    stood = stance(model, root, floor, qpos, ends)
    feet = ends if named is not None else list(stood.feet)
    if named is None and key is None:
        feet = like_legs(model, root, ends, feet)
    if not feet:
        raise RobotError(
            f"{draft.file}: none of {listed([body_name(model, body) for body in ends])} reaches the ground in the pose "
            "in which the robot stands."
        )
    sensed = contact_sensors(model, root)
    split: list[list[int]] = []
    for body in feet:
        named_geoms = [geom for other, geoms in named or [] if other == body for geom in geoms]
        alone = body_name(model, body) in sensed and not named_geoms
        parts = named_geoms or ([] if alone or named else foot_geoms(model, body, floor, qpos, stood.height))
        split.append(parts)
    names = [body_name(model, body) for body in feet]
    return (None if chosen is None else draft.pose_of(qpos)), key, names, split


def _named_feet(draft: Draft, names: str | Sequence[str], floor: int) -> list[tuple[int, list[int]]]:
    """Return the body of each foot that is named by body, geom or site, and its geoms if it is but a part of it."""
    model = draft.model
    bodies = {body_name(model, b): b for b in bodies_below(model, draft.root)}
    inside = set(bodies.values())
    geoms = {model.geom(g).name: g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in inside}
    sites = {model.site(s).name: s for s in range(model.nsite) if int(model.site_bodyid[s]) in inside}
    feet: list[tuple[int, list[int]]] = []
    for name in [names] if isinstance(names, str) else names:
        if name in bodies:
            feet.append((bodies[name], []))
            continue
        if name not in geoms and name not in sites:
            raise RobotError(
                f"{draft.file} has no body, geom or site {name!r}.{suggest(name, [*bodies, *geoms, *sites])} "
                f"Its bodies are {', '.join(bodies)}."
            )
        body = int(model.geom_bodyid[geoms[name]] if name in geoms else model.site_bodyid[sites[name]])
        able = [g for g in geoms_of(model, body) if can_collide(model, g, floor)]
        if name in geoms:
            part = geoms[name]
        else:
            part = min(able, key=lambda g: float(np.linalg.norm(model.geom_pos[g] - model.site_pos[sites[name]])))
        feet.append((body, [part] if part in able and len(able) > 1 else []))
    if not feet:
        raise RobotError(f"{draft.file}: feet must name at least one body, got none.")
    return feet


def check_feet(draft: Draft, feet: Sequence[str], qpos: np.ndarray, floor: int) -> None:
    """Raise a :class:`.RobotError` if the robot would stand on other parts than the feet that are named."""
    model = draft.model
    below = below_feet(model, draft.root, floor, qpos, [draft.body_id(name) for name in feet])
    if below is not None:
        raise RobotError(
            f"{draft.file}: the feet {listed(list(feet))} do not reach the ground: in the standing pose "
            f"{body_name(model, below[0])} is {below[1]:.2g} m lower."
        )


def _reference(draft: Draft) -> np.ndarray:
    """Return the reference pose of the file with its joints in their ranges, shape ``[nq]``."""
    return clipped(draft.model, draft.model.qpos0, draft.joints())[0]
