"""Fixtures for all tests: the paper's robot, its graph and its task, finished runs, and reproducible settings."""

import gc

import pytest

# Nothing heavy is imported here: the process that hands out the tests reads this file before the others can begin.


def pytest_collection():
    """Only where tests are run: the process that hands them out collects none."""
    from hypothesis import settings

    # Derandomised, so that a failure seen once is seen by everybody; no deadline, since machines differ.
    settings.register_profile("gctd3", deadline=None, derandomize=True)
    settings.load_profile("gctd3")


def pytest_collection_finish(session):
    """Keep the collector of garbage from going through the modules and tests of the whole suite again and again."""
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item):
    """Skip tests of dm_control where it cannot be imported: those marked so, and those with it as a parameter."""
    parameters = item.callspec.params.values() if hasattr(item, "callspec") else ()
    if item.get_closest_marker("dm_control") or "dm_control" in map(str, parameters):
        from suite_robots import why_not

        if why_not():
            pytest.skip(why_not())


@pytest.fixture(autouse=True)
def _seed():
    import torch

    torch.manual_seed(0)
    # Sums in another order differ in the last bit.
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def robot():
    from gctd3.robots.robot import Robot

    return Robot.from_mjcf("biped")


@pytest.fixture(scope="session")
def graph(robot):
    from gctd3.robots.graph import KinematicGraph

    return KinematicGraph.from_robot(robot)


@pytest.fixture(scope="session")
def task(robot):
    from gctd3.tasks.walk import WalkingTask

    return WalkingTask(robot)


@pytest.fixture(scope="session")
def shared_folder(request, tmp_path_factory):
    """Return the session's folder, in which the processes of pytest-xdist have folders of their own."""
    folder = tmp_path_factory.getbasetemp()
    return folder.parent if hasattr(request.config, "workerinput") else folder


@pytest.fixture(scope="session")
def finished(shared_folder):
    """Finished tiny runs by name: ``finished["gctd3"]`` to be read, ``finished.copy("gctd3", to)`` to be changed."""
    from finished import Finished

    return Finished(shared_folder / "finished")


@pytest.fixture(scope="module", autouse=True)
def _shared_runs_are_left_alone(finished):
    yield
    finished.check()


@pytest.fixture(scope="session")
def exported(shared_folder):
    """Return the ONNX file of the policy that ships with the library, to be read only; its contract is beside it."""
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    from finished import once
    from running import command

    def export(folder):
        assert command("export", f"out={folder / 'policy.onnx'}", "episodes=2", "threads=1") == 0

    return once(shared_folder / "exported", export) / "policy.onnx"


@pytest.fixture(scope="session")
def exported_velocity(shared_folder, finished):
    """Return the ONNX file of a policy of task=velocity, which walks nowhere, to be read only."""
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    from finished import once
    from running import command

    def export(folder):
        out = folder / "policy.onnx"
        assert command("export", f"run={finished['velocity']}", f"out={out}", "episodes=2", "threads=1") == 0

    return once(shared_folder / "exported_velocity", export) / "policy.onnx"


@pytest.fixture(scope="session")
def site(shared_folder):
    """Return the folder of the documentation site, built without a warning."""
    from built_site import built_site

    return built_site(shared_folder / "site")
