"""Load, evaluate and continue a damaged run; what works must be what it was, and nothing outside it may change."""

import contextlib
import hashlib
import io
import os
from pathlib import Path

import torch
from fuzzing import Idle
from running import command

from gctd3.errors import GCTD3Error
from gctd3.runs.load import load_policy
from gctd3.training.checkpoint import Checkpoints
from gctd3.training.saved_configuration import load_settings


def contents(folder):
    """Return a hash of every file below a folder."""
    found = {}
    for here, _, names in os.walk(folder):
        for name in names:
            path = Path(here, name)
            if path.is_file() and not path.is_symlink():
                found[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def check(run, victim, whole, action):
    """Use a run in one way.

    Args:
        run: The damaged run.
        victim: Directory that its links point to.
        whole: The undamaged run.
        action: ``policy``, ``newest``, ``settings``, ``evaluate`` or ``resume``.
    """
    before, place = contents(victim), Path(run)
    try:
        answer = ACTIONS[action](place, whole)
    except GCTD3Error as error:
        answer = "refused" if str(error).strip() else "defect: a refusal without a word"
    return answer if contents(victim) == before else "defect: a file outside the run was changed"


def _policy(run, whole):
    same = load_policy(run).state_dict(), load_policy(whole).state_dict()
    equal = same[0].keys() == same[1].keys() and all(torch.equal(same[0][key], same[1][key]) for key in same[0])
    return "ok" if equal else "defect: it loads another policy"


def _newest(run, whole):
    newest = Checkpoints(run).newest()
    if newest is None:
        return "ok"
    rows = sum(len(next(iter(part.values()))) for _, part in newest[1])
    frames = int(newest[0]["counters"]["frames"])
    return "ok" if frames in (80, 160, 240) and rows > 0 else f"defect: {frames} frames, {rows} rows"


def _settings(run, whole):
    load_settings(run)
    return "ok"


def _answered(name, *arguments):
    error = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(error):
        code = command(name, *arguments, trainer=Idle)
    said = error.getvalue()
    if "Traceback" in said or code not in (0, 2):
        return f"defect: exit code {code}: {said[-500:]}"
    lines = [line for line in said.splitlines() if ": error: " in f": {line}"]
    if code == 2:
        return "refused" if len(lines) == 1 and len(lines[0]) > 12 else f"defect: not one message: {said[-500:]}"
    return "ok"


def _evaluate(run, whole):
    return _answered("evaluate", f"run={run}", "episodes=1", "threads=1")


def _resume(run, whole):
    return _answered("train", f"resume={run}", "total_frames=400")


ACTIONS = {"policy": _policy, "newest": _newest, "settings": _settings, "evaluate": _evaluate, "resume": _resume}
