"""A training from the command line, and the files that it leaves."""

import json
import math

import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from running import Recorded, command, process, rows, tiny, train
from tensordict import TensorDict
from thinned import parametrize
from torchrl.envs.utils import ExplorationType, set_exploration_type

import gctd3
from gctd3.config.build import build
from gctd3.training.checkpoint import Checkpoints
from gctd3.training.saved_configuration import load_settings
from gctd3.training.settings import TrainSettings
from gctd3.training.stop_when import COLUMNS, StopWhen

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


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Train one run of each algorithm when first asked for: its directory and its trainer."""
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


# Files of a run.


def test_a_training_ends_with_what_to_do_next(tmp_path, capsys):
    run = train(tmp_path / "run", "algo=td3", "total_frames=160")
    said = capsys.readouterr().out
    assert f"python -m gctd3.evaluate run={run} episodes=50" in said and f"python -m gctd3.view run={run}" in said


@parametrize(4, "algorithm", ["gctd3", "td3", "ddpg", "sac"])
def test_a_run_keeps_the_contract(finished, tmp_path, algorithm):
    run = finished.copy(algorithm, tmp_path / "run")
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
    best = Checkpoints(run).best().name
    assert kept == {"step-000000000240", best, "replay"}

    assert command("evaluate", f"run={run}", "episodes=3", "threads=1") == 0
    report = json.loads((run / "evaluation.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    promised = {*PROMISED[3:], "episodes", "body_position_mean", "seeds", "versions", "gait"}
    assert promised <= set(report)
    assert report["episodes"] == 3 and report["seeds"] == {"training": 0, "evaluation": 10_000}
    assert {"gctd3", "torch", "torchrl", "mujoco"} <= set(report["versions"])


def test_load_policy_is_the_policy_that_was_evaluated_best(runs):
    run, trainer = runs("gctd3")
    policy, nodes = gctd3.load_policy(run), torch.randn(20, 8, 10)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        loaded = policy(TensorDict({"nodes": nodes}, [20]))["action"]
        actions = {
            frames: policy(TensorDict({"nodes": nodes}, [20]))["action"] for frames, policy in trainer.policies.items()
        }
    best = trainer.evaluations.best["frames"]
    assert [frames for frames, action in actions.items() if torch.equal(action, loaded)] == [best]


@parametrize(2, "algorithm", ["gctd3", "sac"])
def test_a_later_evaluation_repeats_the_one_in_training(runs, algorithm, capsys):
    run, trainer = runs(algorithm)
    best = next(row for row in rows(run) if int(row["frames"]) == trainer.evaluations.best["frames"])
    assert command("evaluate", f"run={run}", "episodes=2", "seed=1000", "threads=2") == 0
    report = json.loads((run / "evaluation.json").read_text(encoding="utf-8"))
    for name in ("return_mean", "return_std", "velocity_mean", "distance_mean", "success_rate"):
        assert report[name] == pytest.approx(float(best[name]), abs=1e-9)
    assert f"{report['return_mean']:.1f}" in capsys.readouterr().out


def test_same_seed_same_run(runs, finished):
    run, _ = runs("gctd3")
    assert rows(finished["gctd3"], drop=["wall_s"]) == rows(run, drop=["wall_s"])
    assert rows(finished["gctd3 seed 1"], drop=["wall_s"]) != rows(run, drop=["wall_s"])


@pytest.mark.nightly
def test_same_seed_same_run_in_another_process(finished, tmp_path):
    done = process("train", *tiny(tmp_path / "again", "algo=gctd3"))
    assert done.returncode == 0, done.stderr
    assert f"python -m gctd3.evaluate run={tmp_path / 'again'}" in done.stdout
    assert rows(tmp_path / "again", drop=["wall_s"]) == rows(finished["gctd3"], drop=["wall_s"])


def test_every_frame_counts_towards_the_warm_up(runs):
    _, trainer = runs("gctd3")
    assert int(trainer.explorer.frames) == 240


# The best policy, and the end of a training.


def test_best_is_what_meets_most_conditions_then_what_returns_most():
    stop = StopWhen(at_least={"return_mean": 5.0, "stride_hz": 1.0}, at_most={"hip_correlation": -0.5})
    metrics = {
        10: {"return_mean": 300.0},  # one; undefined metrics meet no condition
        20: {"return_mean": 10.0, "stride_hz": 1.5, "hip_correlation": 0.9},  # two
        30: {"return_mean": 20.0, "stride_hz": math.nan, "hip_correlation": -0.9},  # two, and returns more
        40: {"return_mean": -50.0, "stride_hz": 1.0, "hip_correlation": -0.2},  # one
    }
    assert [stop.reached(row) for row in metrics.values()] == [1, 2, 2, 1]
    assert max(metrics, key=lambda frames: stop.score(metrics[frames])) == 30
    assert not stop.all_reached(metrics[30])
    assert stop.all_reached({"return_mean": 5.0, "stride_hz": 1.0, "hip_correlation": -0.5})


def test_motions_are_recorded_where_a_condition_asks_for_them():
    assert not StopWhen(at_least={"success_rate": 1.0}, at_most={"slip_speed": None}).of_motion
    assert StopWhen(at_most={"slip_speed": 0.1}).of_motion
    assert StopWhen(at_least={"periodic_fraction": 0.9}).names == ["periodic_fraction"]


def test_the_best_checkpoint_of_a_run_is_the_best_row(runs):
    run, trainer = runs("gctd3")
    # Nothing walks after 240 frames, so that no condition is met and the return decides.
    best = max(rows(run), key=lambda row: float(row["return_mean"]))
    assert Checkpoints(run).best().name == f"best-{int(best['frames']):012d}"
    assert [path.name for path in (run / "checkpoints").glob("best-*")] == [Checkpoints(run).best().name]
    assert trainer.evaluations.best["frames"] == int(best["frames"])


EASY = ["~stop_when.at_most", "~stop_when.at_least.stride_hz", "stop_when.at_least.success_rate=0"]
EASY += ["stop_when.at_least.return_mean=-1000", "stop_when.at_least.velocity_mean=-10", "total_frames=4000"]


def test_stop_when_ends_the_training(tmp_path):
    run = train(tmp_path / "run", *EASY, "stop_when.evaluations=2")
    assert [row["frames"] for row in rows(run)] == ["80", "160"]


@pytest.mark.nightly
def test_begins_again_when_no_evaluation_meets_all_conditions(tmp_path, capsys):
    never = ["stop_when.at_least.velocity_mean=100", "stop_when.restart_after=160", "total_frames=400"]
    run = train(tmp_path / "run", *never)
    assert [(row["frames"], row["restarts"]) for row in rows(run)] == [
        ("80", "0"), ("160", "0"), ("240", "1"), ("320", "1"), ("400", "2"),
    ]  # fmt: skip
    assert "After 320 frames: no evaluation in 160 met all conditions. It begins again" in capsys.readouterr().out
    trainer = Recorded.last
    # Since 320: all of the last warm-up, and none of what came before.
    assert len(trainer.replay) == 80
    # Two after each of the 21 steps from the end of a warm-up on; the last warm-up has just ended.
    assert trainer.algorithm.updates == 2
    assert int(rows(run)[-1]["updates"]) == trainer.counters.updates == 2 * (21 + 21) + 2
    # Each restart has new weights.
    first, second = (trainer.policies[frames].state_dict() for frames in (240, 400))
    assert any((first[key] != second[key]).any() for key in first)


IMITATING = ["exploration.warmup=swinging", "exploration.gait_time=0.04", "imitation.updates=2", "imitation.retries=1"]


def test_another_gait_is_looked_for_when_the_policy_that_is_one_fails(tmp_path, capsys):
    """Once, as it is asked to; then it learns on."""
    run = train(tmp_path / "run", *IMITATING, "stop_when.at_least.velocity_mean=100", "stop_when.restart_after=null")
    assert [(row["frames"], row["restarts"]) for row in rows(run)] == [("80", "0"), ("160", "1"), ("240", "1")]
    said = capsys.readouterr().out
    assert said.count("fittest gait misses the conditions. It begins again") == 1
    assert said.count("The policy begins as the warm-up's fittest gait") == 2


def test_the_gait_is_shown_from_the_start_of_episodes(tmp_path):
    """Of 20 steps of four robots the last three are shown; before them all episodes are cut, as by a time limit."""
    train(tmp_path / "run", *IMITATING, "total_frames=80", "replay.storage=stacked", "replay.n_step=1")
    trainer = Recorded.last
    assert len(trainer.gait_imitation.demonstration) == 4 * 3
    stored = trainer.replay.buffer.torchrl[:].reshape(20, 4)
    # At 14 the last round of 6 begins; the winner is shown from 17 on, from a new start in each of three steps.
    for step in (13, 16, 17, 18):
        assert stored["next", "truncated"][step].all() and stored["next", "done"][step].all()
        assert not stored["next", "terminated"][step].all()
    # Five frames of a start are equal; the joints' noise makes it another one than the standing pose.
    frames = stored["nodes"][17].unflatten(-1, (5, 2))
    assert (frames == frames[..., :1, :]).all() and (frames[:, 0, 0, 1] == 0).all()


def test_the_last_gaits_are_tried_from_the_start_of_episodes_if_a_policy_is_to_begin_as_one(tmp_path):
    """Begin anew once, after 14 of 20 steps, where the last round begins: with a clock no more starts are needed."""
    clock = "+task.features.clock={_target_:gctd3.GaitClock}"
    stored = [*IMITATING[1:], "exploration.warmup=stepping", clock, "total_frames=80", "replay.storage=stacked"]
    for updates, expected in (2, True), (0, False):
        train(tmp_path / str(updates), *stored, "replay.n_step=1", f"imitation.updates={updates}")
        cut = Recorded.last.replay.buffer.torchrl[:].reshape(20, 4)["next", "truncated"]
        assert [step for step in range(20) if cut[step].all()] == ([13] if expected else [])


@pytest.mark.parametrize("off", ["stop_when.evaluations=null", "imitation.updates=0", "imitation.critics_first=0"])
def test_no_other_gait_is_looked_for(tmp_path, off):
    """Where nothing ends the training, without imitation, and once the actor has learnt on."""
    never = ["stop_when.at_least.velocity_mean=100", "stop_when.restart_after=null", "total_frames=160"]
    run = train(tmp_path / "run", *IMITATING, *never, off)
    assert [row["restarts"] for row in rows(run)] == ["0", "0"]


def test_does_not_begin_again_while_evaluations_meet_all_conditions(tmp_path):
    run = train(tmp_path / "run", *EASY, "stop_when.evaluations=null", "stop_when.restart_after=80", "total_frames=240")
    assert [row["restarts"] for row in rows(run)] == ["0", "0", "0"]


@pytest.mark.nightly
def test_total_episodes_ends_the_training(tmp_path):
    run = train(tmp_path / "run", "total_frames=4000", "evaluation.every=4000", "total_episodes=3")
    (row,) = rows(run)
    assert 3 * 4 < int(row["frames"]) < 1000


@pytest.mark.dm_control
def test_trains_on_dm_control(finished):
    run = finished["dm_control"]
    assert [row["frames"] for row in rows(run)] == ["80", "160", "240"]
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
    "rollout_steps": 1,
    "gradient_steps": 1,
    "task.history": 5,
    "task.control_dt": 0.02,
    "task.terminations.finish.distance": 15.0,
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
    algorithm = settings.algo.build(settings.setup().architecture())
    assert all(isinstance(optimizer, torch.optim.Adam) for optimizer in algorithm.optimizers.values())
    assert settings.total_frames >= settings.total_episodes * settings.task.terminations["time_limit"].steps
    assert settings.stop_when.evaluations is None

    ours = ["env.num_envs", "gradient_steps", "network.hidden", "total_frames"]
    few = ["exploration.learning_starts=20", "evaluation.every=10_000", "total_episodes=3"]
    (row,) = rows(train(tmp_path / "run", "experiment=paper", *few, without=ours))
    assert 0 <= int(row["updates"]) - (int(row["frames"]) - 20) <= 2  # one a step, past the warm-up
