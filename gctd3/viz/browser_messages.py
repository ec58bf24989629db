"""What a browser may send to the viewer: views of its camera, values that the page's controls can take, and keys."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import msgspec
import viser

_MOST_PIXELS = 100_000  # of a browser's canvas, a side
_POSE = {"wxyz": 4, "position": 3, "look_at": 3, "up_direction": 3}
_LENSES = ("fov", "near", "far")
_CANVAS = ("image_height", "image_width")


class Gate:
    """Decide which of a browser's messages the viewer handles: views of its camera, values of its controls, keys.

    Args:
        control: Function that finds a control or a key by the id that browsers know it by; ``None`` if there is none.
    """

    def __init__(self, control: Callable[[str], object]) -> None:
        self._control = control

    def read(self, frame: str | bytes) -> Mapping[str, object] | None:
        """Read a frame as a message; ``None`` if it is none."""
        if isinstance(frame, str):
            return None
        try:
            message = msgspec.msgpack.decode(frame)
        except (msgspec.DecodeError, RecursionError):
            return None
        return message if isinstance(message, dict) and isinstance(message.get("type"), str) else None

    def is_view(self, message: Mapping[str, object]) -> bool:
        """Tell whether a message is the view of a browser's camera, with all numbers finite."""
        if message["type"] != "ViewerCameraMessage" or message.keys() != {"type", *_POSE, *_LENSES, *_CANVAS}:
            return False
        vectors = [(message[name], size) for name, size in _POSE.items()]
        return (
            all(isinstance(v, list) and len(v) == size and all(map(_is_number, v)) for v, size in vectors)
            and all(_is_number(message[name]) for name in _LENSES)
            and all(isinstance(message[name], int) and _between(message[name], 0, _MOST_PIXELS) for name in _CANVAS)
        )

    def is_value(self, message: Mapping[str, object]) -> bool:
        """Tell whether a message is a new value of a control, of its type, in its range or from its list."""
        updates, uuid = message.get("updates"), message.get("uuid")
        # viser would set any other property too, for everybody.
        if message["type"] != "GuiUpdateMessage" or message.keys() != {"type", "uuid", "updates"}:
            return False
        if not isinstance(uuid, str) or not isinstance(updates, dict) or updates.keys() != {"value"}:
            return False
        return _fits(self._control(uuid), updates["value"])

    def is_key(self, message: Mapping[str, object]) -> bool:
        """Tell whether a message is a press of one of the page's keys."""
        if message["type"] != "CommandTriggerMessage" or message.keys() != {"type", "uuid"}:
            return False
        return isinstance(message["uuid"], str) and isinstance(self._control(message["uuid"]), viser.CommandHandle)


def _fits(control: object, value: object) -> bool:
    if isinstance(control, viser.GuiSliderHandle):
        return _between(value, control.min, control.max)
    if isinstance(control, viser.GuiDropdownHandle):
        return isinstance(value, str) and value in control.options
    return isinstance(control, (viser.GuiButtonHandle, viser.GuiCheckboxHandle)) and isinstance(value, bool)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _between(value: object, low: float, high: float) -> bool:
    return _is_number(value) and low <= value <= high  # type: ignore[operator]
