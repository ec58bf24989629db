"""The package: imports that point one way, a light front door, a docstring on everything that is public."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import gctd3

ROOT = Path(gctd3.__file__).parent
# Along the flow of data, each importing only from those before it: a robot becomes a graph, a task, an environment;
# networks act on it, losses and algorithms train them, replay and exploration feed those, evaluation judges them,
# a checkpoint keeps them, the trainer does all of it and the commands call it. A new module gets a place here.
STAGES = [
    "errors",
    "files",
    "contract deploy",
    "mjcf shapes feet mirror base stance servos robot",
    "nodes graph",
    "reflection",
    "envs.serial envs.robots envs.reward envs.records envs.gait envs.simulation envs.simulator_state envs.batched "
    "envs.dmc envs.gym envs.nodes envs.library_robots envs.library envs.check envs.factory envs.state envs",
    "nn.layers nn.graph_conv nn.encoder nn.readout nn.symmetry nn.network nn.actor nn.critic nn",
    "objectives.stacked objectives.td3 objectives.sac objectives",
    "algorithms.adam algorithms.base algorithms.td3 algorithms.ddpg algorithms.sac algorithms",
    "exploration",
    "threads faults collector ray_cluster",
    "device",
    "frame_buffer replay",
    "gait_metrics gait_effort",
    "motion episode gait_summary",
    "settings",
    "usage cli",
    "train_settings run_config checkpoint",
    "evaluation",
    "perturb robustness plot robustness_plot",
    "gl live film",
    "evaluate",
    "picture graph_picture",
    "render panel view",
    "describe export",
    "interrupt sweep random_state counters run_log",
    "worker process_worker ray_worker workers collectors",
    "trainer",
    "train",
    "reporting.place reporting.runs reporting.together reporting.groups reporting.keep reporting.statistics "
    "reporting.clock reporting.verdict "
    "reporting.figures reporting.tables reporting.gaits reporting.filmstrips reporting.page reporting",
    "report",
    "__main__",
]
ORDER = [name for stage in STAGES for name in stage.split()]
HEAVY = ("hydra", "dm_control", "torch", "torchrl", "mujoco")


def modules():
    """Every module of the package but its front door, which imports none of them."""
    for file in sorted(ROOT.rglob("*.py")):
        parts = file.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        if name:
            yield name, file


def imported(file):
    """Modules of the package that a file imports, late and for type checkers only too."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name.removeprefix("gctd3.") in ORDER else node.module for name in inside]
        for name in names:
            if name.startswith("gctd3."):
                yield name.removeprefix("gctd3.")


def fresh(code):
    """What a new interpreter prints."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_every_module_has_its_place():
    there = {name for name, _ in modules()}
    assert there == set(ORDER), f"to be placed in STAGES: {there - set(ORDER)}; gone: {set(ORDER) - there}"
    assert len(set(ORDER)) == len(ORDER)


def test_imports_point_one_way():
    forward = []
    for name, file in modules():
        for other in imported(file):
            assert other in ORDER, f"{name} imports gctd3.{other}, which is no module"
            if ORDER.index(other) >= ORDER.index(name):
                forward.append(f"{name} imports {other}")
    assert not forward, "; ".join(forward)


def test_the_front_door_imports_nothing_until_it_is_used():
    names = f"name in {HEAVY} or name.startswith('gctd3.')"
    assert fresh(f"import gctd3, sys; print([name for name in sys.modules if {names}])") == "[]"


@pytest.mark.parametrize(
    "module, absent",
    [
        # What each stage can be used without: the graph without PyTorch, the networks without Hydra.
        ("gctd3.deploy", ("torch", "torchrl", "hydra", "dm_control", "mujoco", "safetensors")),
        ("gctd3.robot", ("torch", "torchrl", "hydra", "dm_control")),
        ("gctd3.graph", ("torch", "torchrl", "hydra", "dm_control")),
        ("gctd3.envs.gait", ("torch", "torchrl", "hydra", "dm_control")),
        ("gctd3.nn", ("hydra", "dm_control")),
        ("gctd3.algorithms.td3", ("hydra", "dm_control")),
        ("gctd3.gait_metrics", ("torch", "torchrl", "hydra", "dm_control", "mujoco")),
        ("gctd3.gait_effort", ("torch", "torchrl", "hydra", "dm_control", "mujoco")),
        ("gctd3.settings", ("torch", "torchrl", "dm_control", "mujoco")),
    ],
)
def test_stages_are_light(module, absent):
    assert fresh(f"import {module}, sys; print([name for name in {absent} if name in sys.modules])") == "[]"


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
    if name == "ray_worker":
        pytest.importorskip("ray")
    module = importlib.import_module(f"gctd3.{name}")
    for public in getattr(module, "__all__", ()):
        assert hasattr(module, public)


def undocumented(node, prefix=""):
    """Public definitions below ``node`` without a docstring; what is nested in a function is not public."""
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
