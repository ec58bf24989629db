"""The namespace of an array's library."""

import subprocess
import sys

import array_api_compat
import numpy as np
import pytest
import torch

from gctd3.robots.array_library import array_namespace

NEEDED = ("abs", "all", "any", "asarray", "astype", "atan2", "bool", "clip", "concat", "stack", "take", "where")


@pytest.mark.parametrize("array", [np.zeros(2), np.float64(1.0), torch.zeros(2)])
def test_a_namespace_has_the_standards_names(array):
    xp, standard = array_namespace(array), array_api_compat.array_namespace(array)
    assert all(hasattr(xp, name) for name in NEEDED)
    angles = xp.asarray([0.5, -2.0])
    for name in ("abs", "cos", "sum", "all", "zeros_like"):
        assert np.array_equal(getattr(xp, name)(angles), getattr(standard, name)(angles)), name
    assert np.array_equal(xp.clip(angles, -1.0, 1.0), [0.5, -1.0])
    assert xp.astype(angles, xp.int64).dtype == xp.int64


def test_what_is_no_array_is_refused():
    with pytest.raises(TypeError):
        array_namespace([0.0])


@pytest.mark.skipif(not hasattr(np, "astype"), reason="NumPy before 2.1 lacks names of the standard")
def test_numpys_own_namespace_brings_no_more_of_numpy():
    code = "import sys, numpy; from gctd3.robots.array_library import array_namespace as of; of(numpy.zeros(1)); "
    code += "print('numpy.f2py' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
