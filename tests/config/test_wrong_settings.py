"""Every wrong setting is answered with the accepted values."""

import math
import re

import pytest
from configs import composed, edited, items
from hydra import compose, initialize_config_module
from running import command, tiny
from thinned import parametrize

from gctd3.config.build import build, suggest
from gctd3.errors import ConfigError


@pytest.fixture(scope="module")
def default():
    return composed()


def fails(config):
    with pytest.raises(ConfigError) as caught:
        build(config)
    return str(caught.value)


# Mistakes.

# Mappings of terms with arbitrary names.
OF_TERMS = ["reward.terms", "evaluation.reward.terms"]
OF_TERMS += [f"task.{kind}" for kind in ("features", "terminations", "randomisations", "commands", "privileged")]


def test_a_misspelt_key_is_named_with_the_nearest_one(default):
    checked = 0
    for key, _ in items(default):
        parent, _, name = key.rpartition(".")
        if parent in ("stop_when.at_least", "stop_when.at_most", *OF_TERMS):
            continue  # names of metrics, and arbitrary names
        wrong = name[:-1] + name[-1] * 2
        message = fails(edited(default, key, rename=wrong))
        assert f"{parent}.{wrong}".lstrip(".") in message
        assert f"Did you mean {name!r}?" in message and "Accepted: " in message
        checked += 1
    assert checked > 60


def test_nothing_like_a_key_is_only_told_what_is_accepted(default):
    message = fails(edited(default, "zzz", 1))
    assert "Unknown key 'zzz'. Accepted: robot, task, env, reward" in message
    assert suggest("learning_rat", ["learning_rate", "tau"]) == " Did you mean 'learning_rate'?"
    assert suggest("zzz", ["learning_rate", "tau"]) == ""


def test_a_value_of_the_wrong_type_is_named(default):
    """Any key given a mapping where none belongs, or a text where a number belongs, is named."""
    checked = 0
    for key, _ in items(default):
        if key.startswith(("stop_when.at_least.", "stop_when.at_most.")):
            continue  # checked as one mapping, below
        message = fails(edited(default, key, {"no": "setting"}))
        named, shown = (f"{key}.no", "got 'setting'") if key in OF_TERMS else (key, "got {'no': 'setting'}")
        assert message.startswith(f"{named} must be ") and shown in message
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
        ("env.backend", "isaac", "env.backend must be one of batched, dm_control, library, got 'isaac'."),
        ("logger", "paper", "logger must be one of csv, tensorboard, wandb, mlflow, none, got 'paper'."),
        ("algo", {"tau": 0.1}, "algo must be a AlgorithmSettings (a mapping with its _target_), got {'tau': 0.1}."),
    ],
)
def test_what_is_said_of_a_wrong_type(default, key, value, expected):
    assert fails(edited(default, key, value)).startswith(expected)


BAD = {
    "env.num_envs": 0, "task.history": -1, "task.control_dt": 0.0, "env.threads": 0,
    "task.terminations.long_contact.steps": 0, "task.terminations.stuck_hip.steps": 0,
    "task.terminations.finish.distance": 0.0, "task.terminations.time_limit.steps": 0,
    "task.randomisations.joint_noise.angle": -0.1, "task.randomisations.joint_noise.velocity": -0.1,
    "reward.terms.height.frames": 0, "reward.terms.flight.frames": 0, "reward.terms.progress.steps": 0,
    "evaluation.reward.terms.height.frames": 0,
    "algo.learning_rate": 0.0, "algo.tau": 1.5, "algo.gamma": 1.0, "algo.policy_delay": 0, "algo.policy_noise": -0.2,
    "network.graph_layers": [0], "network.hidden": [],
    "exploration.learning_starts": -1, "exploration.hold": 0, "exploration.frequency": [2.0, 1.0],
    "exploration.mutation_share": 1.5,
    "exploration.noise": [0.0, 0.1], "replay.buffer_size": 0, "replay.batch_size": 0, "replay.n_step": 0,
    "evaluation.every": 0, "evaluation.episodes": 0, "evaluation.seed": -1, "robot.graph_seed": -1,
    "stop_when.evaluations": 0,
    "seed": -1, "total_frames": 0, "total_episodes": 0, "rollout_steps": 0, "gradient_steps": 0, "threads": 0,
    "keep_checkpoints": 0,
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
    assert "total_frames must be at least env.num_envs * rollout_steps = 640, got 639" in fails(
        edited(edited(default, "rollout_steps", 10), "total_frames", 639)
    )
    assert "replay.batch_size must be at most buffer_size, got 128 and 100" in fails(
        edited(default, "replay.buffer_size", 100)
    )


@pytest.mark.parametrize("warmup", ["stepping", "swinging", "jumping"])
def test_motions_evolve_only_on_robots_that_are_stepped_here(capsys, tmp_path, warmup):
    asked = ["task=walker2d", f"exploration.warmup={warmup}", f"hydra.run.dir={tmp_path / 'run'}"]
    assert command("train", *asked) == 2
    said = f"error: exploration.warmup must be rhythmic or uniform for Walker2d-v5, got {warmup}: motions are judged"
    assert said in capsys.readouterr().err and not (tmp_path / "run").exists()


@pytest.mark.parametrize("key", ["robot", "task", "env", "reward", "algo", "network", "replay", "evaluation.reward"])
def test_a_missing_key_is_named(default, key):
    where, _, name = key.rpartition(".")
    assert fails(edited(default, key, drop=True)) == f"{where or 'the configuration'} lacks {name}."


def test_a_mandatory_value_that_was_not_given_is_named():
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        assert fails(compose("report")).startswith("runs=... is required")


@pytest.mark.parametrize("target", ["gctd3.nowhere.X", "gctd3.nn.Nothing", "", "gctd3.nn", "gctd3.__version__", None])
def test_a_target_that_is_none(default, target):
    message = fails(edited(default, "task.randomisations.joint_noise._target_", target))
    assert message.startswith("task.randomisations.joint_noise") and "_target_" in message and repr(target) in message


@parametrize(
    2,
    "key, near",
    [
        ("updates", "gradient_steps"),
        ("steps", "rollout_steps"),
        ("warmup_frames", "exploration.learning_starts"),
        ("replay.capacity", "replay.buffer_size"),
        ("learning_rate", "algo.learning_rate"),
        ("algo.learning_rat", "algo.learning_rate"),
        ("algo.discount", "algo.gamma"),
        ("reward.terms.fal", "reward.terms.fall"),
        ("exploration.zzz", None),
    ],
)
def test_an_unknown_key_of_a_command_line_is_answered_with_the_nearest_by_meaning(capsys, tmp_path, key, near):
    assert command("train", *tiny(tmp_path / "run", f"{key}=3")) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: Unknown key {key!r}.{f' Did you mean {near!r}?' if near else ''} Accepted: "), (
        error
    )
