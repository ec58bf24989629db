"""The package: imports point one way, the front door is light, and everything public has a docstring."""

import ast
import functools
import importlib
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import gctd3
from gctd3.config.fields import defaults_of, is_settings

ROOT = Path(gctd3.__file__).parent
# Rooms from the bottom up: a module imports from its own room and from those below it. At the top level stand the
# foundations, which everything may use, and the commands, which nothing may.
FOUNDATIONS = ("errors", "files", "signals", "compat", "progress")
ROOMS = (
    "config",
    "robots",
    "tasks",
    "envs",
    "nn",
    "objectives",
    "algorithms",
    "sb3",
    "setup",
    "data",
    "evaluation",
    "viz",
    "training",
    "runs",
    "deploy",
    "bridge",
    "engines",
    "comparison",
)
DOORS = ("train", "evaluate", "view", "render", "export", "graph", "ros", "report", "crosscheck", "__main__")
ASSETS = ("conf", "models")  # installed with the package, and not Python
MOST_FILES, MOST_LINES = 16, 60  # at the top level; of a command
HEAVY = ("hydra", "dm_control", "torch", "torchrl", "mujoco", "gymnasium", "numpy")


def modules(root=ROOT):
    """Return every module of the package except its front door, which imports none of them."""
    for file in sorted(root.rglob("*.py")):
        parts = file.relative_to(root).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        if name:
            yield name, file


def floor(module):
    """Return a module's level; each foundation has a level of its own, in their order."""
    room = module.split(".")[0]
    if room in FOUNDATIONS:
        return FOUNDATIONS.index(room)
    if room in ROOMS:
        return len(FOUNDATIONS) + ROOMS.index(room)
    assert room in DOORS, f"{module} is in no room"
    return len(FOUNDATIONS) + len(ROOMS)


def named(file, types=True):
    """Return the modules of the package that a file names, in imports and in texts for import_module.

    Without ``types``, those that are imported when the program runs.
    """
    return named_in(file.read_text(encoding="utf-8"), file.name, types)


@functools.cache
def named_in(text, file, types):
    return list(names_in(text, file, types))


def names_in(text, file, types):
    tree = ast.parse(text)
    never = [node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    skipped = set() if types else {inner for node in never for part in node.body for inner in ast.walk(part)}
    for node in ast.walk(tree):
        if node in skipped:
            continue
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names = [node.value] if re.fullmatch(r"gctd3(\.\w+)+", node.value) else []
        for name in names:
            inner = name.removeprefix("gctd3.")
            if inner != name and inner.split(".")[0] not in ASSETS:
                yield inner


def upward(root=ROOT):
    """Yield imports of modules on a higher level."""
    front = {*vars(gctd3)["_HOME"], *vars(gctd3)["_TARGETS"]}
    rooms = {name.split(".")[0] for name, _ in modules(root)}
    for name, file in modules(root):
        for other in named(file):
            room = other.split(".")[0]
            # What the front door hands out stands on any floor.
            if room in front or (room in DOORS and room != name) or (room in rooms and floor(other) > floor(name)):
                yield f"{name} names {other}"


def fresh(code):
    """Return the output of a new interpreter."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_every_module_has_a_room_and_the_top_level_is_small():
    for name, file in modules():
        floor(name)
        if name in DOORS:
            assert len(file.read_text(encoding="utf-8").splitlines()) <= MOST_LINES, f"{name} is more than a command"
    assert len(list(ROOT.glob("*.py"))) <= MOST_FILES


def test_imports_point_downwards():
    assert list(upward()) == []


@pytest.mark.parametrize(
    "planted",
    [
        "from gctd3.training.trainer import Trainer",
        "import gctd3.training.trainer",
        "def late():\n    from gctd3.training import trainer",
        'import_module("gctd3.training.trainer")',
        'SETTINGS = {"_target_": "gctd3.training.settings.TrainSettings"}',
        'SETTINGS = {"_target_": "gctd3.TrainSettings"}',
        "from gctd3 import train",
        "from gctd3 import TrainSettings",
    ],
)
def test_an_upward_import_is_found_however_it_is_written(tmp_path, planted):
    copy = shutil.copytree(ROOT, tmp_path / "gctd3", ignore=shutil.ignore_patterns("__pycache__"))
    assert list(upward(copy)) == []
    with (copy / "nn" / "layers.py").open("a", encoding="utf-8") as file:
        file.write(f"\n{planted}\n")
    (found,) = upward(copy)
    assert found.startswith("nn.layers names ")


def test_no_circle_of_imports():
    """No modules import each other in a circle; late imports and named modules count, imports for types do not.

    So settings may build what they set, imported late, and what they set may say whose settings it takes.
    """
    there = {name for name, _ in modules()}
    arrows = {
        name: {module_of(other, there) for other in named(file, types=False)} & there - {name}
        for name, file in modules()
    }
    while leaves := [name for name, others in arrows.items() if not others & arrows.keys()]:
        for name in leaves:
            del arrows[name]
    assert not arrows, f"a circle among {', '.join(sorted(arrows))}"


def module_of(name, there):
    """Return the module with which a dotted name begins, if it belongs to the package."""
    while name and name not in there:
        name = name.rpartition(".")[0]
    return name


def default_targets(thing):
    """Return the names of the front door in the defaults of a settings class."""
    defaults = str(defaults_of(thing)) if is_settings(thing) and thing.__name__ != "RaySettings" else ""
    return set(re.findall(r"'_target_': 'gctd3\.(\w+)'", defaults))


def test_yaml_names_the_front_door():
    """Every ``_target_`` is a name of the front door: runs hold it, so it has to outlive moves."""
    files = [
        *Path(gctd3.__file__).parents[1].glob("conf/**/*.yaml"),
        *Path(gctd3.__file__).parents[1].glob("models/**/*.yaml"),
    ]
    assert len(files) > 50
    targets = {t for f in files for t in re.findall(r"_target_: *([\w.]+)", f.read_text(encoding="utf-8"))}
    ours = {target.removeprefix("gctd3.") for target in targets if target.startswith("gctd3.")}
    # And those by which the others are completed.
    ours |= {inner for name in ours for inner in default_targets(getattr(gctd3, name))}
    assert len(ours) > 30 and ours <= set(vars(gctd3)["_TARGETS"])
    # Those that no YAML of ours composes are there for others'.
    assert set(vars(gctd3)["_TARGETS"]) - ours == {"Composition", "SingleSupport", "UniformCommand"}
    for name in vars(gctd3)["_TARGETS"]:
        if name != "RaySettings" or find_spec("ray"):
            assert getattr(gctd3, name).__name__ == name


def test_the_front_door_imports_nothing_until_it_is_used():
    names = f"name in {HEAVY} or name.startswith('gctd3.')"
    assert fresh(f"import gctd3, sys; print([name for name in sys.modules if {names}])") == "[]"


@pytest.mark.nightly
@pytest.mark.parametrize("order", ["gctd3, gymnasium", "gymnasium, gctd3"])
def test_gymnasium_knows_the_robot_whichever_is_imported_first(order):
    code = f"import {order}\nprint(gymnasium.spec('gctd3/Biped-v0'))"
    assert "gctd3/Biped-v0" in fresh(code)
    assert fresh("import importlib.util, gctd3; importlib.util.find_spec('gymnasium')\n" + code) == fresh(code)


@pytest.mark.parametrize(
    "modules, absent",
    [
        # What each stage can be used without: the graph without PyTorch, the networks without Hydra.
        (
            ["gctd3.ros", "gctd3.bridge.policy_node", "gctd3.bridge.arguments", "gctd3.bridge.settings"],
            ("torch", "torchrl", "hydra", "omegaconf", "mujoco", "gymnasium"),
        ),
        (
            ["gctd3.bridge.simulator_node", "gctd3.bridge.both"],
            ("torch", "torchrl", "tensordict", "dm_control", "gymnasium"),
        ),
        (["gctd3.training.session", "gctd3.training.trainer"], ("PIL", "matplotlib")),
        (["gctd3.deploy.policy"], ("torch", "torchrl", "hydra", "dm_control", "mujoco", "safetensors")),
        (
            ["gctd3.evaluation.gait_metrics", "gctd3.evaluation.effort"],
            ("torch", "torchrl", "hydra", "dm_control", "mujoco"),
        ),
        (
            ["gctd3.robots.robot", "gctd3.robots.graph", "gctd3.tasks.walk"],
            ("torch", "torchrl", "hydra", "dm_control"),
        ),
        # To import PyTorch takes long.
        pytest.param(["gctd3.nn", "gctd3.algorithms.td3"], ("hydra", "dm_control"), marks=pytest.mark.nightly),
        (["gctd3.compat"], ("torch", "torchrl", "hydra", "dm_control", "mujoco")),
        (["gctd3.config.build"], ("torch", "torchrl", "dm_control", "mujoco")),
    ],
)
def test_stages_are_light(modules, absent):
    """Import in one interpreter what has to do without the same; the first to bring it is named."""
    heavy = f"[name for name in {absent} if name in sys.modules]"
    code = f"import importlib, sys\nfor name in {modules}:\n    importlib.import_module(name)\n    print(name, {heavy})"
    assert fresh(code).splitlines() == [f"{name} []" for name in modules]


# The public names.


def test_public_names_resolve():
    assert gctd3.__all__ == sorted(gctd3.__all__)
    for name in gctd3.__all__:
        thing = getattr(gctd3, name)
        assert thing.__name__ == name
        assert thing.__module__.startswith("gctd3.")
        assert name in dir(gctd3)


def test_an_unknown_name_lists_those_there_are():
    with pytest.raises(AttributeError, match=r"no attribute 'make_actress'.*make_actor"):
        _ = gctd3.make_actress


@pytest.mark.parametrize("name", [name for name, _ in modules()])
def test_names_of_a_modules_all_exist(name):
    if name == "data.ray_worker":
        pytest.importorskip("ray")
    module = importlib.import_module(f"gctd3.{name}")
    for public in getattr(module, "__all__", ()):
        assert hasattr(module, public)


def undocumented(node, prefix=""):
    """Yield public definitions below ``node`` without a docstring, except those nested in functions."""
    for child in node.body:
        if not isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)) or child.name.startswith("_"):
            continue
        # What a property is, its getter says.
        setter = any(getattr(decorator, "attr", "") == "setter" for decorator in child.decorator_list)
        if not setter and not ast.get_docstring(child):
            yield f"{prefix}{child.name}"
        if isinstance(child, ast.ClassDef):
            yield from undocumented(child, f"{prefix}{child.name}.")


def test_everything_public_has_a_docstring():
    missing = []
    for name, file in [*modules(), ("gctd3", ROOT / "__init__.py")]:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        missing += [] if ast.get_docstring(tree) else [name]
        missing += [f"{name}.{found}" for found in undocumented(tree)]
    assert not missing, ", ".join(missing)
