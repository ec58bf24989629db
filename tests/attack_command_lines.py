"""Answer one command line, and check what came of one that was accepted."""

import os
import re
import shutil
from pathlib import Path

from fuzzing import Idle, tree
from omegaconf import OmegaConf
from running import command

PLAIN = re.compile(r"([a-z_.]+)=(-?\d{1,9}|true|false|null|-?\d{1,6}\.\d{1,6})")
VALUES = {"true": True, "false": False, "null": None}


def check(name, arguments, output):
    """Run a command.

    Args:
        name: Name of the command.
        arguments: Its arguments.
        output: Directory that it may write to, besides the one that its own arguments name.
    """
    import contextlib
    import io

    from gctd3.training.saved_configuration import CONFIG, load_config, load_settings

    shutil.rmtree(output, ignore_errors=True)
    before = tree(os.getcwd())
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        code = command(name, *arguments, trainer=Idle)
    said = error.getvalue()
    named = [word.partition("=")[2] for word in arguments if word.lstrip("+").startswith("out=")]
    # Without a name a graph is drawn to this file.
    places = tuple(map(os.path.abspath, [output, *named[-1:], *(["graph.svg"] if name == "graph" else [])]))
    elsewhere = [path for path in tree(os.getcwd()) - before if not path.startswith(places)]
    if elsewhere:
        return f"defect: written elsewhere: {elsewhere[:3]}"
    if "Traceback" in said or code not in (0, 2):
        return f"defect: exit code {code}: {said[-500:]}"
    if code == 2:
        # An option of the shell's kind, "--nonsense", is answered by Python's parser of options.
        lines = [line for line in said.splitlines() if ": error: " in f": {line}"]
        if len(lines) != 1 or len(lines[0]) < 12:
            return f"defect: not one message: {said[-500:]}"
        return "refused"
    run = Path(output)
    if name != "train" or not (run / CONFIG).is_file():  # --cfg, --info and the like train nothing
        return "ok"
    load_settings(run)
    saved, places = load_config(run), [argument.lstrip("+~").partition("=")[0] for argument in arguments]
    for number, argument in enumerate(arguments):
        match = PLAIN.fullmatch(argument)
        later = [place for place in places[number + 1 :] if f"{place}.".startswith(places[number] + ".")]
        above = [place for place in places[number + 1 :] if places[number].startswith(f"{place}.")]
        if match is None or later or above or "." not in match[1]:
            continue
        wanted = VALUES.get(match[2], float(match[2]) if match[2] not in VALUES else None)
        found = OmegaConf.select(saved, match[1])
        if found != wanted:
            return f"defect: {argument} is {found!r} in the run"
    return "ok"
