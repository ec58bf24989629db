"""Files of a run are data: no code in any of them is executed."""

import contextlib
import os
import pickle
import re
import shutil
import subprocess
import sys
from itertools import cycle, product
from pathlib import Path

import pytest
import torch
from fuzzing import answered, time_limit
from omegaconf import OmegaConf
from running import command, tiny, train

import gctd3
from gctd3 import files
from gctd3.comparison.runs import find_runs
from gctd3.config.build import again, packages
from gctd3.errors import RunError
from gctd3.files import (
    checksum,
    load_tree,
    new_directory,
    new_file,
    read_manifest,
    remove_leftovers,
    write_manifest,
    write_text,
)
from gctd3.runs.load import load_policy
from gctd3.training.checkpoint import Checkpoints
from gctd3.training.saved_configuration import command_line, load_settings


class Evil:
    """Create a file when unpickled."""

    def __init__(self, marker):
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


@pytest.fixture(scope="module")
def run(finished):
    return finished["gctd3"]


def evil_files(folder, marker):
    """Make a plain pickle and torch's zip of one."""
    plain, zipped = folder / "plain", folder / "zipped"
    plain.write_bytes(pickle.dumps(Evil(marker)))
    torch.save(Evil(marker), zipped)
    return plain, zipped


def test_the_evil_files_are_evil(tmp_path):
    marker = tmp_path / "marker"
    plain, zipped = evil_files(tmp_path, marker)
    pickle.loads(plain.read_bytes())
    assert marker.exists()
    marker.unlink()
    torch.load(zipped, weights_only=False)
    assert marker.exists()


@pytest.mark.nightly
@pytest.mark.parametrize("every", [False, True], ids=["by turns", "every one"])
def test_nothing_of_a_run_is_executed(tmp_path, capsys, run, every):
    """Code in a run's files is not executed, even with valid checksums; each file is replaced by evil ones."""
    marker = tmp_path / "marker"
    files = sorted(path.relative_to(run) for path in run.rglob("*") if path.is_file() and path.name != ".lock")
    assert {"config.yaml", "manifest.json", "policy.safetensors", "state.safetensors"} <= {path.name for path in files}
    kinds = evil_files(tmp_path, marker)
    for evil, file in product(kinds, files) if every else zip(cycle(kinds), files, strict=False):
        broken = Path(shutil.copytree(run, tmp_path / "broken"))
        shutil.copy(evil, broken / file)
        if file.suffix == ".safetensors":
            seal(broken)
            with pytest.raises(RunError, match=re.escape(str(broken / file))):
                load_tree(broken / file)
        capsys.readouterr()
        evaluated = "best-" in str(file) or file.name == "config.yaml"
        code = command("evaluate", f"run={broken}", "episodes=1") if evaluated else command("train", f"resume={broken}")
        assert code == 2
        assert "Traceback" not in capsys.readouterr().err
        if file.name in ("policy.safetensors", "config.yaml"):
            with pytest.raises(RunError, match=re.escape(str(broken))):
                load_policy(broken)
        assert not marker.exists(), file
        shutil.rmtree(broken)


STRANGER = """
import dataclasses, pathlib
pathlib.Path({marker!r}).touch()
from gctd3.algorithms.settings import TD3Settings

@dataclasses.dataclass(frozen=True)
class Settings(TD3Settings):
    pass
"""


def test_no_stranger_is_imported_unless_it_is_allowed(tmp_path, monkeypatch, capsys, run):
    """A module named in somebody else's run is not imported unless it is allowed, even if it is installed."""
    marker, broken = tmp_path / "marker", Path(shutil.copytree(run, tmp_path / "run"))
    (tmp_path / "stranger.py").write_text(STRANGER.format(marker=str(marker)))
    monkeypatch.syspath_prepend(str(tmp_path))
    config = broken / ".hydra" / "config.yaml"
    own = "gctd3.TD3Settings"
    assert own in config.read_text()
    config.write_text(config.read_text().replace(own, "stranger.Settings"))
    said = "algo: _target_ 'stranger.Settings' is not gctd3's.* GCTD3_MODULES=stranger"
    for name, arguments in (("evaluate", [f"run={broken}", "episodes=1"]), ("train", [f"resume={broken}"])):
        capsys.readouterr()
        assert command(name, *arguments) == 2
        assert re.search(said, capsys.readouterr().err)
    with pytest.raises(RunError, match=said):
        load_policy(broken)
    assert not marker.exists() and "stranger" not in sys.modules

    for typo in ("strange", "stranger.Settings"):
        monkeypatch.setenv("GCTD3_MODULES", f"json,{typo}")
        with pytest.raises(RunError, match=rf"GCTD3_MODULES must name packages, by commas; '{typo}' is not found\."):
            load_policy(broken)
    assert not marker.exists()
    monkeypatch.setenv("GCTD3_MODULES", "json, stranger")
    assert load_policy(broken) is not None and marker.exists()
    # A module that the caller has imported is allowed.
    monkeypatch.delenv("GCTD3_MODULES")
    assert load_policy(broken) is not None
    del sys.modules["stranger"]


@pytest.mark.nightly
def test_a_command_line_may_name_modules_of_ones_own(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(STRANGER.format(marker=str(tmp_path / "marker")))
    monkeypatch.syspath_prepend(str(tmp_path))
    trained = train(tmp_path / "run", "recipe=none", "algo._target_=mine.Settings")
    assert load_settings(trained).algo == sys.modules.pop("mine").Settings(privileged_critic=True)


MINE = "from own_terms import Rising\n\n\nclass Mine(Rising):\n    pass\n"


@pytest.mark.nightly
def test_a_sweep_with_terms_of_ones_own_goes_on(tmp_path, monkeypatch, capsys):
    """As in a process of its own, which has imported nothing yet."""
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.syspath_prepend(str(tmp_path))
    folder = [f"hydra.sweep.dir={tmp_path / 'sweep'}", "hydra.sweep.subdir=one", "seed=0", "-m"]
    words = [*tiny(tmp_path / "unused", "+reward.terms.mine._target_=mine.Mine"), *folder]
    assert command("train", *words) == 0
    del sys.modules["mine"]
    capsys.readouterr()
    assert command("train", *words) == 0
    assert "It is finished already." in capsys.readouterr().out
    del sys.modules["mine"]


@pytest.mark.nightly
def test_what_a_training_prints_can_be_pasted(tmp_path, monkeypatch, capsys):
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.syspath_prepend(str(tmp_path))
    there = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", there)
    train(tmp_path / "a run", "+reward.terms.mine._target_=mine.Mine")
    said = capsys.readouterr().out
    line = next(line for line in said.splitlines() if line.startswith("Evaluate it over 50 episodes:"))
    monkeypatch.delenv("PYTHONPATH")
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    done = subprocess.run(line.partition(":  ")[2], shell=True, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a run" / "evaluation.json").is_file()
    assert f"GCTD3_MODULES=mine python -m gctd3.view 'run={tmp_path / 'a run'}'" in said
    del sys.modules["mine"]


@pytest.mark.parametrize(
    "config, needed",
    [
        ({"_target_": "gctd3.Reward", "terms": {"a": {"_target_": "one.two.A"}, "b": None}}, ["one"]),
        ({"reward.terms.a._target_": "one.A", "task._target_": "two.B", "algo._target_": "gctd3.X"}, ["one", "two"]),
        ({"list": [{"_target_": "one.A"}, {"_target_": "one.B"}, 3]}, ["one"]),
        ({"_target_": "gctd3.Reward"}, []),
    ],
)
def test_packages_that_a_configuration_names(config, needed, monkeypatch):
    assert packages(config) == packages(OmegaConf.create(config)) == needed
    monkeypatch.delenv("PYTHONPATH", raising=False)
    said = f"GCTD3_MODULES={','.join(needed)} " if needed else ""
    assert again(config, "train", "resume=a") == f"{said}python -m gctd3.train resume=a"


def seal(run):
    """Write the files' checksums into every manifest."""
    for manifest in run.glob("checkpoints/*/manifest.json"):
        content = read_manifest(manifest.parent)
        content["files"] = {name: checksum(manifest.parent / name) for name in content["files"]}
        for part in content.get("replay", []):
            part["sha256"] = checksum(run / "checkpoints" / "replay" / part["file"])
        write_manifest(manifest.parent, content)


def test_nothing_in_the_library_could():
    """The library uses no function that can execute the content of a file."""
    forbidden = r"\b(pickle|cPickle|dill|joblib|marshal|shelve|torch\.load|torch\.jit\.load|unsafe_load|full_load)\b"
    yaml_load = r"\byaml\.(load|load_all|unsafe\w*)\b(?!.*SafeLoader)|(?<!\.)\b(eval|exec)\("
    sources = [*Path(gctd3.__file__).parent.rglob("*.py")]
    assert len(sources) > 30
    for source in sources:
        code = [line.split("#")[0] for line in source.read_text(encoding="utf-8").splitlines()]
        for number, line in enumerate(code, 1):
            if re.search(forbidden, line) and re.match(r"\s*(from|import)\b|.*\w\(", line):
                pytest.fail(f"{source}:{number}: {line}")
            assert not re.search(yaml_load, line), f"{source}:{number}: {line}"


def test_a_directory_that_a_killed_process_left_is_not_used_and_can_be_removed(tmp_path):
    """The half-written directory of a write that was killed is neither in the way nor in the result."""
    with contextlib.suppress(KeyboardInterrupt), new_directory(tmp_path / "step-1") as torn:
        (torn / "torn").write_text("half")
        shutil.copytree(torn, tmp_path / "copy")
        raise KeyboardInterrupt
    left = (tmp_path / "copy").rename(torn)
    with new_directory(tmp_path / "step-1") as aside:
        assert aside != left
        (aside / "whole").write_text("all")
    assert [path.name for path in (tmp_path / "step-1").iterdir()] == ["whole"]
    remove_leftovers(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["step-1"]


def parts(change):
    def damage(content):
        content["replay"] = change(content["replay"])

    return damage


MALFORMED = {
    "no replay": lambda content: content.pop("replay"),
    "replay of another kind": parts(lambda rows: {"0": rows}),
    "part of another kind": parts(lambda rows: [*rows, "rows"]),
    "part without its file": parts(lambda rows: [{k: v for k, v in row.items() if k != "file"} for row in rows]),
    "part elsewhere": parts(lambda rows: [{**row, "file": f"../{row['file']}"} for row in rows]),
    "rows of another kind": parts(lambda rows: [{**row, "start": "0"} for row in rows]),
    "no files": lambda content: content.pop("files"),
    "files of another kind": lambda content: content.update(files=["state.safetensors"]),
    "other files": lambda content: content.update(files={}),
    "a file elsewhere": lambda content: content["files"].update({"../../../etc/passwd": "0"}),
    "frames of another kind": lambda content: content.update(frames="many"),
    "no versions": lambda content: content.update(versions=None),
    "another format, no versions": lambda content: content.update(versions=None, format=3),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_a_manifest_whose_checksum_fits_is_still_not_trusted(run, tmp_path, capsys, case):
    """Whoever changes a manifest can compute its checksum."""
    copied = shutil.copytree(run, tmp_path / "run")
    newest = max((copied / "checkpoints").glob("step-*"))
    for old in set((copied / "checkpoints").glob("step-*")) - {newest}:
        shutil.rmtree(old)
    content = read_manifest(newest)
    MALFORMED[case](content)
    write_manifest(newest, content)
    with pytest.raises(RunError, match="All 1 checkpoints"):
        Checkpoints(copied).newest()
    assert f"Passed over a checkpoint: {newest}" in capsys.readouterr().err


@pytest.mark.parametrize("content", [[], "x", None, 3])
def test_a_manifest_that_holds_no_mapping(tmp_path, content):
    write_manifest(tmp_path, content)
    with pytest.raises(RunError, match="no mapping"):
        read_manifest(tmp_path)


def names_of_writes(monkeypatch):
    """Note the name beside a file under which its content is written."""
    seen, token = [], files.secrets.token_hex

    def noting(count):
        seen.append(token(count))
        return seen[-1]

    monkeypatch.setattr(files.secrets, "token_hex", noting)
    return seen


def test_a_name_for_writing_cannot_be_known_before(tmp_path, monkeypatch):
    seen = names_of_writes(monkeypatch)
    for _ in range(3):
        write_text(tmp_path / "evaluation.json", "{}")
        with new_directory(tmp_path / "new"):
            pass
        (tmp_path / "new").rmdir()
    assert len(set(seen)) == len(seen) == 6
    assert all(len(bytes.fromhex(token)) >= 8 for token in seen)


@pytest.mark.parametrize("kind", ["file", "directory"])
@pytest.mark.parametrize("write", ["text", "directory"])
def test_a_link_under_the_name_for_writing_is_not_followed(tmp_path, monkeypatch, kind, write):
    """Even if somebody guessed the name, what the link points to stays as it was."""
    victim = tmp_path / "victim"
    if kind == "file":
        victim.write_text("precious")
    else:
        victim.mkdir()
        (victim / "precious").write_text("precious")
    monkeypatch.setattr(files.secrets, "token_hex", lambda count: "guessed")
    (tmp_path / f".out.guessed{files.ASIDE}").symlink_to(victim)
    with pytest.raises(FileExistsError):
        if write == "text":
            write_text(tmp_path / "out", "new")
        else:
            with new_directory(tmp_path / "out") as aside:
                (aside / "new").write_text("new")
    kept = victim if kind == "file" else victim / "precious"
    assert kept.read_text() == "precious"
    assert not (tmp_path / "out").exists() and (kind == "file" or len(list(victim.iterdir())) == 1)


def test_a_file_that_is_a_link_is_replaced_and_its_target_stays(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "evaluation.json").symlink_to(tmp_path / "precious")
    write_text(tmp_path / "evaluation.json", "{}")
    assert (tmp_path / "precious").read_text() == "precious"
    assert (tmp_path / "evaluation.json").read_text() == "{}" and not (tmp_path / "evaluation.json").is_symlink()


def test_removing_a_link_leaves_what_it_points_to(tmp_path):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "file").touch()
    (tmp_path / f".link{files.ASIDE}").symlink_to(tmp_path / "kept")
    remove_leftovers(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["kept"] and (tmp_path / "kept" / "file").exists()


def test_files_are_written_in_one_place_only():
    """Every other way to open a file for writing would follow a link that somebody else has put there."""
    writing = r"\.write_(text|bytes)\(|\bopen\([^)]*[\"'][wax]b?\+?[\"']|O_WRONLY|\bmkstemp\b"
    allowed = {
        # Directories and files that new_directory or new_file has just made.
        ("files.py", 'path.write_text(json.dumps(whole, sort_keys=True, indent=1), encoding="utf-8")'),
        ("files.py", "aside.write_bytes(content)"),
        ("files.py", "os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))"),
        ("viz/film.py", "aside.write_bytes(gif(frames, fps))"),
        ("runs/draw.py", 'with new_file(out) as aside, aside.open("wb") as file:'),
        ("robots/keep.py", '(folder / OWN_MJCF).write_text(portable.mjcf, encoding="utf-8")'),
        ("robots/keep.py", 'with (folder / NUMBERS).open("wb") as opened:'),
        # A sweep's own list of runs whose processes were killed.
        ("training/own_process.py", 'with lost.open("a", encoding="utf-8") as file:'),
        # A run's own log, after refuse_links.
        ("training/session.py", '(run / LOG).open("a", encoding="utf-8", buffering=1) as log,'),
    }
    package = Path(gctd3.__file__).parent
    found = set()
    for source in package.rglob("*.py"):
        for line in source.read_text(encoding="utf-8").splitlines():
            if re.search(writing, line) and "os.devnull" not in line:
                found.add((source.relative_to(package).as_posix(), line.strip()))
    assert found == allowed


@pytest.mark.parametrize("begun", [True, False])
def test_a_file_whose_writing_fails_leaves_nothing_and_says_why(tmp_path, begun):
    with pytest.raises(OSError, match="full"), new_file(tmp_path / "policy") as aside:
        if begun:
            aside.write_text("half")
        raise OSError("full")
    assert not list(tmp_path.iterdir())


def test_a_directory_whose_writing_fails_leaves_nothing(tmp_path):
    with pytest.raises(OSError, match="full"), new_directory(tmp_path / "step-1") as aside:
        (aside / "torn").write_text("half")
        raise OSError("full")
    assert not list(tmp_path.iterdir())


def use(way, run):
    """Use a run in one way; return the refusal, or what is false if there is none."""
    try:
        return way(run)
    except RunError as error:
        return str(error)


WAYS = [
    lambda run: load_policy(run) and None,
    lambda run: load_settings(run) and None,
    lambda run: Checkpoints(run).newest() and None,
    lambda run: find_runs(run) and None,
    lambda run: answered("train", f"resume={run}", "total_frames=400"),
]


def put_pipe(run, name):
    (run / name).unlink()
    os.mkfifo(run / name)


def test_a_pipe_is_not_waited_for(tmp_path, finished):
    run = finished.copy("gctd3", tmp_path / "run")
    put_pipe(run, ".hydra/overrides.yaml")
    with time_limit(), pytest.raises(RunError, match="it is not a regular file"):
        command_line(run)
    with time_limit(), pytest.raises(OSError, match="it is not a regular file"):
        checksum(run / ".hydra/overrides.yaml")


@pytest.mark.nightly
def test_a_pipe_in_the_place_of_any_file_of_a_run_is_not_waited_for(tmp_path, finished):
    whole, refused = finished["gctd3"], set()
    for name in [path.relative_to(whole) for path in whole.rglob("*") if path.is_file() and path.name != ".lock"]:
        run = finished.copy("gctd3", tmp_path / "run")
        put_pipe(run, name)
        with time_limit():
            if any([use(way, run) for way in WAYS]):
                refused.add(name.name)
        shutil.rmtree(run)
    assert {"config.yaml", "overrides.yaml", "policy.safetensors", "state.safetensors", "manifest.json"} <= refused
