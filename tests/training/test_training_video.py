"""``train video=true`` films every evaluated policy, and does not change the training."""

import io

import pytest
from PIL import Image
from running import command, rows, tiny, train

from gctd3.files import read_manifest
from gctd3.training.checkpoint import Checkpoints
from gctd3.viz import film

ffmpeg = pytest.importorskip("imageio_ffmpeg")


@pytest.fixture(scope="module")
def runs(finished, tmp_path_factory):
    """Train a run with films, and one without."""
    there = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(film, "CLIP", 0.4)
        filmed = train(there / "filmed", "video=true", "logger=tensorboard", without=("logger",))
    return filmed, finished["gctd3"]


@pytest.mark.nightly
def test_every_evaluated_policy_is_filmed(runs):
    videos = sorted((runs[0] / "videos").iterdir())
    assert [file.name for file in videos] == [f"{int(row['frames']):012d}.mp4" for row in rows(runs[0])]
    for file in videos:
        frames, seconds = ffmpeg.count_frames_and_secs(str(file))
        # 0.4 s at 25 frames a second, or less if the robot fell.
        assert 2 <= frames <= 10 and seconds == pytest.approx(frames / film.FPS, abs=0.02)
    assert not (runs[1] / "videos").exists()


@pytest.mark.nightly
def test_tensorboard_shows_them(runs):
    module = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    accumulator = module.EventAccumulator(str(runs[0] / "tensorboard"))
    accumulator.Reload()
    shown = accumulator.Images("evaluation/walk")
    assert [image.step for image in shown] == [int(row["frames"]) for row in rows(runs[0])]
    with Image.open(io.BytesIO(shown[0].encoded_image_string)) as image:
        assert image.format == "GIF" and image.n_frames > 1 and image.size == film.CLIP_SIZE


@pytest.mark.nightly
def test_the_training_is_the_same(runs):
    filmed, plain = runs
    assert rows(filmed, drop=("wall_s",)) == rows(plain, drop=("wall_s",))
    seals = [read_manifest(Checkpoints(run).best())["files"] for run in runs]
    assert seals[0] == seals[1]


def test_what_cannot_be_filmed_is_answered_before_anything_is_written(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command("train", *tiny(tmp_path / "run", "video=true", "task=walker2d", without=("env.threads",))) == 2
    assert "video must be false for Walker2d-v5, got true: film is for simulated tasks." in capsys.readouterr().err
    find = film.importlib.util.find_spec
    monkeypatch.setattr(film.importlib.util, "find_spec", lambda name: None if name == "imageio_ffmpeg" else find(name))
    assert command("train", *tiny(tmp_path / "run", "video=true")) == 2
    assert capsys.readouterr().err == "error: Videos need imageio-ffmpeg: pip install 'gctd3[video]'.\n"
    assert list(tmp_path.iterdir()) == []
