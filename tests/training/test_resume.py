"""Stopped and extended runs equal runs that were left alone."""

import json
import shutil
from itertools import product

import pytest
import torch
from fuzzing import Idle
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from resuming import TIMED, StopAfter, assert_same_run, stopped
from running import TINY, Recorded, command, rows, train
from thinned import parametrize

from gctd3.config.build import build
from gctd3.runs.load import load_policy
from gctd3.training.checkpoint import Checkpoints
from gctd3.training.saved_configuration import (
    changed,
    changes_of_arithmetic,
    command_line,
    load_config,
    load_settings,
    save_config,
)

ALGORITHMS = ("gctd3", "td3", "ddpg", "sac")
# The state of a backend is the same for all algorithms, and that of an algorithm is tested by itself as well.
QUICK = [("gctd3", "batched", "frames")]
CASES = [
    pytest.param(*case, marks=[] if case in QUICK else [pytest.mark.nightly])
    for case in [*product(ALGORITHMS, ("batched", "dm_control"), ["frames"]), ("td3", "batched", "stacked")]
]


@pytest.mark.parametrize(("algo", "backend", "storage"), CASES)
def test_stopped_and_resumed_equals_left_alone(finished, tmp_path, algo, backend, storage):
    settings = [f"algo={algo}", f"env.backend={backend}", f"replay.storage={storage}"]
    left_alone = {("batched", "frames"): algo, ("dm_control", "frames"): {"gctd3": "dm_control"}.get(algo)}
    name = left_alone.get((backend, storage))
    whole = finished[name] if name else train(tmp_path / "whole", *settings)
    # In the middle of episodes, between two evaluations.
    part = stopped(tmp_path / "part", 128, *settings)
    assert [row["frames"] for row in rows(part)] == ["80"]
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


@pytest.mark.nightly
def test_stopped_in_the_warm_up_and_twice_more(finished, tmp_path):
    whole = finished["gctd3"]
    part = stopped(tmp_path / "part", 40)

    class Again(Recorded):
        def run(self, stop=None):
            return super().run(StopAfter(self, self.counters.frames + 60))

    assert command("train", f"resume={part}", trainer=Again) == 0
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


@pytest.mark.nightly
def test_stopped_while_it_imitates_a_gait(tmp_path, capsys):
    """The gait is known again after the warm-up in which it evolved, and pulls as strongly as before."""
    settings = [
        "robot=quadruped",
        "robot.action_scale=0.3",
        "exploration.warmup=stepping",
        "exploration.gait_time=0.1",
        "imitation.updates=3",
        "imitation.critics_first=2",
    ]
    whole = train(tmp_path / "whole", *settings)
    assert "The policy begins as the warm-up's fittest gait" in capsys.readouterr().out
    part = stopped(tmp_path / "part", 128, *settings)
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


@pytest.mark.nightly
@pytest.mark.parametrize("frames", [64, 128])
def test_stopped_while_it_imitates_a_gait_without_a_clock(tmp_path, capsys, frames):
    """What the policy learns the gait from is known again: stopped in the warm-up's last round, and after it."""
    settings = [
        "exploration.warmup=swinging",
        "exploration.gait_time=0.04",
        "exploration.least_speed=1.0",
        "imitation.updates=3",
        "imitation.initial_learning_rate=0.001",
        "imitation.critics_first=2",
    ]
    whole = train(tmp_path / "whole", *settings)
    assert "The policy begins as the warm-up's fittest gait" in capsys.readouterr().out
    part = stopped(tmp_path / "part", frames, *settings)
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


@pytest.mark.nightly
def test_stopped_while_it_is_held_to_the_policy_of_another_run(tmp_path, finished):
    """The other run need not be there any more."""
    other = finished.copy("gctd3", tmp_path / "other")
    settings = [f"init={other}", "imitation.updates=1", "imitation.critics_first=2"]
    whole = train(tmp_path / "whole", *settings)
    part = stopped(tmp_path / "part", 128, *settings)
    shutil.rmtree(other)
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


@pytest.mark.nightly
@pytest.mark.parametrize("storage", ["frames", "stacked"])
def test_stopped_after_it_had_begun_again(tmp_path, storage):
    never = ["stop_when.at_least.velocity_mean=100", "stop_when.restart_after=80", "exploration.learning_starts=40"]
    settings = [*never, f"replay.storage={storage}", "total_frames=320"]
    whole = train(tmp_path / "whole", *settings)
    assert [row["restarts"] for row in rows(whole)] == ["0", "1", "2", "3"]
    part = stopped(tmp_path / "part", 200, *settings)
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


@pytest.mark.nightly
def test_more_frames_extend_a_finished_run(finished, tmp_path):
    run = train(tmp_path / "run", "total_frames=160", without=["total_frames"])
    assert command("train", f"resume={run}") == 2
    assert command("train", f"resume={run}", "total_frames=240") == 0
    assert rows(run, drop=TIMED) == rows(finished["gctd3"], drop=TIMED)
    # It is now a run of 240 frames.
    assert command("train", f"resume={run}") == 2


@pytest.mark.nightly
def test_other_settings_are_refused_by_name_and_harmless_ones_taken(finished, tmp_path, capsys):
    run = finished.copy("gctd3", tmp_path / "run")
    capsys.readouterr()
    assert command("train", f"resume={run}", "algo.gamma=0.9", "gradient_steps=3", "logger=csv") == 2
    error = capsys.readouterr().err
    assert "algo.gamma: 0.99 -> 0.9" in error
    assert "gradient_steps: 2 -> 3" in error
    assert "logger:" not in error
    assert command("train", f"resume={run}", "algo=sac") == 2
    assert "algo._target_: 'gctd3.TD3Settings' -> 'gctd3.SACSettings" in capsys.readouterr().err
    assert command("train", f"resume={run}", "logger=csv", "total_frames=320") == 0
    assert [row["frames"] for row in rows(run)] == ["80", "160", "240", "320"]
    assert (run / "csv").is_dir()


BOUND, RETURN, ENOUGH = (
    f"stop_when.{key}" for key in ("at_least.train_episodes", "at_least.return_mean", "evaluations")
)
HISTORY = {
    "total_frames=240 logger=none stop_when=never": {"total_frames": 240, "logger": "none", ENOUGH: None},
    "total_frames=160 logger=csv stop_when=walk": {"total_frames": 160, "logger": "csv", ENOUGH: 1},
    "logger=none total_frames=240 stop_when=never": {"total_frames": 240, "logger": "none", ENOUGH: None},
    f"stop_when=walk +{BOUND}=5 {RETURN}=1": {BOUND: 5, RETURN: 1, ENOUGH: 1},
    f"{BOUND}=6 stop_when.at_least={{return_mean:2}}": {BOUND: 6, RETURN: 2},
    f"{RETURN}=1 +{BOUND}=5": {BOUND: 5, RETURN: 1},
    # The last of a line counts.
    "threads=2 logger=csv logger=none": {"threads": 2, "logger": "none"},
    "threads=3 threads=2": {"threads": 2},
    "threads=2 threads=3": {"threads": 3},
}


@pytest.mark.nightly
def test_a_setting_counts_that_an_earlier_command_line_has_too(tmp_path):
    wanted = {}
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        save_config(tmp_path, compose("config"), [])
        for line, values in HISTORY.items():
            wanted |= values
            save_config(tmp_path, *changed(tmp_path, "config", line.split()))
            saved = load_config(tmp_path)
            assert {key: OmegaConf.select(saved, key) for key in wanted} == wanted, line
        # Hydra itself reads the whole line alike.
        kept = compose("config", command_line(tmp_path))
        assert {key: OmegaConf.select(kept, key) for key in wanted} == wanted
        # A sweep that goes on repeats its line, and nothing is added to it.
        assert changed(tmp_path, "config", command_line(tmp_path)) == (saved, command_line(tmp_path))


@parametrize(3, "line", ["stop_when=never", "~stop_when.at_least.success_rate", "~stop_when.at_most"])
def test_a_setting_can_be_left_out(tmp_path, line):
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        save_config(tmp_path, compose("config"), [])
        save_config(tmp_path, *changed(tmp_path, "config", [line]))
        assert load_settings(tmp_path) == build(compose("config", [line]))


def test_keys_of_the_options_that_the_run_chose_are_known(tmp_path, capsys):
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        save_config(tmp_path, compose("config", ["collector=process"]), ["collector=process"])
    assert command("train", f"resume={tmp_path}", "collector.workers=1", "seed=7") == 2
    error = capsys.readouterr().err
    assert "seed: 0 -> 7" in error and "collector.workers:" not in error
    assert command("train", f"resume={tmp_path}", "collector=inline", "collector.workers=1") == 2
    assert "Unknown key 'collector.workers'" in capsys.readouterr().err


@pytest.mark.nightly
def test_the_csv_logger_goes_back_to_the_checkpoint(tmp_path):
    whole = train(tmp_path / "whole", "logger=csv")
    part = stopped(tmp_path / "part", 176, "logger=csv")
    shutil.copytree(part / "checkpoints", tmp_path / "kept")
    assert command("train", f"resume={part}") == 0
    # Back to the moment of the stop, as if what came after it had never been saved.
    shutil.rmtree(part / "checkpoints")
    shutil.copytree(tmp_path / "kept", part / "checkpoints")
    assert command("train", f"resume={part}") == 0
    files = sorted(path.relative_to(whole / "csv") for path in (whole / "csv").rglob("*.csv"))
    assert len(files) > 5
    for file in files:
        if "wall" not in file.name:
            assert (part / "csv" / file).read_text() == (whole / "csv" / file).read_text(), file


@pytest.mark.nightly
def test_tensorboard_goes_back_to_the_checkpoint(tmp_path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    part = stopped(tmp_path / "part", 96, "logger=tensorboard")
    shutil.copytree(part / "checkpoints", tmp_path / "kept")
    for _ in range(2):
        shutil.rmtree(part / "checkpoints")
        shutil.copytree(tmp_path / "kept", part / "checkpoints")
        assert command("train", f"resume={part}") == 0
    (folder,) = {file.parent for file in part.rglob("events*")}
    events = accumulator.EventAccumulator(str(folder)).Reload()
    assert [event.step for event in events.Scalars("evaluation/return_mean")] == [80, 160, 240]


@pytest.mark.parametrize("missing", ["", "empty"])
def test_no_run_to_resume(tmp_path, capsys, missing):
    if missing:
        (tmp_path / "run").mkdir()
    assert command("train", f"resume={tmp_path / 'run'}") == 2
    assert "there is no run to continue" in capsys.readouterr().err
    assert [path.name for path in tmp_path.rglob("*")] == (["run"] if missing else [])


@pytest.mark.nightly
def test_a_damaged_checkpoint_is_passed_over(finished, tmp_path, capsys):
    whole = finished["gctd3"]
    part = stopped(tmp_path / "part", 160, "checkpoint_every=0.001")
    again = shutil.copytree(part, tmp_path / "again")
    newest, before = sorted((part / "checkpoints").glob("step-*"), reverse=True)[:2]
    state = newest / "state.safetensors"
    damaged = bytearray(state.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    state.write_bytes(damaged)
    capsys.readouterr()
    assert command("train", f"resume={part}") == 0
    error = capsys.readouterr().err
    assert "Passed over a checkpoint" in error
    assert str(state) in error
    assert_same_run(whole, part)
    # A part of the replay that only the newest names is damaged: it must not live on in those after it.
    newest_part = max((again / "checkpoints" / "replay").iterdir())
    newest_part.write_bytes(newest_part.read_bytes()[:-1])
    assert command("train", f"resume={again}") == 0
    assert str(newest_part) in capsys.readouterr().err
    assert_same_run(whole, again)
    for path in (part / "checkpoints").glob("step-*"):
        (path / "manifest.json").write_text("{")
    assert command("train", f"resume={part}") == 2
    assert "checkpoints in" in capsys.readouterr().err
    assert before.name < newest.name


@pytest.mark.nightly
@pytest.mark.parametrize("first", [True, False])
def test_the_last_word_counts_for_every_setting_that_may_change(tmp_path, first):
    """Whether a setting stood on the first command line or not, and however often it goes to and fro."""
    fro = ["keep_checkpoints=2", "time_limit=1", "logger=csv", "stop_when.evaluations=2", "threads=1", "device=cpu"]
    to = ["keep_checkpoints=5", "time_limit=2", "logger=none", "stop_when.evaluations=3", "threads=2", "device=cuda"]
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        line = fro if first else []
        save_config(tmp_path, compose("config", line), line)
        for line in (to, fro, to, [*to, *fro], fro, to):
            save_config(tmp_path, *changed(tmp_path, "config", line))
            saved = load_config(tmp_path)
            for item in dict(word.split("=") for word in line).items():
                assert str(OmegaConf.select(saved, item[0])) == item[1]


def test_a_share_of_the_cores_does_not_outlast_a_word(tmp_path):
    """Runs side by side get threads that no command line names."""
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        config = compose("config", [])
        OmegaConf.update(config, "threads", 1)
        save_config(tmp_path, config, [])
        assert changed(tmp_path, "config", ["keep_checkpoints=3"])[0].threads == 1
        assert changed(tmp_path, "config", ["threads=null"])[0].threads is None


@parametrize(
    2,
    ("change", "said"),
    [
        ("threads=2", "threads 1 -> 2"),
        ("threads=null", "threads 1 -> None"),
        ("env.threads=2", None),
        ("logger=csv", None),
    ],
)
def test_a_setting_that_changes_numbers_is_named(tmp_path, change, said):
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        save_config(tmp_path, compose("config", ["threads=1"]), ["threads=1"])
        before, (after, _) = load_config(tmp_path), changed(tmp_path, "config", [change])
    line = changes_of_arithmetic(before, after)
    assert line is None if said is None else line.startswith(f"{said}: ")


def test_a_resumed_run_says_that_its_numbers_change(finished, tmp_path, monkeypatch, capsys):
    run = finished.copy("gctd3", tmp_path / "run")
    monkeypatch.setattr(torch, "set_num_threads", lambda count: None)  # other tests of this process have one
    capsys.readouterr()
    assert command("train", f"resume={run}", "total_frames=400", "threads=2", trainer=Idle) == 0
    assert "threads 1 -> 2: from here on" in capsys.readouterr().out


def damage_manifest(best):
    (best / "manifest.json").write_text("{")


def damage_policy(best):
    (best / "policy.safetensors").write_bytes(b"0")


@pytest.mark.nightly
@pytest.mark.parametrize("damage", [shutil.rmtree, damage_manifest, damage_policy])
def test_a_lost_best_policy_is_noticed_and_replaced(finished, tmp_path, capsys, damage):
    run = finished.copy("gctd3", tmp_path / "run")
    (best,) = (run / "checkpoints").glob("best-*")
    damage(best)
    capsys.readouterr()
    assert command("train", f"resume={run}", "total_frames=320") == 0
    error = capsys.readouterr().err
    assert f"of {int(best.name[5:]):,} steps, is lost" in error and str(run / "checkpoints") in error
    assert load_policy(run) is not None
    assert Checkpoints(run).newest()[0]["best"]["frames"] == 320


@pytest.mark.nightly
def test_a_best_policy_that_is_made_again_is_not_lost(finished, tmp_path, capsys):
    """The last one came after the checkpoint, and the one before was deleted for it."""
    whole, run = finished["gctd3"], stopped(tmp_path / "run", 128)
    for old in (run / "checkpoints").glob("best-*"):
        old.rename(old.with_name("best-000000000160"))
    capsys.readouterr()
    assert command("train", f"resume={run}") == 0
    assert "lost" not in capsys.readouterr().err
    assert rows(whole, drop=TIMED) == rows(run, drop=TIMED)


@parametrize(4, "place", ["checkpoints/step-000000000240", "checkpoints/replay", "checkpoints", ".hydra"])
def test_a_link_in_a_run_is_refused_by_its_path(finished, tmp_path, capsys, place):
    """What a resumed run deletes and writes must be its own."""
    run = finished.copy("gctd3", tmp_path / "run")
    elsewhere = (run / place).rename(tmp_path / "elsewhere")
    (elsewhere / "precious").write_text("precious")
    (run / place).symlink_to(elsewhere)
    before = sorted(elsewhere.rglob("*"))
    capsys.readouterr()
    assert command("train", f"resume={run}", "total_frames=320") == 2
    error = capsys.readouterr().err
    assert f"{run / place} is a symbolic link, to {elsewhere}" in error and "Traceback" not in error
    assert sorted(elsewhere.rglob("*")) == before


@pytest.mark.nightly
def test_a_run_may_be_reached_by_a_link(finished, tmp_path):
    run = finished.copy("gctd3", tmp_path / "run")
    (tmp_path / "latest").symlink_to(run)
    assert command("train", f"resume={tmp_path / 'latest'}", "total_frames=320") == 0


@pytest.mark.nightly
def test_a_sweep_goes_on_where_it_stopped(finished, tmp_path):
    whole = {0: finished["gctd3"], 1: finished["gctd3 seed 1"]}
    settings = [f"{key}={value}" for key, value in TINY.items()]
    sweep = ["-m", *settings, "seed=0,1", f"hydra.sweep.dir={tmp_path / 'sweep'}", "hydra.sweep.subdir=${seed}"]

    class Stopped(Recorded):
        def run(self, stop=None):
            return super().run(StopAfter(self, 128) if self.settings.seed else None)

    assert command("train", *sweep, trainer=Stopped) == 0
    progress = (tmp_path / "sweep" / "0" / "progress.csv").read_text()
    assert command("train", *sweep) == 0
    assert (tmp_path / "sweep" / "0" / "progress.csv").read_text() == progress
    for seed, run in whole.items():
        assert_same_run(run, tmp_path / "sweep" / str(seed))


def test_manifests_say_what_they_are_of(finished):
    run = finished["gctd3"]
    for path in (Checkpoints(run).best(), *(run / "checkpoints").glob("step-*")):
        content = json.loads((path / "manifest.json").read_text())["content"]
        assert content["format"] == 2
        assert content["versions"]["torch"] == torch.__version__.split("+")[0] or content["versions"]["torch"]
        assert content["config"]["env"]["num_envs"] == TINY["env.num_envs"]
        assert ["body", "hip_right"] in content["graph"]["edges"]
