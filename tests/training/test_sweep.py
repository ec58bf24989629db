"""Sweeps: the ready ones, runs side by side, stopped and crashed runs, and their names in a report."""

import contextlib
import functools
import math
import os
import signal
import subprocess
import sys
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import pytest
from hydra import compose, initialize_config_module
from hydra.errors import MissingConfigException
from omegaconf import OmegaConf
from resuming import assert_same_run
from running import TINY, Recorded, command, rows, train, wait_for
from thinned import parametrize

from gctd3.comparison.groups import groups_of
from gctd3.comparison.runs import find_runs
from gctd3.comparison.verdict import verdict
from gctd3.config.build import build
from gctd3.config.explanation import explain
from gctd3.errors import NumericalError
from gctd3.training import session, sweep
from gctd3.training.saved_configuration import save_config

READY = {"table5": 4, "graphs": 6, "history": 4}
NAMES = {
    "table5": ["gctd3", "ddpg", "sac", "td3"],
    "graphs": [f"gctd3 {graph}" for graph in ("tree", "authors", "complete", "edgeless", "random", "mlp")],
    "history": [f"gctd3 history={frames}" for frames in (1, 3, 5, 8)],
}


SEEDS = (0, 1)  # two of the five seeds: composing takes long


@functools.cache
def params(experiment):
    """Return the parameters of a ready sweep, as a command line would give them."""
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        whole = compose("config", [f"experiment={experiment}"], return_hydra_config=True)
        return dict(whole.hydra.sweeper.params)


@functools.cache
def jobs(experiment):
    """Return command line and configuration of each run of a ready sweep, for some of its seeds."""
    over = {key: str(value).split(",") for key, value in params(experiment).items() if key != "seed"}
    found = []
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        for chosen in product(*over.values()):
            overrides = [f"experiment={experiment}", *(f"{k}={v}" for k, v in zip(over, chosen, strict=True))]
            config = compose("config", overrides)
            # A seed is but a value, which others refer to; to compose takes long.
            found += [([*overrides, f"seed={seed}"], OmegaConf.merge(config, {"seed": seed})) for seed in SEEDS]
    return found


@parametrize(3, "experiment", READY)
def test_ready_sweeps_are_fair(experiment):
    found = [build(config) for _, config in jobs(experiment)]
    assert len(found) == len(SEEDS) * READY[experiment] and params(experiment)["seed"] == "range(5)"
    # Equal frames, equal updates, and nothing ends them early.
    assert (
        len(
            {
                (s.total_frames, s.rollout_steps, s.gradient_steps, s.env.num_envs, s.exploration.learning_starts)
                for s in found
            }
        )
        == 1
    )
    assert all(s.stop_when.evaluations is None and s.total_episodes is None for s in found)


@parametrize(3, "experiment", READY)
def test_a_report_tells_the_runs_of_a_ready_sweep_apart(experiment, tmp_path):
    for number, (overrides, config) in enumerate(jobs(experiment)):
        save_config(tmp_path / str(number), config, overrides)
    groups = groups_of(find_runs(tmp_path))
    assert list(groups) == NAMES[experiment]
    assert all([run.seed for run in runs] == list(SEEDS) for runs in groups.values())


@pytest.mark.nightly
def test_the_mlp_among_the_graphs_has_as_many_parameters():
    sizes = {}
    for overrides, config in jobs("graphs"):
        settings = build(config)
        actor_and_critics = settings.algo.build(settings.setup().architecture()).optimizers.values()
        counts = [sum(p.numel() for group in o.param_groups for p in group["params"]) for o in actor_and_critics]
        sizes[overrides[1]] = counts
    mlp, tree = sizes["experiment/graphs=mlp"], sizes["experiment/graphs=tree"]
    assert len(tree) == 2 and mlp == pytest.approx(tree, rel=0.01) and mlp != tree
    assert all(counts == tree for name, counts in sizes.items() if name != "experiment/graphs=mlp")


@pytest.mark.nightly
def test_every_seed_draws_its_own_random_graph():
    seeds = {config.seed: config.robot.graph_seed for overrides, config in jobs("graphs")}
    assert seeds == {seed: seed for seed in SEEDS}


# Side by side.


@pytest.mark.parametrize(
    "n_jobs, at_once, each", [(1, 1, 12), (3, 3, 4), (5, 5, 2), (-1, 12, 1), (-2, 11, 1), (20, 20, 1)]
)
def test_cores_are_divided(monkeypatch, n_jobs, at_once, each):
    monkeypatch.setattr(sweep, "cores", lambda: 12)
    launcher = OmegaConf.create({"n_jobs": n_jobs})
    assert sweep.runs_at_once(launcher) == at_once
    monkeypatch.setattr(sweep.HydraConfig, "get", lambda: SimpleNamespace(launcher=launcher))
    config = OmegaConf.create({"threads": None, "env": {"threads": None}})
    sweep.share_cores(config)
    assert config == {"threads": each, "env": {"threads": each}}
    given = OmegaConf.create({"threads": 7, "env": {"num_envs": 2}})
    sweep.share_cores(given)
    assert given == {"threads": 7, "env": {"num_envs": 2}}


def test_a_launcher_that_knows_nothing_of_jobs_has_one():
    assert sweep.runs_at_once(OmegaConf.create({"_target_": "basic"})) == 1


def arguments(directory, *overrides, **changed):
    settings = [f"{key}={value}" for key, value in {**TINY, **changed}.items()]
    return ["-m", *settings, "seed=0,1", f"hydra.sweep.dir={directory}", "hydra.sweep.subdir=seed${seed}", *overrides]


def beside(directory, *overrides, **changed):
    """Start a sweep with two runs at once, in a process group of its own, as a terminal does."""
    more = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2", *overrides]
    module = [sys.executable, "-m", "gctd3.train", *arguments(directory, *more, **changed)]
    return subprocess.Popen(module, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


@pytest.mark.nightly
def test_ctrl_c_reaches_runs_side_by_side_and_the_sweep_goes_on_later(tmp_path):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    long = {"total_frames": 2000, "evaluation.every": 400, "checkpoint_every": 1000}
    directory = tmp_path / "sweep"
    running = beside(directory, **long)
    wait_for(lambda: len(list(directory.glob("seed?/checkpoints/best-*"))) == 2, seconds=600)
    os.killpg(running.pid, signal.SIGINT)
    out, error = running.communicate(timeout=300)
    assert running.returncode == 130, out + error
    assert "Traceback" not in out + error and out.count("stopped. ") == 2
    assert f"Continue it with the same command and hydra.sweep.dir={directory}" in out
    stopped = {seed: rows(directory / f"seed{seed}") for seed in (0, 1)}
    assert all(int(found[-1]["frames"]) < 2000 for found in stopped.values())
    # With hours between checkpoints, only a run that was let finish its step can have one.
    assert len(list(directory.glob("seed?/checkpoints/step-*"))) == 2 and not (directory / ".stop").exists()

    running = beside(directory, **long)
    out, error = running.communicate(timeout=300)
    assert running.returncode == 0, out + error
    assert out.count("done. Best evaluation") == 2
    for seed in (0, 1):
        run = directory / f"seed{seed}"
        assert rows(run)[: len(stopped[seed])] == stopped[seed] and int(rows(run)[-1]["frames"]) == 2000
        assert "Run directory" in (run / "log.txt").read_text(encoding="utf-8")
        config = OmegaConf.load(run / ".hydra" / "config.yaml")
        assert config.threads == 1
    whole = train(tmp_path / "whole", "seed=1", *(f"{k}={v}" for k, v in long.items()), without=list(long))
    assert_same_run(whole, directory / "seed1")

    # With any launcher, nothing is left to do.
    before = {file: file.read_bytes() for file in directory.glob("seed?/progress.csv")}
    assert command("train", *arguments(directory, **long)) == 0
    assert {file: file.read_bytes() for file in directory.glob("seed?/progress.csv")} == before


def test_a_missing_plugin_is_named():
    missing = MissingConfigException("", missing_cfg_file="hydra/launcher/joblib", options=["basic"])
    said = explain(missing, "config")
    assert "'hydra/launcher/joblib'" in said and "pip install 'gctd3[sweep]'" in said and "basic" in said


# Crashes.


class Crashing(Recorded):
    """Fail at the second update for seed 0."""

    def _evaluate(self):
        if self.settings.seed == 0 and self.counters.frames > 100:
            raise NumericalError("the loss is nan")
        return super()._evaluate()


def test_a_crashed_run_is_named_and_the_others_go_on(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert command("train", *arguments(tmp_path / "sweep"), trainer=Crashing) == 2
    out, error = capsys.readouterr()
    # Hydra tells no callback of the end of a sweep in which a run failed.
    assert out.count(f"Continue it with the same command and hydra.sweep.dir={tmp_path / 'sweep'}\n") == 1
    assert f"error: {tmp_path / 'sweep' / 'seed0'}: After " in error and "the loss is nan" in error
    assert "the other runs went on" in error and "Traceback" not in error
    assert int(rows(tmp_path / "sweep" / "seed1")[-1]["frames"]) == 240
    for seed in (0, 1):
        assert command("evaluate", f"run={tmp_path / 'sweep' / f'seed{seed}'}", "episodes=1", "threads=1") == 0
    said = "\n".join(verdict(groups_of(find_runs(tmp_path / "sweep"))))
    assert "gctd3, seed 0 (seed0) crashed: After " in said and "the loss is nan" in said
    assert "its best policy until then counts" in said and "seed 1 (" not in said


@pytest.mark.parametrize("best", [None, {"return_mean": math.nan}, {"return_mean": -math.inf}])
def test_a_search_gets_a_finite_result_of_every_run(best):
    assert math.isfinite(session.value(best)) and session.value(best) < -1e6
    assert session.value({"return_mean": -12.5}) == -12.5


def test_a_sweep_that_came_to_its_end_says_nothing_more(tmp_path, capsys):
    begun = sweep.StopTogether()
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").touch()
    config = OmegaConf.create({"hydra": {"sweep": {"dir": str(tmp_path)}, "launcher": {"n_jobs": 2}}})
    before = signal.getsignal(signal.SIGTERM)
    begun.on_multirun_start(config)
    assert signal.getsignal(signal.SIGTERM) != before
    sweep.end(None)
    assert signal.getsignal(signal.SIGTERM) == before and capsys.readouterr().out == ""
    # Stopped by a signal, whatever its runs raised then.
    for error in (None, SystemExit(2), RuntimeError()):
        begun = sweep.StopTogether()
        begun.on_multirun_start(config)
        os.kill(os.getpid(), signal.SIGTERM)
        assert (tmp_path / sweep.STOP).exists()
        with pytest.raises(SystemExit) as end:
            sweep.end(error)
        assert end.value.code == 128 + signal.SIGTERM and not (tmp_path / sweep.STOP).exists()
        assert "Continue it with the same command and hydra.sweep.dir=" in capsys.readouterr().out
    # What is no sweep, or has not begun, has nothing to continue.
    sweep.end(SystemExit(2))
    (tmp_path / ".hydra" / "config.yaml").unlink()
    sweep.StopTogether().on_multirun_start(config)
    sweep.end(SystemExit(2))
    assert capsys.readouterr().out == ""


def test_a_run_that_was_stopped_is_named(finished, tmp_path):
    run = finished.copy("gctd3", tmp_path / "a")
    assert find_runs(run)[0].trouble is None
    OmegaConf.save(
        {**OmegaConf.load(run / ".hydra" / "config.yaml"), "total_frames": 2400}, run / ".hydra" / "config.yaml"
    )
    assert find_runs(run)[0].trouble == "stopped at 240 of 2,400 frames"
    (run / "progress.csv").unlink()
    assert find_runs(run)[0].trouble == "stopped before its first evaluation"


@pytest.mark.nightly
def test_a_run_that_reached_what_it_was_to_show_is_at_its_end(tmp_path):
    shown = ["stop_when.evaluations=1", "stop_when.at_least={success_rate: 0.0}", "stop_when.at_most={}"]
    run = train(tmp_path / "a", "stop_when=never", *(f"+{item}" if "at_" in item else item for item in shown))
    assert int(rows(run)[-1]["frames"]) < 240
    assert find_runs(run)[0].trouble is None


@pytest.mark.nightly
def test_a_sweeper_gets_the_return_of_the_best_policy(tmp_path, monkeypatch):
    got = []

    from gctd3.training import session as module

    actual = module.train
    monkeypatch.setattr(module, "train", lambda config: got.append(actual(config)) or got[-1])
    run = train(tmp_path / "a", "stop_when=never")
    assert got == [pytest.approx(max(float(row["return_mean"]) for row in rows(run)))]


# Killed processes. Those of joblib wait for the processes of the runs.

LONG = {"total_frames": 1200, "evaluation.every": 400, "checkpoint_every": 400}


def holders(sweep):
    """Return for every run that is being trained its process and joblib's that waits for it."""
    found = {}
    for directory in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            open_files = {os.readlink(file) for file in (directory / "fd").iterdir()}
            parent = int((directory / "stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[1])
            for run in sweep.iterdir():
                if str(run / "log.txt") in open_files:
                    found[run.name] = int(directory.name), parent
    return found


@pytest.mark.nightly
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize("victim", ["run", "worker"])
def test_a_killed_process_of_a_sweep_is_named_and_the_others_go_on(tmp_path, victim):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    sweep = tmp_path / "sweep"
    running = beside(sweep, "seed=0,1,2", **LONG)
    wait_for(lambda: len(holders(sweep)) == 2 and list(sweep.glob("seed0/checkpoints/best-*")), seconds=600)
    process, worker = holders(sweep)["seed0"]
    os.kill(process if victim == "run" else worker, signal.SIGKILL)
    out, error = running.communicate(timeout=600)
    assert running.returncode == 2, out + error
    assert "Traceback" not in out + error
    named = [line for line in error.splitlines() if "killed" in line]
    assert named and all(str(sweep / "seed0") in line for line in named), error
    assert f"Continue it with the same command and hydra.sweep.dir={sweep}" in out
    for seed in (1, 2):
        assert int(rows(sweep / f"seed{seed}")[-1]["frames"]) == LONG["total_frames"]
    assert int(rows(sweep / "seed0")[-1]["frames"]) < LONG["total_frames"]
    # The same command ends it, as if nothing had happened.
    again = beside(sweep, "seed=0,1,2", **LONG)
    out, error = again.communicate(timeout=600)
    assert again.returncode == 0, out + error
    assert "Continue it" not in out
    whole = train(tmp_path / "whole", "seed=0", *(f"{k}={v}" for k, v in LONG.items()), without=list(LONG))
    assert_same_run(whole, sweep / "seed0")
