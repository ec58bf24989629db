"""Damaged run directories are refused by a message, or work as the run that they were."""

import json
import os
import random
import shutil
from collections import Counter

import pytest
import yaml
from attacking import Attacker, defects

from gctd3.files import MANIFEST, seal

pytestmark = pytest.mark.nightly

CASES, CHUNK = 240, 40
# Most of the cases are about what takes little time.
ACTIONS = ("policy", "policy", "newest", "settings", "evaluate", "resume", "resume")
STRANGE = (None, -1, 0, 1.5, 10**30, float("nan"), "", "x", "../../victim", "/etc/passwd", [], {}, [[]], {"a": 1}, True)


def every(content, path=()):
    """Yield the path of each value of nested mappings and lists."""
    pairs = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in pairs:
        yield (*path, key)
        yield from every(value, (*path, key))


def change(content, rng):
    """Change, drop or add one value of nested mappings and lists."""
    *above, last = rng.choice(list(every(content)))
    node = content
    for key in above:
        node = node[key]
    kind = rng.choice(("set", "set", "drop", "add"))
    if kind == "set":
        node[last] = rng.choice(STRANGE)
    elif kind == "drop":
        del node[last]
    elif isinstance(node, dict):
        node[rng.choice(("new", "_target_", "ü", "seed"))] = rng.choice(STRANGE)
    else:
        node.append(rng.choice(STRANGE))


def damage_bytes(path, rng):
    data = bytearray(path.read_bytes())
    at, count = rng.randrange(len(data) + 1), rng.choice((1, 8, 300))
    kind = rng.choice(("flip", "cut", "drop", "insert", "zero", "empty", "double"))
    if kind == "flip":
        for i in range(at, min(at + count, len(data))):
            data[i] ^= rng.randint(1, 255)
    elif kind == "cut":
        del data[at:]
    elif kind == "drop":
        del data[at : at + count]
    elif kind == "insert":
        data[at:at] = rng.randbytes(count)
    elif kind == "zero":
        data[at : at + count] = bytes(len(data[at : at + count]))
    elif kind == "empty":
        data.clear()
    else:
        data = data + data
    path.write_bytes(data)


def put(path, rng, victim):
    """Put something else in the place of a file or directory."""
    kind = rng.choice(("nothing", "directory", "file", "link", "dangling", "loop", "pipe", "link to a directory"))
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    if kind == "directory":
        path.mkdir()
    elif kind == "file":
        path.write_text("x")
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind != "nothing":
        target = {"link": victim / "file", "dangling": victim / "none", "loop": path, "link to a directory": victim}[
            kind
        ]
        path.symlink_to(target)


def damage(run, victim, rng):
    """Damage a run in one way, or in a few."""
    for _ in range(rng.choice((1, 1, 2))):
        files = sorted(
            path for path in run.rglob("*") if path.is_file() and not path.is_symlink() and path.name != ".lock"
        )
        folders = sorted(path for path in run.rglob("*") if path.is_dir() and not path.is_symlink())
        kind = rng.choice(
            ("bytes", "bytes", "put", "put", "swap", "manifest", "manifest", "yaml", "yaml", "rename", "extra")
        )
        if kind == "bytes":
            damage_bytes(rng.choice(files), rng)
        elif kind == "put":
            put(rng.choice((*files, *folders)), rng, victim)
        elif kind == "swap":
            one, other = rng.sample(files, 2)
            first, second = one.read_bytes(), other.read_bytes()
            one.write_bytes(second)
            other.write_bytes(first)
        elif kind == "manifest" and (manifests := [file for file in files if file.name == MANIFEST]):
            # With a checksum that fits: whoever changes a manifest can compute it.
            file = rng.choice(manifests)
            try:
                content = json.loads(file.read_text())["content"]
                change(content, rng)
            except (ValueError, KeyError, TypeError, IndexError):
                continue  # it is damaged already
            file.write_text(json.dumps({"sha256": seal(content), "content": content}))
        elif kind == "yaml" and (texts := [file for file in files if file.suffix == ".yaml"]):
            file = rng.choice(texts)
            try:
                content = yaml.safe_load(file.read_text())
                change(content, rng)
            except (ValueError, yaml.YAMLError, TypeError, IndexError):
                continue
            file.write_text(yaml.safe_dump(content))
        elif kind == "rename":
            path = rng.choice((*files, *folders))
            new = rng.choice(
                ("step-", "step-abc", "best-999999999999", "best-x", "step-000000000500", "ü", "checkpoint-1")
            )
            if not (path.parent / new).exists():
                path.rename(path.parent / new)
        else:
            folder = rng.choice((run, *folders))
            name = rng.choice(
                ("best-000000000500", "step-000000000500", ".x.tmp", "checkpoint-3", "post_mortem", "a\nb")
            )
            if not (folder / name).exists():
                rng.choice(
                    (lambda path: path.mkdir(), lambda path: path.touch(), lambda path: path.symlink_to(victim))
                )(folder / name)


def make(whole, folder, number):
    """Return a damaged copy of a run and what its links point to, the same ones every time."""
    rng = random.Random(f"run {number}")
    run, victim = folder / "run", folder / "victim"
    shutil.rmtree(folder, ignore_errors=True)
    victim.mkdir(parents=True)
    (victim / "file").write_text("precious")
    shutil.copytree(whole, run)
    damage(run, victim, rng)
    return run, victim, rng.choice(ACTIONS)


@pytest.mark.parametrize("chunk", range(CASES // CHUNK))
def test_run_directories(finished, tmp_path, chunk):
    whole, answers = finished["gctd3"], {}
    attacker = Attacker("attack_run_directories", tmp_path)
    for number in range(chunk * CHUNK, (chunk + 1) * CHUNK):
        run, victim, action = make(whole, tmp_path / "case", number)
        answers[number, action] = attacker.ask(run=str(run), victim=str(victim), whole=str(whole), action=action)
    attacker.close()
    assert not defects(answers)
    assert set(Counter(answers.values())) == {"ok", "refused"}
