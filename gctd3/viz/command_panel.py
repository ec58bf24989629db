"""Controls of the commanded velocity in the browser: sliders, keys, and what the robot makes of it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from gctd3.viz.live_session import LiveWalk, Moment

# Axes of a command: name and unit of the slider, and the keys for more and for less.
AXES = (("Forward, m/s", ("W", "S")), ("To the left, m/s", ("A", "D")), ("Turn left, rad/s", ("Q", "E")))
STOP = "X"
STEPS = 10  # presses of a key from one end of a range to the other
Slider = Callable[[str, tuple[float, float], float, float, str], viser.GuiInputHandle[float]]
Register = Callable[[Any, Callable[[], object]], None]


def add_command_controls(gui: viser.GuiApi, live: LiveWalk, slider: Slider, on: Register) -> None:
    """Add a slider and two keys for each axis along which the robot can be steered, and one to stand still.

    Args:
        gui: The page's controls.
        live: The walk; without commands nothing is added.
        slider: Function that adds a slider: name, range, step, value, hint.
        on: Function that registers a wish with a control.
    """
    if not live.ranges:
        return
    command = np.zeros(3) if live.asked is None else live.asked
    with gui.add_folder("Command"):
        sliders = {}
        for axis, (low, high) in live.ranges.items():
            name, (more, less) = AXES[axis]
            hint = f"{more} for more, {less} for less, {STOP} to stand"
            sliders[axis] = slider(name, (low, high), (high - low) / 100, float(command[axis]), hint)
        stop = gui.add_button("Stand still")

    def order() -> None:
        wanted = np.zeros(3)
        for axis, one in sliders.items():
            wanted[axis] = one.value
        live.steer(wanted)

    def press(axis: int, way: float) -> None:
        low, high = live.ranges[axis]
        place = np.clip(sliders[axis].value + way * (high - low) / STEPS, low, high)
        # Forwards from backwards passes through standing.
        step = (high - low) / (2 * STEPS)
        sliders[axis].value = 0.0 if abs(place) < step * (1 - 1e-9) else float(place)
        order()

    def stand() -> None:
        for axis, one in sliders.items():
            low, high = live.ranges[axis]
            one.value = float(np.clip(0.0, low, high))
        order()

    for axis, one in sliders.items():
        on(one.on_update, order)
        name, keys = AXES[axis]
        for key, way in zip(keys, (1.0, -1.0), strict=True):
            words = f"{name.partition(',')[0]}, {'more' if way > 0 else 'less'}"
            on(gui.add_command(words, hotkey=key).on_trigger, functools.partial(press, axis, way))
    on(stop.on_click, stand)
    on(gui.add_command("Stand still", hotkey=STOP).on_trigger, stand)


def commanded(now: Moment) -> list[list[tuple[str, str]]]:
    """Return rows of the status: the command, and the robot's velocities; none for a task without commands."""
    if now.command is None or now.moved is None:
        return []
    units = ("m/s", "m/s", "rad/s")
    words = [
        ", ".join(f"{value:+.2f} {unit}" for value, unit in zip(values, units, strict=True))
        for values in (now.command, now.moved)
    ]
    return [[("command", words[0])], [("follows", words[1])]]
