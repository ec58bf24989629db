"""Generated command lines end in one clean message, or in a run that holds what they say."""

import random
from collections import Counter

import pytest
from attacking import Attacker, defects
from configs import composed, items
from running import tiny

pytestmark = pytest.mark.nightly

GROUPS = ("algo", "robot", "network", "replay", "reward", "task", "exploration", "stop_when", "collector", "experiment")
NUMBERS = ("0", "1", "2", "3", "7", "-1", "0.5", "-0.0", "1.5", "1e-3", "1_000", "0x10", "1e999", "nan", "inf", "-inf")
HUGE = (str(2**31), str(2**32), str(2**63), str(2**64), str(10**30), "1" * 400)
SHAPES = (
    "[]",
    "{}",
    "[1,2]",
    "[[1]]",
    "{a:1}",
    "{a:{b:[1]}}",
    "[null]",
    "{_target_:gctd3.Fall}",
    "{_target_:os.system}",
)
TEXTS = ("null", "true", "false", "''", "???", "ü", "机器人", "a b", "'a b'", '"q"', "\\", "a,b", "1,2", "range(3)")
BROKEN = (
    "${seed}",
    "${nowhere}",
    "${oc.env:HOME}",
    "${",
    "}{",
    "[",
    "(",
    "{" * 50,
    "=",
    "a=b",
    "~",
    "@",
    "$(id)",
    "`id`",
)
OPTIONS = (
    "biped",
    "hexapod",
    "td3",
    "sac",
    "mlp",
    "gcn",
    "paper",
    "walk",
    "never",
    "plain",
    "process",
    "nobody",
    "./x.xml",
)
FLAGS = ("--cfg=job", "--resolve", "--info", "--nonsense", "-x", "--", "-c", "--package=x", "--config-name=evaluate")
WORDS = ("", "=", "x", "algo", "=3", "+", "~", "++a=1", "+a.b=1", "a.b.c=1", "seed", "seed==1", "seed:1", "@x=1", "\t")
# Of them nothing is asked here: a service that is not there, or another test's subject.
LEFT_OUT = ("logger", "collector.address", "resume", "init", "video")
CASES, CHUNK = 320, 40


def value(rng):
    pool = rng.choices((NUMBERS, HUGE, SHAPES, TEXTS, BROKEN, OPTIONS), (6, 2, 2, 3, 2, 2))[0]
    return rng.choice(pool)


def argument(rng, keys):
    kind = rng.choices(("key", "add", "drop", "group", "misspelt", "word", "flag"), (10, 2, 2, 4, 2, 2, 1))[0]
    key = rng.choice(keys)
    if kind == "key":
        return f"{key}={value(rng)}"
    if kind == "add":
        return f"{rng.choice(('+', '++'))}{key}{rng.choice(('', '.x'))}={value(rng)}"
    if kind == "drop":
        return f"~{key}"
    if kind == "group":
        return f"{rng.choice(GROUPS)}={rng.choice((*OPTIONS, value(rng)))}"
    if kind == "misspelt":
        place = rng.randrange(len(key))
        return f"{key[:place]}{rng.choice('xq_.')}{key[place + 1 :]}={value(rng)}"
    return rng.choice(WORDS if kind == "word" else FLAGS)


def lines(count, run, out):
    """Return command lines, the same ones every time."""
    rng = random.Random(20)
    keys = sorted(key for key, _ in items(composed()) if not key.startswith(LEFT_OUT))
    others = {
        "evaluate": ["run", "episodes", "seed", "threads", "reward", "out", "robustness"],
        "graph": ["robot", "robot.name", "feet", "size", "out", "robot.graph", "robot.feet"],
        "report": ["runs", "out", "episodes", "seed", "keep_runs"],
        "export": ["run", "out", "seed", "max_rate", "episodes"],
    }
    made = []
    for _ in range(count):
        name = rng.choices(("train", *others), (16, 2, 3, 2, 1))[0]
        chosen = [argument(rng, keys if name == "train" else others[name]) for _ in range(rng.randint(1, 3))]
        if name == "train":
            chosen = [*tiny(out), *chosen]
        elif name == "evaluate":
            chosen = [f"run={run}", f"out={out}", "episodes=1", "threads=1", *chosen]
        elif name == "report":
            chosen = [f"runs={run.parent / 'none'}", f"out={out}", *chosen]
        elif name == "export":
            chosen = [f"run={run}", f"out={out}/x.nothing", *chosen]
        made.append((name, chosen))
    return made


@pytest.mark.parametrize("chunk", range(CASES // CHUNK))
def test_command_lines(finished, tmp_path, chunk):
    here = tmp_path / "here"
    here.mkdir()
    attacker = Attacker("attack_command_lines", here)
    # An evaluation that names no directory writes to its run.
    run = finished.copy("gctd3", tmp_path / "run")
    chosen = lines(CASES, run, "out")[chunk * CHUNK : (chunk + 1) * CHUNK]
    answers = {str(line): attacker.ask(name=line[0], arguments=line[1], output="out") for line in chosen}
    attacker.close()
    assert not defects(answers)
    # Both ends are met, or the cases would show little.
    assert set(Counter(answers.values())) == {"ok", "refused"}


def test_lines_are_the_same_every_time(finished):
    run = finished["gctd3"]
    assert (
        lines(50, run, "out") == lines(50, run, "out") and len({str(line) for line in lines(CASES, run, "out")}) > 300
    )
