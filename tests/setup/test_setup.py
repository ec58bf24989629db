"""A training compiles its robot once, and builds its graph once."""

import mujoco
import pytest
from running import Recorded, command, tiny
from thinned import parametrize

from gctd3.robots import load as load_module
from gctd3.robots.graph import KinematicGraph

FROM_ROBOT = KinematicGraph.from_robot.__func__


@pytest.fixture
def seen(monkeypatch):
    """Record which files are read and compiled, and over which robots graphs are built, in order."""
    found = []

    def find(settings):
        found.append(f"read {settings.name}")
        return read(settings)

    def compiled(spec):
        found.append("compile")
        return from_spec(spec)

    def build(cls, *arguments, **named):
        found.append("graph")
        return FROM_ROBOT(cls, *arguments, **named)

    read, from_spec = load_module.find_source, mujoco.MjSpec.compile
    monkeypatch.setattr(load_module, "find_source", find)
    monkeypatch.setattr(mujoco.MjSpec, "compile", compiled)
    monkeypatch.setattr(KinematicGraph, "from_robot", classmethod(build))
    return found


@parametrize(2, "backend", ["batched", "dm_control"])
def test_the_robot_is_compiled_once_and_its_graph_built_once(tmp_path, seen, backend):
    before_the_first_step = []

    class Watched(Recorded):
        def run(self, stop=None):
            before_the_first_step.extend(seen)
            return super().run(stop)

    # Networks that know left from right and mirrored replay ask for the reflection, too.
    asked = tiny(tmp_path / "run", f"env.backend={backend}", "network=equivariant")
    assert command("train", *asked, trainer=Watched) == 0
    assert before_the_first_step == ["read biped", "compile", "graph"]
    # The robot is not read again while it is trained and evaluated.
    assert seen == before_the_first_step


def test_a_run_is_read_once(finished, tmp_path, seen):
    run = finished.copy("gctd3", tmp_path / "run")
    seen.clear()
    assert command("evaluate", f"run={run}", "episodes=1", "threads=1") == 0
    # Its own copy of the robot: the source is unchanged, and is not read.
    assert seen == ["compile", "graph"]
