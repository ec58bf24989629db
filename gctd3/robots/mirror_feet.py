"""Mirror images of feet: by the joints that they hang on, by their places, and by their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gctd3.robots.mirror_pairs import Plane, swap_side

_EQUAL = 0.1  # of the distance between feet: among feet on one part as near as that, names decide


def pair_feet(
    feet: Sequence[str], places: np.ndarray, ends: Sequence[str | None], images: Mapping[str, str], plane: Plane
) -> tuple[int, ...]:
    """Find for each foot the index of its mirror image; its own index if that is no foot.

    The joints that two such feet hang on mirror each other; of several feet on one part the nearest to the reflected
    place counts, and names decide among equals.

    Args:
        feet: Names of the feet.
        places: Places of the feet in the standing pose, shape ``[feet, 3]`` (m).
        ends: Name of the joint that each foot hangs on, ``None`` for a foot on no joint.
        images: The mirror image of each joint.
        plane: The sagittal plane.
    """
    mirrored = [images[end] if end is not None else None for end in ends]
    away = np.linalg.norm(plane.place(places)[:, None] - places[None], axis=-1)
    ranked = []
    for i, foot in enumerate(feet):
        other = swap_side(foot, feet)
        for k in range(i, len(feet)):
            # A joint that is its own image keeps its feet, unless two of them are a pair by their names.
            named = feet[k] == other and k != i
            if mirrored[i] == ends[k]:
                equal = _EQUAL * float(np.ptp(places, axis=0).max()) if named else 0.0
                ranked.append((float(away[i, k]) - equal, i, k))
    order = list(range(len(feet)))
    paired: set[int] = set()
    for _, i, k in sorted(ranked):
        if not {i, k} & paired:
            order[i], order[k] = k, i
            paired |= {i, k}
    return tuple(order)
