"""Settings: every YAML builds, and every key is explained and a setting."""

import inspect
import re
from importlib.resources import files
from pathlib import Path

import pytest
import yaml
from configs import composed, items
from hydra.utils import get_object

from gctd3.algorithms.base import AlgorithmSettings
from gctd3.config.build import build
from gctd3.evaluation.robustness import Perturbations
from gctd3.runs.judge import EvaluateSettings
from gctd3.tasks.reward import Reward
from gctd3.tasks.walk import WalkSettings
from gctd3.training.settings import TrainSettings

CONF = Path(str(files("gctd3.conf")))
ALGORITHMS, NETWORKS = (sorted(file.stem for file in (CONF / group).glob("*.yaml")) for group in ("algo", "network"))
OF_EVALUATE = "perturbations"  # a group that training does not have
OPTIONS = sorted((file.parent.name, file.stem) for file in CONF.glob("*/*.yaml") if file.parent.name != OF_EVALUATE)


@pytest.fixture(scope="module")
def default():
    return composed()


# Everything in conf/ builds.


def test_there_is_something_to_test():
    assert {"gctd3", "td3", "ddpg", "sac"} <= set(ALGORITHMS) and {"gcn", "mlp"} <= set(NETWORKS)


@pytest.mark.parametrize("group, option", OPTIONS)
def test_every_option_builds(group, option):
    assert isinstance(build(composed(f"{group}={option}")), TrainSettings)


@pytest.mark.parametrize("option", sorted(file.stem for file in (CONF / "reward").glob("*.yaml")))
def test_every_reward_can_judge_too(option):
    settings = build(composed(f"reward@evaluation.reward={option}"))
    assert settings.evaluation.reward == build(composed(f"reward={option}")).reward


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_any_algorithm_takes_any_network(algorithm, network):
    settings = build(composed(f"algo={algorithm}", f"network={network}"))
    assert bool(settings.network.graph_layers) == (network != "mlp")
    assert isinstance(settings.algo, AlgorithmSettings)
    assert settings.algo.build(settings.setup().architecture()).optimizers.keys() >= {"actor", "critic"}


@pytest.mark.parametrize("algorithm, network", [("gctd3", "gcn"), ("td3", "mlp"), ("ddpg", "mlp"), ("sac", "mlp")])
def test_an_algorithm_brings_its_network_and_its_noise(algorithm, network):
    settings = build(composed(f"algo={algorithm}"))
    assert settings.network == build(composed(f"network={network}")).network
    assert (settings.exploration.noise is None) == (algorithm == "sac")


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("experiment", sorted(file.stem for file in (CONF / "experiment").glob("*.yaml")))
def test_any_algorithm_takes_any_experiment(experiment, algorithm):
    build(composed(f"experiment={experiment}", f"algo={algorithm}"))


@pytest.mark.parametrize("task", ["walker_walk", "walker2d", "halfcheetah", "ant"])
def test_a_librarys_task_brings_what_goes_with_it(task):
    settings = build(composed(f"task={task}"))
    assert (settings.env.backend, settings.env.num_envs) == ("library", 8)
    assert settings.exploration.warmup == "uniform" and not settings.replay.mirror
    assert settings.stop_when.evaluations is None
    # What is asked for comes before it.
    assert build(composed(f"task={task}", "env.num_envs=3")).env.num_envs == 3


def test_perturbations_build():
    assert build(composed("run=x", root="evaluate")).perturbations == Perturbations()
    for file in (CONF / OF_EVALUATE).glob("*.yaml"):
        assert isinstance(build(composed("run=x", f"{OF_EVALUATE}={file.stem}", root="evaluate")), EvaluateSettings)


@pytest.mark.parametrize("root", ["evaluate", "export", "render", "report", "view"])
def test_the_other_commands_build(root):
    key = "runs" if root == "report" else "run"
    assert getattr(build(composed(f"{key}=somewhere", root=root)), key) == "somewhere"


def test_yaml_and_python_agree_on_the_papers_task(default):
    """What a library user gets by default is what a command line gets."""
    assert build(composed("reward=paper")).reward == Reward()
    assert build(default).task == WalkSettings()


# Every key is explained, and is a setting.


def lines_of(file):
    """Key, value and comments of each line that is ours: full key, whether it has a value, whether it is explained."""
    path, above, block = [], False, None
    for line in file.read_text(encoding="utf-8").splitlines():
        match = re.match(r"( *)(\w+):\s*(.*)", line)
        indent = len(line) - len(line.lstrip())
        if block is not None and line.strip() and indent > block:
            continue  # within defaults or hydra
        if match is None:
            above = line.strip().startswith("#") and "@package" not in line
            continue
        block = indent if match[2] in ("defaults", "hydra") else None
        path = [*path[: indent // 2], match[2]]
        value, _, comment = match[3].partition("#")
        if block is None and match[2] != "_target_" and value.strip():
            yield ".".join(path), above or bool(comment)
        else:
            above = False  # a comment above a mapping does not explain what is in it


def package(file):
    """Where the keys of a file end up: below the name of its group, or of the command."""
    group = file.parent.name if file.parent != CONF else ""
    everywhere = file.stem == "config" or "@package _global_" in file.read_text(encoding="utf-8")
    return "" if everywhere else f"{group or file.stem}."


def test_every_key_has_a_comment():
    """On its line, or above it and the keys that follow; where a file repeats a key, in the file that it is from."""
    seen, explained = {}, set()
    for file in CONF.rglob("*.yaml"):
        found = list(lines_of(file))
        plain = yaml.safe_load(file.read_text(encoding="utf-8"))
        ours = {key: value for key, value in plain.items() if key not in ("defaults", "hydra")}
        leaves = [key for key, value in items(ours) if not isinstance(value, dict) or not value]
        assert sorted(key for key, _ in found) == sorted(leaves)  # the test reads what YAML reads
        for key, comment in found:
            seen[package(file) + key] = file.relative_to(CONF)
            explained |= {package(file) + key} if comment else set()
    missing = {key: str(file) for key, file in seen.items() if key not in explained}
    assert len(seen) > 60 and not missing


@pytest.mark.parametrize("root", ["config", "evaluate", "export", "render", "report", "view"])
def test_every_key_is_a_parameter_and_every_parameter_a_key(root):
    def check(node, path=""):
        if "_target_" in node:
            assert set(node) - {"_target_"} == set(inspect.signature(get_object(node["_target_"])).parameters), path
        for key, value in node.items():
            if isinstance(value, dict):
                check(value, f"{path}.{key}")

    given = {"config": [], "report": ["runs=x"]}.get(root, ["run=x"])
    check(composed(*given, root=root))
