"""A live walk in a browser: the scene, the controls, the joints' traces and the contacts; viser and mjviser draw it."""

from __future__ import annotations

import functools
import html
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Sequence

import mjviser
import numpy as np
import viser
from viser import uplot

from gctd3.errors import GCTD3Error
from gctd3.evaluation.recorder import total_mass
from gctd3.viz.command_panel import add_command_controls, commanded
from gctd3.viz.film import MARK, MARKS, start_point
from gctd3.viz.live_session import LiveWalk, Moment
from gctd3.viz.scenery import with_scenery
from gctd3.viz.terrain_view import mark_height, name_of, start_of

FRAME = 1 / 30  # between pictures (s)
PLOT = 0.2  # between traces (s)
TRACE = 4.0  # that traces show (s)
REST = 1.0  # between the end of an episode and the next (s)
SPEEDS = (0.05, 2.0)  # slowest and fastest, as multiples of real time
WAITING = 20  # requests of one control that wait to be handled; more are left out
PUSH = 1.0  # change of the whole robot's velocity by the strongest push (m/s)
FASTEST = 10.0  # a robot that moves faster is not pushed (m/s)
FRICTION = (0.05, 1.5)
# Colours of a leg's joints, from the hip down, and of feet.
COLOURS = ("#2f6fb5", "#d9772a", "#6b8f4e", "#8a4fa0", "#b5502f", "#4a4f57")
_CAMERA, _AT = (0.4, -2.3, 0.25), (0.15, 0.0, -0.25)  # position and target, from the body (m)
Listener = Callable[[object], Awaitable[None]]  # to what a browser asks for


class Panel:
    """Show the walk of one policy at a time, until :meth:`run` is interrupted.

    Args:
        server: Server that browsers connect to.
        load: Function that loads a walk by the name of its run.
        runs: Names of the runs to choose from, starting with the first.
        seed: Seed of the first start; every reset adds 1.

    Raises:
        RunError: If the first run cannot be shown.
    """

    def __init__(
        self, server: viser.ViserServer, load: Callable[[str], LiveWalk], runs: Sequence[str], seed: int
    ) -> None:
        self.server, self.runs, self.seed = server, list(runs), seed
        self._load = load
        # Browsers' requests arrive in the server's thread; only the thread that runs the walk may change it.
        self._wishes: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._waiting: Counter[Callable[[], object]] = Counter()
        self._lock = threading.Lock()
        self.paused, self.speed, self._message = False, 1.0, ""
        server.gui.configure_theme(control_layout="collapsible", control_width="large", show_share_button=False)
        self._open(self.runs[0], load(self.runs[0]))

    def run(self) -> None:
        """Walk in real time, times the chosen speed, until an exception is raised."""
        due = shown = plotted = time.perf_counter()
        while True:
            asked = self._grant()
            now = time.perf_counter()
            due = now if self.paused else due
            # A machine that is too slow for real time shows less of it, and does not fall behind.
            due = max(due, now - FRAME * 2)
            while due <= now and not self.paused:
                due += self._advance() / self.speed
            if asked or (not self.paused and now - shown >= FRAME):
                self._show()
                shown = now
            if asked or (not self.paused and now - plotted >= PLOT):
                self._plot()
                plotted = now
            time.sleep(max(0.002, min(FRAME, due - time.perf_counter())) if not self.paused else FRAME)

    def _grant(self) -> bool:
        """Handle the requests of browsers that wait; return whether there were any."""
        waiting = self._wishes.qsize()
        for _ in range(waiting):
            wish = self._wishes.get()
            with self._lock:
                self._waiting[wish] -= 1
                if not self._waiting[wish]:
                    del self._waiting[wish]
            self._attempt(wish)
        return waiting > 0

    def _attempt(self, action: Callable[[], object]) -> None:
        """Change the walk; if that cannot be simulated, say so on the page and start anew."""
        try:
            action()
        except GCTD3Error as error:
            self._message = str(error)
            self._reset()

    def _advance(self) -> float:
        """Take one control step, or start anew; return its duration (s)."""
        live = self.live
        if live.now.done:
            self._reset()
            return live.control_dt
        self._attempt(lambda: self._remember(live.step()))
        return live.control_dt + (REST * self.speed if live.now.done else 0.0)

    def _remember(self, now: Moment) -> None:
        self._trace.append((now.time, *now.angles, *now.feet_down))

    def _reset(self) -> None:
        self.seed += 1
        self._trace.clear()
        if self.live.task.ground is not None:  # the next episode may begin elsewhere
            self._forget_marks()
        self._remember(self.live.reset(self.seed))

    def _forget_marks(self) -> None:
        for handles in self._metres.values():
            for handle in handles:
                handle.remove()
        self._metres.clear()

    # The page.

    def _open(self, run: str, live: LiveWalk) -> None:
        self.shown, self.live = run, live
        self._trace: deque[tuple[float, ...]] = deque(maxlen=round(TRACE / live.control_dt))
        self._remember(live.now)
        self.server.gui.reset()
        self.server.scene.reset()
        self.server.scene.set_up_direction("+z")
        turn = live.robot.base.frame.T
        self.server.initial_camera.position, self.server.initial_camera.look_at = turn @ _CAMERA, turn @ _AT
        self._scene = mjviser.ViserMujocoScene(self.server, with_scenery(live.robot.model), num_envs=1)
        self._scene.show_contact_points = True
        self._origin = start_point(live.robot)
        self._metres: dict[int, tuple[viser.SceneNodeHandle, ...]] = {}
        self._rays: viser.PointCloudHandle | None = None
        self._controls(run)
        self._show()

    def _controls(self, run: str) -> None:
        gui = self.server.gui
        self._status = gui.add_html("")
        pause = gui.add_button("Go on" if self.paused else "Pause")
        step = gui.add_button("Step", hint="One control step while paused")
        reset = gui.add_button("Reset")
        speed = self._slider("Speed", SPEEDS, 0.05, self.speed, "Times real time")
        follow = gui.add_checkbox("Follow", initial_value=True, hint="Keep the camera beside the robot")

        def turn() -> None:
            self.paused = not self.paused
            pause.label = "Go on" if self.paused else "Pause"

        self._on(pause.on_click, turn)
        self._on(step.on_click, lambda: self._advance() if self.paused else None)
        self._on(reset.on_click, self._reset)
        self._on(speed.on_update, lambda: setattr(self, "speed", speed.value))
        self._on(follow.on_update, lambda: setattr(self._scene, "camera_tracking_enabled", follow.value))
        self._choice = gui.add_dropdown("Run", options=self.runs, initial_value=run)
        self._on(self._choice.on_update, lambda: self._choose(self._choice.value))
        add_command_controls(gui, self.live, self._slider, self._on)
        with gui.add_folder("Push and change"):
            self._changes()
        with gui.add_folder("Joints, rad"):
            self._plots = [self._plot_of(leg) for leg in range(len(self.live.robot.legs))]
        with gui.add_folder("Feet on the ground"):
            feet = self.live.robot.feet
            self._contacts = self._add_plot(feet, (-0.2, 1.5 * len(feet)))

    def _changes(self) -> None:
        gui, live = self.server.gui, self.live
        mass = total_mass(live.robot)
        most = float(np.ceil(PUSH * mass))
        impulse = self._slider("Push, N s", (0.0, most), 0.5, most / 4, "How hard; a quarter of the most to begin with")
        ways = {"Push forward": (1.0, 0.0), "Push back": (-1.0, 0.0)}
        if "side" in live.robot.base.coordinates:
            ways |= {"Push left": (0.0, 1.0), "Push right": (0.0, -1.0)}
        for name, way in ways.items():
            self._on(gui.add_button(name).on_click, functools.partial(self._push, impulse, *way))
        friction = self._slider("Friction", FRICTION, 0.05, live.friction, "Of feet and ground")
        payload = self._slider("Payload, kg", (0.0, float(np.ceil(mass))), 0.5, 0.0, "On top of the body's own mass")
        self._on(friction.on_update, lambda: setattr(live, "friction", friction.value))
        self._on(payload.on_update, lambda: setattr(live, "payload", payload.value))

    def _push(self, impulse: viser.GuiInputHandle[float], forward: float, side: float) -> None:
        if self.live.speed < FASTEST:
            self.live.push(forward * impulse.value, side * impulse.value)

    def _slider(
        self, name: str, between: tuple[float, float], step: float, value: float, hint: str
    ) -> viser.GuiInputHandle[float]:
        low, high = between
        begin = float(np.clip(low + round((value - low) / step) * step, low, high))
        return self.server.gui.add_slider(name, min=low, max=high, step=step, initial_value=begin, hint=hint)

    def _on(self, register: Callable[[Listener], object], wish: Callable[[], object]) -> None:
        """Let the walk's own thread call ``wish`` whenever a browser asks for it."""

        # A coroutine, which viser calls in the server's thread: a plain function it puts into a queue without end.
        async def asked(event: object) -> None:
            with self._lock:
                if self._waiting[wish] < WAITING:
                    self._waiting[wish] += 1
                    self._wishes.put(wish)

        register(asked)

    def _choose(self, run: str) -> None:
        if run == self.shown or run not in self.runs:
            return
        try:
            live = self._load(run)
        except Exception as error:  # whatever is wrong with that run, this one goes on
            text = str(error) if isinstance(error, GCTD3Error) else f"{run} cannot be shown: {error!r}"
            self._message, self._choice.value = text, self.shown
            return
        self._message = ""
        self._open(run, live)

    def _plot_of(self, leg: int) -> viser.GuiUplotHandle:
        joints = [joint.name for joint in self.live.robot.legs[leg]]
        ranges = np.clip([self.live.robot.joint(name).range for name in joints], -np.pi, np.pi)
        return self._add_plot(joints, (float(ranges.min()), float(ranges.max())))

    def _add_plot(self, names: Sequence[str], between: tuple[float, float]) -> viser.GuiUplotHandle:
        lines = [uplot.Series(label=name, stroke=COLOURS[i % len(COLOURS)], width=1.5) for i, name in enumerate(names)]
        return self.server.gui.add_uplot(
            (np.zeros(2), *(np.zeros(2) for _ in names)),
            (uplot.Series(label="s"), *lines),
            scales={"x": uplot.Scale(time=False), "y": uplot.Scale(range=between)},
            legend=uplot.Legend(show=True),
            height=150,
        )

    def _show(self) -> None:
        """Show the present robot, the metre marks around it, and the numbers."""
        live, now = self.live, self.live.now
        self._scene.update_from_mjdata(live.show())
        wanted = {metre for step in MARKS if (metre := int(now.position) + step) >= 0}
        for metre in self._metres.keys() - wanted:
            for handle in self._metres.pop(metre):
                handle.remove()
        for metre in wanted - self._metres.keys():
            self._metres[metre] = self._mark(metre)
        self._show_rays(now.rays.astype(np.float32))
        self._status.content = self._words(now)

    def _show_rays(self, points: np.ndarray) -> None:
        if not len(points):
            return
        if self._rays is None:
            # A child of the ground's scene node, as the marks are.
            name, colour = "/fixed_bodies/rays", (217, 46, 38)
            self._rays = self.server.scene.add_point_cloud(name, points, colour, point_size=0.025, point_shape="circle")
        else:
            self._rays.points = points

    def _mark(self, metre: int) -> tuple[viser.SceneNodeHandle, ...]:
        forward, side, up = self.live.robot.base.frame
        start = start_of(self.live.task, self.live.simulation.memory)
        above = mark_height(self.live.task.ground, start + np.array([metre, 0.0]), MARK)
        place = self._origin + start @ self.live.robot.base.frame[:2] + metre * forward + (above + 2e-3) * up
        # Children of the ground's scene node, which moves when the camera follows.
        name, ends = f"/fixed_bodies/metre_{metre}", np.stack([place - 0.6 * side, place + 0.6 * side])
        # A dark line on a wider bright one, so that it is seen on any ground.
        lines = [
            self.server.scene.add_line_segments(f"{name}/{part}", (ends + above * up)[None], colour, thickness=wide)
            for part, above, colour, wide in (("edge", 0.0, (232, 234, 236), 0.032), ("line", 1e-3, (60, 64, 72), 0.02))
        ]
        words = self.server.scene.add_label(f"{name}/words", f"{metre} m", position=place - 0.7 * side)
        return *lines, words

    def _words(self, now: Moment) -> str:
        state = "paused" if self.paused else "reached the finish" if now.success else "ended" if now.done else "walks"
        rows = [
            [("state", state), ("time", f"{now.time:.2f} s")],
            [("distance", f"{now.position:.2f} m"), ("speed", f"{now.velocity:.2f} m/s")],
            [("height", f"{now.height:+.3f} m"), ("reward", f"{now.reward:.2f}")],
            [("return", f"{now.total:.0f}")],
            *([[("ground", ground)]] if (ground := name_of(self.live.task, self.live.simulation.memory)) else []),
            *commanded(now),
        ]
        cells = ["".join(f"<td>{key}</td><td class='{key}'><b>{text}</b></td>" for key, text in row) for row in rows]
        style = "margin: 0 0.6em; border-spacing: 0.7em 0; font-size: 0.85em; font-variant-numeric: tabular-nums"
        table = f"<table id='status' style='{style}'>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"
        return table + (f"<p style='color:#c0392b'>{html.escape(self._message)}</p>" if self._message else "")

    def _plot(self) -> None:
        table = np.array(self._trace, dtype=np.float64)
        if len(table) < 2:
            return
        robot, joints = self.live.robot, [joint.name for joint in self.live.robot.joints]
        for leg, plot in zip(robot.legs, self._plots, strict=True):
            plot.data = (table[:, 0], *(table[:, 1 + joints.index(joint.name)] for joint in leg))
        # The feet's contacts, one above the other.
        feet = table[:, 1 + len(joints) :]
        self._contacts.data = (table[:, 0], *(1.5 * i + feet[:, i] for i in range(feet.shape[1])))
