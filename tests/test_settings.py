"""Settings: every YAML builds, every key is explained, and every mistake is answered with what would be right."""

import copy
import inspect
import math
import re
from importlib.resources import files
from pathlib import Path

import pytest
import yaml
from hydra import compose, initialize_config_module
from hydra.utils import get_object
from omegaconf import OmegaConf

from gctd3.algorithms.base import AlgorithmSettings
from gctd3.envs.reward import Endings, Reward
from gctd3.envs.simulation import Start
from gctd3.errors import ConfigError
from gctd3.settings import build, suggest
from gctd3.train_settings import TrainSettings

CONF = Path(str(files("gctd3.conf")))
ALGORITHMS, NETWORKS = (sorted(file.stem for file in (CONF / group).glob("*.yaml")) for group in ("algo", "network"))
OPTIONS = sorted((file.parent.name, file.stem) for file in CONF.glob("*/*.yaml"))


def composed(*overrides, root="config"):
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        return OmegaConf.to_container(compose(root, list(overrides)), resolve=True)


@pytest.fixture(scope="module")
def default():
    return composed()


def items(node, prefix=""):
    """Full names and values of all keys but ``_target_``, mappings included."""
    for key, value in node.items():
        if key != "_target_":
            yield f"{prefix}{key}", value
            if isinstance(value, dict):
                yield from items(value, f"{prefix}{key}.")


def edited(config, key, value=None, rename=None, drop=False):
    """A copy of ``config`` in which ``key`` has another value or name, or is missing."""
    config = copy.deepcopy(config)
    *path, last = key.split(".")
    node = config
    for part in path:
        node = node[part]
    old = node.pop(last) if rename or drop else None
    if not drop:
        node[rename or last] = old if rename else value
    return config


def fails(config):
    with pytest.raises(ConfigError) as caught:
        build(config)
    return str(caught.value)


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
    assert settings.algo.build(settings.architecture()).optimizers.keys() >= {"actor", "critic"}


@pytest.mark.parametrize("algorithm, network", [("gctd3", "gcn"), ("td3", "mlp"), ("ddpg", "mlp"), ("sac", "mlp")])
def test_an_algorithm_brings_its_network_and_its_noise(algorithm, network):
    settings = build(composed(f"algo={algorithm}"))
    assert settings.network == build(composed(f"network={network}")).network
    assert (settings.exploration.noise is None) == (algorithm == "sac")


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("experiment", sorted(file.stem for file in (CONF / "experiment").glob("*.yaml")))
def test_any_algorithm_takes_any_experiment(experiment, algorithm):
    build(composed(f"experiment={experiment}", f"algo={algorithm}"))


@pytest.mark.parametrize("root", ["evaluate", "render", "view"])
def test_the_other_commands_build(root):
    assert build(composed("run=somewhere", root=root)).run == "somewhere"


def test_yaml_and_python_agree_on_the_papers_task(default):
    """What a library user gets by default is what a command line gets."""
    assert build(composed("reward=paper")).reward == Reward()
    assert build(default).env.endings == Endings()
    assert build(default).env.start == Start()


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
        leaves = [key for key, value in items(ours) if not isinstance(value, dict)]
        assert sorted(key for key, _ in found) == sorted(leaves)  # the test reads what YAML reads
        for key, comment in found:
            seen[package(file) + key] = file.relative_to(CONF)
            explained |= {package(file) + key} if comment else set()
    missing = {key: str(file) for key, file in seen.items() if key not in explained}
    assert len(seen) > 60 and not missing


@pytest.mark.parametrize("root", ["config", "evaluate", "render", "view"])
def test_every_key_is_a_parameter_and_every_parameter_a_key(root):
    def check(node, path=""):
        if "_target_" in node:
            assert set(node) - {"_target_"} == set(inspect.signature(get_object(node["_target_"])).parameters), path
        for key, value in node.items():
            if isinstance(value, dict):
                check(value, f"{path}.{key}")

    check(composed("run=x", root=root) if root != "config" else composed())


# Mistakes.


def test_a_misspelt_key_is_named_with_the_nearest_one(default):
    checked = 0
    for key, _ in items(default):
        parent, _, name = key.rpartition(".")
        if parent in ("stop_when.at_least", "stop_when.at_most"):
            continue  # names of metrics
        wrong = name[:-1] + name[-1] * 2
        message = fails(edited(default, key, rename=wrong))
        assert f"{parent}.{wrong}".lstrip(".") in message
        assert f"Did you mean {name!r}?" in message and "Accepted: " in message
        checked += 1
    assert checked > 60


def test_nothing_like_a_key_is_only_told_what_is_accepted(default):
    message = fails(edited(default, "zzz", 1))
    assert "Unknown key 'zzz'. Accepted: robot, env, reward" in message
    assert suggest("learning_rat", ["learning_rate", "tau"]) == " Did you mean 'learning_rate'?"
    assert suggest("zzz", ["learning_rate", "tau"]) == ""


def test_a_value_of_the_wrong_type_is_named(default):
    """Any key: a mapping where none belongs, and a text where a number belongs."""
    checked = 0
    for key, _ in items(default):
        if key.startswith(("stop_when.at_least.", "stop_when.at_most.")):
            continue  # checked as one mapping, below
        message = fails(edited(default, key, {"no": "setting"}))
        assert message.startswith(f"{key} must be ") and "{'no': 'setting'}" in message
        checked += 1
    assert checked > 60


@pytest.mark.parametrize(
    "key, value, expected",
    [
        ("seed", "one", "seed must be a whole number, got 'one'."),
        ("seed", 1.5, "seed must be a whole number, got 1.5."),
        ("seed", True, "seed must be a whole number, got True."),
        ("seed", None, "seed must be a whole number, got None."),
        ("algo.tau", "small", "algo.tau must be a number, got 'small'."),
        ("algo.average_policy", 1, "algo.average_policy must be true or false, got 1."),
        ("robot.name", 7, "robot.name must be a text, got 7."),
        ("total_episodes", "many", "total_episodes must be a whole number or null, got 'many'."),
        ("network.hidden", 256, "network.hidden must be a list of a whole number, got 256."),
        ("network.hidden", [256, "wide"], "network.hidden must be a list of a whole number, got (256, 'wide')."),
        ("exploration.noise", [0.1, None], "exploration.noise must be a list of a number or null, got (0.1, None)."),
        ("stop_when.at_least", {"return_mean": "high"}, "stop_when.at_least must be a mapping to a number"),
        ("env.backend", "isaac", "env.backend must be one of batched, dm_control, got 'isaac'."),
        ("logger", "paper", "logger must be one of csv, tensorboard, wandb, mlflow, none, got 'paper'."),
        ("algo", {"tau": 0.1}, "algo must be a AlgorithmSettings (a mapping with its _target_), got {'tau': 0.1}."),
    ],
)
def test_what_is_said_of_a_wrong_type(default, key, value, expected):
    assert fails(edited(default, key, value)).startswith(expected)


BAD = {
    "env.num_envs": 0, "env.history": -1, "env.control_dt": 0.0, "env.threads": 0,
    "env.endings.contact_steps": 0, "env.endings.hip_steps": 0, "env.endings.finish": 0.0, "env.endings.time_limit": 0,
    "env.start.angle_noise": -0.1, "env.start.velocity_noise": -0.1,
    "reward.frames": 0, "reward.progress_steps": 0, "evaluation.reward.frames": 0,
    "algo.learning_rate": 0.0, "algo.tau": 1.5, "algo.gamma": 1.0, "algo.policy_delay": 0, "algo.policy_noise": -0.2,
    "network.graph_layers": [0], "network.hidden": [],
    "exploration.warmup_frames": -1, "exploration.hold": 0, "exploration.frequency": [2.0, 1.0],
    "exploration.heirs": 1.5,
    "exploration.noise": [0.0, 0.1], "replay.capacity": 0, "replay.batch_size": 0, "replay.n_step": 0,
    "evaluation.every": 0, "evaluation.episodes": 0, "evaluation.seed": -1, "robot.graph_seed": -1,
    "stop_when.evaluations": 0,
    "seed": -1, "total_frames": 0, "total_episodes": 0, "steps": 0, "updates": 0, "threads": 0, "keep_checkpoints": 0,
}  # fmt: skip


@pytest.mark.parametrize("key", BAD)
def test_a_value_out_of_range_is_named(default, key):
    message = fails(edited(default, key, BAD[key]))
    assert key in message and str(BAD[key]) in message
    assert re.search(r"must (be|hold)", message)


def test_a_number_that_is_none_is_named(default):
    numbers = [key for key, value in items(default) if type(value) is float and not key.startswith("stop_when")]
    assert len(numbers) > 40
    for key in numbers:
        message = fails(edited(default, key, math.nan))
        assert message.startswith(key) and "nan" in message


def test_both_of_a_pair_are_named(default):
    message = fails(edited(default, "algo.noise_clip", -0.5))
    assert message == "algo.policy_noise and noise_clip must be at least 0, got 0.2 and -0.5."


def test_a_metric_that_is_none_is_named_with_those_there_are(default):
    message = fails(edited(default, "stop_when.at_least", {"velocity": 1.0}))
    assert "stop_when.at_least" in message and "'velocity'. Did you mean 'velocity_mean'?" in message
    assert "success_rate" in message


def test_settings_that_do_not_fit_one_another(default):
    assert "total_frames must be at least env.num_envs * steps = 640, got 639" in fails(
        edited(edited(default, "steps", 10), "total_frames", 639)
    )
    assert "replay.batch_size must be at most capacity, got 256 and 100" in fails(
        edited(default, "replay.capacity", 100)
    )


@pytest.mark.parametrize("key", ["robot", "env", "reward", "algo", "network", "replay", "evaluation.reward"])
def test_a_missing_key_is_named(default, key):
    where, _, name = key.rpartition(".")
    assert fails(edited(default, key, drop=True)) == f"{where or 'the configuration'} lacks {name}."


def test_a_mandatory_value_that_was_not_given_is_named():
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        assert "run" in fails(compose("evaluate"))


@pytest.mark.parametrize("target", ["gctd3.nowhere.X", "gctd3.nn.Nothing", "", "gctd3.nn", "gctd3.__version__", None])
def test_a_target_that_is_none(default, target):
    message = fails(edited(default, "env.start._target_", target))
    assert message.startswith("env.start") and "_target_" in message and repr(target) in message
