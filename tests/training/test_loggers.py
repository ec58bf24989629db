"""``logger=wandb`` and ``logger=mlflow`` make a run for each training, with its numbers and its films."""

import shutil
from pathlib import Path

import pytest
from running import rows, train

from gctd3.viz import film

pytest.importorskip("imageio_ffmpeg")
# Neither logger is in the environment of the quick tests.
pytestmark = pytest.mark.nightly


@pytest.fixture(autouse=True)
def _short(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(film, "CLIP", 0.1)
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)


def trainings(root, kind):
    """Train twice in one process, as in a sweep."""
    return [train(root / name, f"logger={kind}", "video=true", without=("logger",)) for name in ("first", "second")]


def films(run):
    return [file.read_bytes() for file in sorted((run / "videos").iterdir())]


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_wandb_has_a_run_of_each(tmp_path):
    pytest.importorskip("wandb")
    for run in trainings(tmp_path, "wandb"):
        (kept,) = (run / "wandb").glob("offline-run-*")
        # File names are numbered by the entries logged before.
        names = sorted(kept.rglob("walk_*.mp4"), key=lambda file: int(file.name.split("_")[1]))
        assert [file.read_bytes() for file in names] == films(run) and len(names) == len(rows(run))


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_mlflow_has_a_run_of_each(tmp_path):
    mlflow = pytest.importorskip("mlflow")
    runs = trainings(tmp_path, "mlflow")
    client = mlflow.MlflowClient()
    found = client.search_runs([client.get_experiment_by_name("gctd3").experiment_id], order_by=["start_time"])
    assert [(run.info.run_name, run.info.status) for run in found] == [("first", "FINISHED"), ("second", "FINISHED")]
    for run, there in zip(found, runs, strict=True):
        returns = client.get_metric_history(run.info.run_id, "evaluation/return_mean")
        expected = [(int(row["frames"]), float(row["return_mean"])) for row in rows(there)]
        assert [(metric.step, metric.value) for metric in returns] == expected
        assert films(Path(client.download_artifacts(run.info.run_id, "videos", str(tmp_path))).parent) == films(there)
        shutil.rmtree(tmp_path / "videos")
