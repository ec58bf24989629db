"""Tensors read from a file give the same bits as the computed ones, wherever they lie in the file."""

import numpy as np
import pytest
import torch
from safetensors import safe_open
from tensordict import TensorDict
from thinned import parametrize
from toy_algorithms import GCN, MLP, build, going_on

from gctd3.files import load_tree, save_tree

ALIGNMENT = 64  # bytes; of PyTorch's own memory on the CPU (c10/core/alignment.h)
SHIFTS = range(0, ALIGNMENT, 4)


def shifted(file, shift, tree):
    """Write ``tree`` behind ``shift`` bytes of other tensors; return its memory's offset from ALIGNMENT."""
    # Files hold tensors by name.
    save_tree(file, {"a": torch.zeros(shift // 4), "tree": tree})
    with safe_open(str(file), framework="pt") as opened:
        names = [name for name in opened.keys() if name.startswith("/tree")]  # noqa: SIM118 - it is no mapping
        return {opened.get_tensor(name).data_ptr() % ALIGNMENT for name in names}


def misaligned(value):
    """Return whether any tensor or array of a tree lies off ALIGNMENT."""
    if isinstance(value, dict):
        return any(map(misaligned, value.values()))
    address = value.ctypes.data if isinstance(value, np.ndarray) else value.data_ptr()
    return bool(address % ALIGNMENT)


def test_the_files_of_these_tests_lie_at_many_alignments(tmp_path):
    tree = {"weights": torch.ones(8)}
    assert len(set.union(*(shifted(tmp_path / "file", shift, tree) for shift in SHIFTS))) > 4


@pytest.mark.parametrize("shift", SHIFTS)
def test_tensors_and_arrays_are_loaded_into_memory_of_their_own(tmp_path, shift):
    tree = {
        "weights": torch.randn(5, 3),
        "nodes": np.random.randn(2, 8),
        "one": torch.randn(1),
        "flag": torch.ones(3) > 0,
    }
    shifted(tmp_path / "file", shift, tree)
    loaded = load_tree(tmp_path / "file")["tree"]
    assert not misaligned(loaded)
    for key, value in tree.items():
        assert (loaded[key] == value).all()


@parametrize(2, "network", [GCN, MLP], ids=["gcn", "mlp"])
@pytest.mark.parametrize("name", ["td3", "sac"])
def test_an_update_with_what_was_loaded_equals_one_with_what_was_saved(tmp_path, name, network):
    """Actions, both losses, optimisers and targets are equal to the bit, at every place in a file."""

    def updated(state, batch):
        algorithm = build(name, network)
        algorithm.load_state_dict(state)
        torch.manual_seed(1)
        metrics = [algorithm.update(TensorDict(batch, [64])) for _ in range(2)]
        return metrics, algorithm.actor(TensorDict(batch, [64]).clone())["action"], algorithm.loss.state_dict()

    batch, state = going_on().to_dict(), build(name, network).state_dict()
    metrics, action, parameters = updated(state, batch)
    for shift in SHIFTS:
        shifted(tmp_path / "file", shift, {"state": state, "batch": batch})
        loaded = load_tree(tmp_path / "file")["tree"]
        assert not misaligned(loaded["batch"])
        again = updated(loaded["state"], loaded["batch"])
        assert again[0] == metrics
        assert torch.equal(again[1], action)
        assert all(torch.equal(again[2][key], value) for key, value in parameters.items())


def test_arrays_are_saved_whatever_their_order_in_memory(tmp_path):
    transposed = np.arange(6.0).reshape(2, 3).T
    save_tree(tmp_path / "file", {"transposed": transposed, "number": np.array(3.0)})
    loaded = load_tree(tmp_path / "file")
    np.testing.assert_array_equal(loaded["transposed"], transposed)
    assert loaded["number"].shape == ()
