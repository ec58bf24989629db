"""Other libraries' private names are used in gctd3/compat.py and gctd3/nn/kernels.py, and nowhere else."""

import ast
import importlib
import inspect
import re
from pathlib import Path

import pytest

import gctd3

ROOT = Path(gctd3.__file__).parent
ALLOWED = {"compat.py", "nn/kernels.py"}
# What TorchRL documents as the methods that a subclass writes; what Stable-Baselines3's own VecEnvs call of their base;
# and Python's own os._exit.
WRITTEN = {"_reset", "_step", "_set_seed", "_call", "_inv_call", "_apply_transform"}
WRITTEN |= {"_seeds", "_reset_seeds", "_reset_options", "_get_indices", "_exit"}


def private(name):
    # Hydra's `_target_` is a key of YAML that everybody writes.
    return name.startswith("_") and not name.startswith("__") and name not in ("_", "_target_")


def defined(tree):
    """Yield private names that a file defines: functions, classes, attributes of ``self``, fields."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and own(node.value):
            yield node.attr


def own(node):
    return isinstance(node, ast.Name) and node.id in ("self", "cls")


def foreign(tree, package):
    """Return private names of others that a file uses; ``package``: names that any file of the package defines."""
    here = set(defined(tree))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            known = package if own(node.value) else here
            if private(node.attr) and node.attr not in known | WRITTEN:
                yield node.lineno, node.attr
            if node.attr == "__dict__":
                yield node.lineno, node.attr
        elif isinstance(node, ast.ImportFrom) and not (node.module or "").startswith("gctd3"):
            names = [*(node.module or "").split("."), *(alias.name for alias in node.names)]
            yield from ((node.lineno, name) for name in names if private(name))
        elif isinstance(node, ast.Import):
            names = [part for alias in node.names for part in alias.name.split(".")]
            yield from ((node.lineno, name) for name in names if private(name))
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in (
            "getattr",
            "setattr",
            "hasattr",
            "delattr",
        ):
            name = getattr(node.args[1], "value", None)
            if isinstance(name, str) and (private(name) or name == "__dict__") and name not in here:
                yield node.lineno, name
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            module = re.fullmatch(r"(?!gctd3\.)[a-z]\w*(\.\w+)*\.(_[a-z]\w*)(\.\w+)*", node.value)
            if module and private(module[2]):
                yield node.lineno, module[2]


def files():
    return {file.relative_to(ROOT).as_posix(): file for file in sorted(ROOT.rglob("*.py"))}


def tree_of(file):
    return ast.parse(file.read_text(encoding="utf-8"))


def used():
    package = {name for file in files().values() for name in defined(tree_of(file))}
    return {name: list(foreign(tree_of(file), package)) for name, file in files().items()}


def test_no_private_name_of_another_library():
    found = {name: names for name, names in used().items() if names and name not in ALLOWED}
    assert not found, f"belongs into gctd3/compat.py: {found}"


@pytest.mark.nightly
def test_the_exceptions_are_needed():
    found = used()
    assert {name for name in ALLOWED if found[name]} == ALLOWED


@pytest.mark.parametrize(
    "planted",
    [
        "env._env",
        "env._env = inner",
        "self._modules.values()",
        "super()._apply(fn)",
        "loss.__dict__['x'] = 1",
        "getattr(env, '_env', None)",
        "setattr(env, '_env', 1)",
        "import torch.utils._pytree",
        "from torch._dynamo import config",
        "from torch.utils import _pytree",
        "torch._foreach_add_(steps, 1)",
        "target.startswith('hydra._internal')",
    ],
)
def test_one_is_found_however_it_is_written(planted):
    assert list(foreign(ast.parse(planted), set()))


@pytest.mark.parametrize(
    "planted",
    [
        "def _f(): ...\n_f()",
        "class A:\n    def __init__(self):\n        self._x = 1\n    def y(self, other):\n        return other._x",
        "for _ in range(3): pass",
        "env.step(action)",
        "KEYS = {'_target_': 'gctd3.TrainSettings'}",
    ],
)
def test_ones_own_are_left_alone(planted):
    tree = ast.parse(planted)
    assert not list(foreign(tree, set(defined(tree))))


def classes():
    for name in files():
        if name == "data/ray_worker.py" or name.startswith("__"):
            continue
        module = importlib.import_module(
            "gctd3." + name.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        )
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if kind.__module__ == module.__name__:
                yield kind


@pytest.mark.nightly
def test_no_class_takes_a_private_name_of_its_base():
    """No class overrides a private method or attribute of a library's class that it extends."""
    taken = []
    for kind in classes():
        tree = ast.parse(inspect.getsource(inspect.getmodule(kind)))
        (body,) = (n for n in ast.walk(tree) if isinstance(n, ast.ClassDef) and n.name == kind.__name__)
        theirs = [base for base in kind.__mro__ if not base.__module__.startswith("gctd3")]
        for name in filter(private, set(defined(body)) - WRITTEN):
            taken += [f"{kind.__qualname__}.{name} of {base.__qualname__}" for base in theirs if name in vars(base)]
    assert not taken, ", ".join(sorted(set(taken)))
