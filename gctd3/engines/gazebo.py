"""Gazebo's own physics library, ignition-physics with DART, in a process of its own: see gazebo.cpp."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import tempfile
import weakref
from typing import IO, ClassVar
from xml.etree import ElementTree

import numpy as np

from gctd3.engines.engine import OtherEngine, Pose, ground_friction
from gctd3.engines.gazebo_program import plugin, program
from gctd3.errors import EngineError, RobotError
from gctd3.files import write_text
from gctd3.robots.draft import listed
from gctd3.robots.unsaid import Format

_ROUGH = 1e3  # friction of the ground: of two the library takes the smaller
_SIDE = 400.0  # m of the ground
_PATIENCE = 60.0  # s that an answer may take
_COLOUR = re.compile("\x1b\\[[0-9;]*m")
_BASE = 18  # numbers of a base: origin, rotation matrix by rows, velocity, angular velocity


class Gazebo(OtherEngine):
    """Simulate a robot in Gazebo's physics library, in a process of its own."""

    name: ClassVar[str] = "gazebo"
    form: ClassVar[Format] = "sdf"

    def open(self) -> None:
        """Write the world around the SDF, and start the program with it.

        Raises:
            RobotError: If a mesh may collide, or a name has "::", which SDF keeps for itself.
            EngineError: If the program cannot be compiled, or does not begin.
        """
        meshes = [link.name for link in self.links.links if any(s.collides and s.mesh >= 0 for s in link.solids)]
        if meshes:
            raise RobotError(
                f"{self.robot.path}: the shapes of {listed(meshes)} that collide are meshes, which Gazebo's library "
                "does not read from an SDF; engine=dart and engine=bullet read them."
            )
        scoped = [name for name in (*self.joints, *(link.name for link in self.links.links)) if "::" in name]
        if scoped:
            raise RobotError(f"{self.robot.path}: an SDF cannot have the names {listed(scoped)}, for their '::'.")
        world = self.file.with_name("world.sdf")
        write_text(world, self._world(self.file.read_text(encoding="utf-8")))
        self._names = tuple(link.name for link in self.links.links)
        free = self.free is not None
        arguments = [plugin(), world, self.timestep, int(free), len(self.joints), *self.joints, *self._names]
        self._wide = 2 * len(self.joints) + (_BASE if free else 0) + len(self._names)
        made = program(self.file.parent)
        # What the program says.
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the engine
        weakref.finalize(self, self._log.close)
        self._process = subprocess.Popen(
            [str(made), *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            bufsize=0,
            # The libraries keep logs at home.
            env={**os.environ, "HOME": str(self.file.parent)},
        )
        weakref.finalize(self, _end, self._process)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._to: IO[bytes] = self._process.stdin
        self._from: IO[bytes] = self._process.stdout
        self._ready = select.poll()
        self._ready.register(self._from, select.POLLIN)
        self._state = self._answer()

    def put(self, angles: np.ndarray, rates: np.ndarray, base: Pose | None) -> None:
        """Put joints ``[J]`` (rad, m) with their velocities, and a free base, where they are asked for.

        Raises:
            EngineError: If the program has ended, or does not answer.
        """
        own = [] if base is None else [base.place, base.turn.ravel(), base.velocity, base.rate]
        self._ask(b"p", np.concatenate([angles, rates, *own]))

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the joints' angles (rad, m) and velocities (rad/s, m/s), each ``[J]``, as last told."""
        count = len(self.joints)
        return self._state[:count], self._state[count : 2 * count]

    def read_base(self) -> Pose:
        """Return the state of a free base, as the program told it last."""
        numbers = self._state[2 * len(self.joints) :]
        return Pose(numbers[:3], numbers[3:12].reshape(3, 3), numbers[12:15], numbers[15:18])

    def step(self, torque: np.ndarray) -> None:
        """Take a step of the physics with torques (forces) ``[J]`` at the joints (N m, N).

        Raises:
            EngineError: If the program has ended, or does not answer.
        """
        self._ask(b"s", torque)

    def touching(self) -> frozenset[str]:
        """Return the names of the bodies that touch the ground."""
        down = self._state[-len(self._names) :]
        return frozenset(name for name, touches in zip(self._names, down, strict=True) if touches)

    def _world(self, robot: str) -> str:
        """Return the SDF of a world with the robot, of its SDF, and the ground."""
        root = ElementTree.fromstring(robot)
        model = root.find("model")
        assert model is not None
        root.remove(model)
        model.set("name", "robot")
        for joint in model.iter("joint"):
            axis, name = joint.find("axis"), joint.get("name")
            if axis is None:
                continue
            # Efforts are those of servos, and the library would clip the joint's damping with them.
            for effort in axis.findall("limit/effort"):
                effort.text = "-1"
            if name in self.joints:
                friction = float(self.friction[self.joints.index(name)])
                ElementTree.SubElement(ElementTree.SubElement(axis, "dynamics"), "friction").text = repr(friction)
        surfaces = ground_friction(self.robot)
        for link in model.iter("link"):
            for number in (*link.iter("mu"), *link.iter("mu2")):
                number.text = repr(surfaces.get(link.get("name", ""), 1.0))
        world = ElementTree.SubElement(root, "world", name="flat")
        gravity = self.robot.model.opt.gravity.tolist()
        ElementTree.SubElement(world, "gravity").text = " ".join(map(repr, gravity))
        world.append(ElementTree.fromstring(_GROUND))
        world.append(model)
        return ElementTree.tostring(root, encoding="unicode")

    def _ask(self, letter: bytes, numbers: np.ndarray) -> None:
        try:
            self._to.write(letter + numbers.astype(np.float64).tobytes())
        except BrokenPipeError:
            raise self._ended() from None
        self._state = self._answer()

    def _answer(self) -> np.ndarray:
        """Return the numbers of an answer."""
        wanted, answer = 8 * self._wide, b""
        while len(answer) < wanted:
            if not self._ready.poll(1000 * _PATIENCE):
                self._process.kill()
                raise EngineError(f"Gazebo's physics library has not answered for {_PATIENCE:g} s.")
            part = self._from.read(wanted - len(answer))
            if not part:
                raise self._ended()
            answer += part
        return np.frombuffer(answer)

    def _ended(self) -> EngineError:
        """Return the error of a program that has ended, with the last line that it wrote."""
        code = _wait(self._process)
        self._log.seek(0)
        lines = _COLOUR.sub("", self._log.read().decode("utf-8", "replace")).splitlines()
        # Its profiler complains that it gets no port, see gazebo.cpp.
        said = [" ".join(line.split()) for line in lines if line.strip() and "Remotery" not in line]
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        why = f": {said[-1].rstrip('.')}" if said else ""
        return EngineError(f"Gazebo's physics library has ended {how}{why}.")


_GROUND = f"""<model name="ground"><static>true</static><link name="link"><collision name="plane">
<geometry><plane><normal>0 0 1</normal><size>{_SIDE} {_SIDE}</size></plane></geometry>
<surface><friction><ode><mu>{_ROUGH}</mu><mu2>{_ROUGH}</mu2></ode></friction></surface></collision></link></model>"""


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the program: it leaves when its input ends."""
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    _wait(process)


def _wait(process: subprocess.Popen[bytes]) -> int:
    """Return the exit code of a program that is about to end, and is killed if it does not."""
    try:
        return process.wait(5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()
