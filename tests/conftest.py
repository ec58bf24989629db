"""Fixtures for all tests: the paper's robot, its graph and its task, finished runs, and reproducible settings."""

import pytest
import torch
from finished import Finished
from hypothesis import settings
from running import command

from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.tasks.walk import WalkingTask

# Derandomised, so that a failure seen once is seen by everybody; no deadline, since machines differ.
settings.register_profile("gctd3", deadline=None, derandomize=True)
settings.load_profile("gctd3")


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)
    # Sums in another order differ in the last bit.
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def robot():
    return Robot.from_mjcf("biped")


@pytest.fixture(scope="session")
def graph(robot):
    return KinematicGraph.from_robot(robot)


@pytest.fixture(scope="session")
def task(robot):
    return WalkingTask(robot)


@pytest.fixture(scope="session")
def finished(request, tmp_path_factory):
    """Provide finished tiny runs by name: ``finished["gctd3"]`` to read, ``finished.copy("gctd3", to)`` to change."""
    folder = tmp_path_factory.getbasetemp()
    # The processes of pytest-xdist have folders of their own in the session's.
    folder = folder.parent if hasattr(request.config, "workerinput") else folder
    return Finished(folder / "finished")


@pytest.fixture(scope="module", autouse=True)
def _shared_runs_are_left_alone(finished):
    yield
    finished.check()


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """Return the ONNX file of the policy that ships with the library; its contract is beside it."""
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    file = tmp_path_factory.mktemp("exported") / "policy.onnx"
    assert command("export", f"out={file}", "episodes=2", "threads=1") == 0
    return file
