"""dm_control, for the tests that need it; where it cannot be imported they are skipped, with the reason gctd3 gives."""

import functools
from importlib.util import find_spec
from pathlib import Path

import pytest

from gctd3.config.requirements import check_dm_control
from gctd3.errors import PackageError


@functools.cache
def why_not():
    """Return why dm_control cannot be imported; ``None`` if it can."""
    try:
        check_dm_control("the test")
    except PackageError as error:
        return str(error)


def load(task, random=None):
    """Load a task as a dm_control environment."""
    if why_not():
        pytest.skip(why_not())
    from gctd3.envs import dmc

    return dmc.load(task, random)


def suite(file):
    """Return the path of a robot's file in dm_control's suite, which is missing without dm_control."""
    spec = find_spec("dm_control")
    return Path(spec.submodule_search_locations[0] if spec else "dm_control") / "suite" / file
