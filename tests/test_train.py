"""From the command line to what a run leaves behind, and what is said when the command line is wrong."""

import copy
import csv
import importlib
import json
import logging
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

import gctd3
from gctd3 import trainer as trainer_module
from gctd3.checkpoint import Checkpoints, load_settings
from gctd3.settings import build
from gctd3.train_settings import COLUMNS, StopWhen, TrainSettings
from gctd3.trainer import Trainer

PROMISED = (
    "frames",
    "updates",
    "wall_s",
    "return_mean",
    "return_std",
    "velocity_mean",
    "distance_mean",
    "success_rate",
)
# Four robots for 60 steps, the first 20 to warm up.
TINY = {
    "env.num_envs": 4,
    "env.threads": 1,
    "threads": 1,
    "logger": "none",
    "total_frames": 240,
    "exploration.warmup_frames": 80,
    "updates": 2,
    "evaluation.every": 80,
    "evaluation.episodes": 2,
    "replay.batch_size": 16,
    "replay.capacity": 1000,
    "network.hidden": "[16,16]",
}


class Recorded(Trainer):
    """A trainer that keeps a copy of every policy that it evaluated, by frames, for the test to look at."""

    last = None

    def __init__(self, settings, directory):
        super().__init__(settings, directory)
        self.policies = {}
        Recorded.last = self

    def _evaluate(self, frames, wall):
        self.policies[frames] = copy.deepcopy(self.algorithm.policy())
        return super()._evaluate(frames, wall)


def command(name, *arguments):
    """``python -m gctd3.NAME ARGUMENTS`` in this process; its exit code."""
    root, state = logging.getLogger(), torch.random.get_rng_state()
    handlers, level = list(root.handlers), root.level
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [f"gctd3.{name}", *map(str, arguments)])
        patch.setattr(trainer_module, "Trainer", Recorded)
        try:
            importlib.import_module(f"gctd3.{name}").main()
        except SystemExit as end:
            return end.code
        finally:  # Hydra sets logging up for the process
            root.handlers[:], root.level = handlers, level
            torch.random.set_rng_state(state)
    return 0


def process(name, *arguments):
    """The same in a process of its own."""
    return subprocess.run([sys.executable, "-m", f"gctd3.{name}", *arguments], capture_output=True, text=True)


def tiny(directory, *overrides, without=()):
    return [f"{k}={v}" for k, v in TINY.items() if k not in without] + [f"hydra.run.dir={directory}", *overrides]


def train(directory, *overrides, without=()):
    assert command("train", *tiny(directory, *overrides, without=without)) == 0
    return directory


def rows(run, drop=()):
    with (run / "progress.csv").open(encoding="utf-8") as file:
        return [{k: v for k, v in row.items() if k not in drop} for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """One run of each algorithm, trained when first asked for: its directory and its trainer."""
    made = {}

    def get(algorithm):
        if algorithm not in made:
            directory = tmp_path_factory.mktemp(algorithm) / "run"
            made[algorithm] = (train(directory, f"algo={algorithm}"), Recorded.last)
        return made[algorithm]

    return get


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


# What a run leaves behind.


@pytest.mark.parametrize("algorithm", ["gctd3", "td3", "ddpg", "sac"])
def test_a_run_keeps_the_contract(runs, algorithm):
    run, _ = runs(algorithm)
    text = (run / ".hydra" / "config.yaml").read_text(encoding="utf-8")
    assert "${" not in text and "???" not in text
    settings = load_settings(run)
    assert isinstance(settings, TrainSettings) and settings.replay.batch_size == 16
    assert bool(settings.network.graph_layers) == (algorithm == "gctd3")

    table = rows(run)
    assert tuple(table[0]) == COLUMNS and COLUMNS[: len(PROMISED)] == PROMISED
    assert [int(row["frames"]) for row in table] == [80, 160, 240]
    assert all(math.isfinite(float(row[column])) for row in table for column in PROMISED)
    # Two updates after each of the 40 steps past the warm-up.
    assert 80 <= int(table[-1]["updates"]) <= 84

    kept = {path.name for path in (run / "checkpoints").iterdir()}
    assert "checkpoint-000000000240" in kept and len(kept) <= 2  # the newest and the best

    assert command("evaluate", f"run={run}", "episodes=3", "threads=1") == 0
    report = json.loads((run / "evaluation.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    promised = {*PROMISED[3:], "episodes", "body_position_mean", "seeds", "versions", "gait"}
    assert promised <= set(report)
    assert report["episodes"] == 3 and report["seeds"] == {"training": 0, "evaluation": 10_000}
    assert {"gctd3", "torch", "torchrl", "mujoco"} <= set(report["versions"])


def test_load_policy_is_the_policy_that_was_judged_best(runs):
    run, trainer = runs("gctd3")
    policy, nodes = gctd3.load_policy(run), torch.randn(20, 8, 10)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        loaded = policy(TensorDict({"nodes": nodes}, [20]))["action"]
        actions = {
            frames: judged(TensorDict({"nodes": nodes}, [20]))["action"] for frames, judged in trainer.policies.items()
        }
    assert [frames for frames, action in actions.items() if torch.equal(action, loaded)] == [trainer.best["frames"]]


@pytest.mark.parametrize("algorithm", ["gctd3", "sac"])
def test_a_later_evaluation_repeats_the_one_in_training(runs, algorithm, capsys):
    run, trainer = runs(algorithm)
    best = next(row for row in rows(run) if int(row["frames"]) == trainer.best["frames"])
    assert command("evaluate", f"run={run}", "episodes=2", "seed=1000", "threads=2") == 0
    report = json.loads((run / "evaluation.json").read_text(encoding="utf-8"))
    for name in ("return_mean", "return_std", "velocity_mean", "distance_mean", "success_rate"):
        assert report[name] == pytest.approx(float(best[name]), abs=1e-9)
    assert f"{report['return_mean']:.1f}" in capsys.readouterr().out


def test_same_seed_same_run_also_in_another_process(runs, tmp_path):
    run, _ = runs("gctd3")
    done = process("train", *tiny(tmp_path / "again", "algo=gctd3"))
    assert done.returncode == 0, done.stderr
    assert f"python -m gctd3.evaluate run={tmp_path / 'again'}" in done.stdout
    assert rows(tmp_path / "again", drop=["wall_s"]) == rows(run, drop=["wall_s"])
    other = train(tmp_path / "other", "seed=1")
    assert rows(other, drop=["wall_s"]) != rows(run, drop=["wall_s"])


def test_every_frame_counts_towards_the_warm_up(runs):
    _, trainer = runs("gctd3")
    assert int(trainer.explorer.frames) == 240


# What is best, and when it is enough.


def test_best_is_what_meets_most_conditions_then_what_returns_most(tmp_path):
    stop = StopWhen(at_least={"return_mean": 5.0, "stride_hz": 1.0}, at_most={"hip_correlation": -0.5})
    metrics = {
        10: {"return_mean": 300.0},  # one; undefined metrics meet no condition
        20: {"return_mean": 10.0, "stride_hz": 1.5, "hip_correlation": 0.9},  # two
        30: {"return_mean": 20.0, "stride_hz": math.nan, "hip_correlation": -0.9},  # two, and returns more
        40: {"return_mean": -50.0, "stride_hz": 1.0, "hip_correlation": -0.2},  # one
    }
    assert [stop.reached(row) for row in metrics.values()] == [1, 2, 2, 1]
    kept = Checkpoints(tmp_path, keep=1)
    for frames, row in metrics.items():
        kept.save(frames, stop.score(row), row, value=torch.nn.Linear(1, 1))
    assert kept.best().name == "checkpoint-000000000030"
    assert sorted(path.name[-2:] for path in (tmp_path / "checkpoints").iterdir()) == ["30", "40"]
    assert not stop.all_reached(metrics[30])
    assert stop.all_reached({"return_mean": 5.0, "stride_hz": 1.0, "hip_correlation": -0.5})


def test_the_best_checkpoint_of_a_run_is_the_best_row(runs):
    run, trainer = runs("gctd3")
    # Nothing walks after 240 frames, so that no condition is met and the return decides.
    best = max(rows(run), key=lambda row: float(row["return_mean"]))
    assert Checkpoints(run).best().name == f"checkpoint-{int(best['frames']):012d}"
    assert trainer.best["frames"] == int(best["frames"])


EASY = ["~stop_when.at_most", "~stop_when.at_least.stride_hz", "stop_when.at_least.success_rate=0"]
EASY += ["stop_when.at_least.return_mean=-1000", "stop_when.at_least.velocity_mean=-10", "total_frames=4000"]


def test_stop_when_ends_the_training(tmp_path):
    run = train(tmp_path / "run", *EASY, "stop_when.evaluations=2")
    assert [row["frames"] for row in rows(run)] == ["80", "160"]


def test_total_episodes_ends_the_training(tmp_path):
    run = train(tmp_path / "run", "total_frames=4000", "evaluation.every=4000", "total_episodes=3")
    (row,) = rows(run)
    assert 3 * 4 < int(row["frames"]) < 1000


def test_trains_on_dm_control(tmp_path):
    run = train(tmp_path / "run", "env.backend=dm_control", "env.num_envs=2", "total_frames=160")
    assert [row["frames"] for row in rows(run)] == ["80", "160"]
    assert int(rows(run)[-1]["updates"]) >= 80


# The paper.

TABLE_4 = {
    "total_episodes": 10_000,
    "algo.policy_delay": 2,
    "algo.learning_rate": 3e-4,
    "algo.tau": 0.001,
    "network.graph_layers": [32, 32, 16],
    "network.hidden": [256, 256],
    "algo.gamma": 0.99,
    # One robot, one update a step; nothing that the paper does not have.
    "env.num_envs": 1,
    "steps": 1,
    "updates": 1,
    "env.history": 5,
    "env.control_dt": 0.02,
    "env.endings.finish": 15.0,
    "network.norm": "none",
    "algo.average_policy": False,
    "algo.privileged_critic": False,
    "replay.n_step": 1,
    "replay.mirror": False,
    "robot.graph": "tree",
}


def test_the_papers_experiment_is_table_4(tmp_path):
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        config = compose("config", ["experiment=paper"])
    assert {key: OmegaConf.to_object(OmegaConf.create({"value": OmegaConf.select(config, key)}))["value"]
            for key in TABLE_4} == TABLE_4  # fmt: skip
    assert config.reward == config.evaluation.reward
    settings = build(config)
    # The optimiser is Adam; the episodes end the training, whatever their length.
    algorithm = settings.algo.build(settings.architecture())
    assert all(type(optimizer) is torch.optim.Adam for optimizer in algorithm.optimizers.values())
    assert settings.total_frames >= settings.total_episodes * settings.env.endings.time_limit
    assert settings.stop_when.evaluations is None

    ours = ["env.num_envs", "updates", "network.hidden", "total_frames"]
    few = ["exploration.warmup_frames=20", "evaluation.every=10_000", "total_episodes=3"]
    (row,) = rows(train(tmp_path / "run", "experiment=paper", *few, without=ours))
    assert 0 <= int(row["updates"]) - (int(row["frames"]) - 20) <= 2  # one a step, past the warm-up


# What is said when something is wrong.


def answer(capsys, name, *arguments):
    """The one message on stderr of a command that refuses."""
    capsys.readouterr()
    assert command(name, *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("error: ") == 1 and "Traceback" not in error
    return error


def assert_untrained(directory):
    assert not [path for path in directory.rglob("*") if path.name in ("progress.csv", "checkpoints")]


WRONG = {
    "algo=ppo": ["'algo/ppo'", "ddpg", "gctd3", "sac", "td3"],
    "experiment=papr": ["'experiment/papr'", "paper"],
    "algo.learning_rat=1": ["'algo.learning_rat'", "Did you mean 'algo.learning_rate'?", "algo.gamma"],
    "algo=sac algo.alph=0.1": ["'algo.alph'", "Did you mean 'algo.alpha'?"],
    "total_frame=9": ["'total_frame'", "Did you mean 'total_frames'?"],
    "+algo.momentum=0.9": ["'algo.momentum'", "Accepted: learning_rate"],
    "replay.batch_size=many": ["replay.batch_size", "a whole number", "'many'"],
    "replay.batch_size=": ["replay.batch_size", "a whole number", "''"],
    "algo.average_policy=often": ["algo.average_policy", "true or false", "'often'"],
    "env.num_envs=-3": ["env.num_envs", "at least 1", "-3"],
    "env.num_envs=0": ["env.num_envs", "at least 1", "0"],
    "replay.capacity=0": ["replay.capacity", "at least 1", "0"],
    "network.hidden=[64,0]": ["network.hidden", "at least 1", "[64, 0]"],
    "evaluation.episodes=0": ["evaluation.episodes", "at least 1", "0"],
    "total_frames=-1": ["total_frames", "at least", "-1"],
    "env.control_dt=0.013": ["control_dt", "0.005", "0.013"],
    "robot.graph=ring": ["robot.graph", "tree, authors, edgeless, complete, random", "'ring'"],
    "robot.name=quadruped": ["'quadruped'", "biped", ".xml"],
    "robot.name=nowhere.xml": ["nowhere.xml"],
    "seed=[": ["seed=["],
}


@pytest.mark.parametrize("arguments", WRONG)
def test_a_wrong_command_line_is_answered(capsys, tmp_path, arguments):
    error = answer(capsys, "train", *tiny(tmp_path / "run", *arguments.split()))
    assert all(words in error for words in WRONG[arguments]), error
    assert_untrained(tmp_path)


@pytest.mark.parametrize("argument", ["algo=ppo", "env.num_envs=0"])
def test_a_process_ends_with_2_and_one_message(tmp_path, argument):
    done = process("train", *tiny(tmp_path / "run", argument))
    assert done.returncode == 2
    assert done.stderr.startswith("error: ") and "Traceback" not in done.stderr + done.stdout
    assert_untrained(tmp_path)


MJCF = {
    "unclosed": ("<mujoco><worldbody></mujoco>", "not an MJCF"),
    "no actuator": ("", "no actuator"),
}


@pytest.mark.parametrize("case", MJCF)
def test_an_unusable_mjcf_is_answered(capsys, tmp_path, robot, case):
    text, said = MJCF[case]
    file = tmp_path / "my_robot.xml"
    file.write_text(text or re.sub("<actuator>.*</actuator>", "", robot.path.read_text(), flags=re.DOTALL))
    error = answer(capsys, "train", *tiny(tmp_path / "run", f"robot.name={file}"))
    assert str(file) in error and said in error
    assert_untrained(tmp_path)


def test_an_output_that_cannot_be_written_is_answered(capsys, tmp_path):
    (tmp_path / "file").write_text("in the way")
    error = answer(capsys, "train", *tiny(tmp_path / "file" / "run"))
    assert str(tmp_path / "file") in error
    assert (tmp_path / "file").read_text() == "in the way"


# Runs that are none.


@pytest.fixture
def broken(runs, tmp_path):
    """A copy of a run, to be broken."""
    return Path(shutil.copytree(runs("gctd3")[0], tmp_path / "broken"))


def of_another_version(run):
    for manifest in run.glob("checkpoints/*/manifest.json"):
        content = json.loads(manifest.read_text())
        content["metadata"]["format"] = 99
        manifest.write_text(json.dumps(content))


BREAK = {
    "no config": (lambda run: (run / ".hydra" / "config.yaml").unlink(), "config.yaml"),
    "not YAML": (lambda run: (run / ".hydra" / "config.yaml").write_text("a: [1"), "config.yaml"),
    "another key": (lambda run: re_write(run / ".hydra" / "config.yaml", "steps: 1", "colour: red"), "'colour'"),
    "no checkpoint": (lambda run: shutil.rmtree(run / "checkpoints"), "No checkpoint"),
    "another version": (of_another_version, "format 99"),
    "no tensors": (lambda run: [f.unlink() for f in run.glob("checkpoints/*/components/*/state/*")], "checkpoint-"),
    "another network": (
        lambda run: re_write(run / ".hydra" / "config.yaml", "- 16\n    - 16", "- 16\n    - 17"),
        "checkpoint-",
    ),
}


def re_write(file, old, new):
    text = file.read_text()
    assert old in text or old.replace("    ", "  ") in text, text
    file.write_text(text.replace(old, new).replace(old.replace("    ", "  "), new.replace("    ", "  ")))


@pytest.mark.parametrize("case", BREAK)
def test_a_run_that_cannot_be_used_is_answered(capsys, broken, case):
    damage, said = BREAK[case]
    damage(broken)
    error = answer(capsys, "evaluate", f"run={broken}", "episodes=1")
    assert str(broken) in error and said in error
    assert not (broken / "evaluation.json").exists()


@pytest.mark.parametrize("name", ["evaluate", "render"])
def test_a_run_that_is_not_there_is_answered(capsys, tmp_path, name):
    assert answer(capsys, name) == "error: run=... is required; --help shows how.\n"
    assert str(tmp_path / "nowhere") in answer(capsys, name, f"run={tmp_path / 'nowhere'}")
    assert "not a run" in answer(capsys, name, f"run={tmp_path}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name, argument, said",
    [
        ("evaluate", "episodes=0", "episodes must be at least 1, got 0."),
        ("evaluate", "threads=0", "threads must be at least 1"),
        ("evaluate", "seed=-1", "seed must be at least 0, got -1."),
        ("evaluate", "episode=3", "Did you mean 'episodes'?"),
        ("render", "width=0", "width must be at least 1, got 0."),
        ("render", "out=walk.bmp", "out must end in .png or .gif, got 'walk.bmp'."),
        ("render", "out=nowhere/walk.png", "nowhere"),
        ("render", "camera=behind", "side, three_quarter"),
    ],
)
def test_a_wrong_setting_of_the_other_commands_is_answered(capsys, runs, name, argument, said):
    assert said in answer(capsys, name, f"run={runs('gctd3')[0]}", argument)
