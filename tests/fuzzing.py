"""Fuzz: damage a copy of anything, and run a command that has to answer."""

import contextlib
import io
import os
import shutil
import signal

from hypothesis import strategies as st
from running import Recorded, command

from gctd3.errors import GCTD3Error

SECONDS = 60  # after which a command counts as hanging


class Hang(BaseException):
    """Report that a command took too long; no handler of the library may catch it."""


@contextlib.contextmanager
def time_limit(seconds=SECONDS):
    def late(number, frame):
        raise Hang(f"no answer in {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


class Idle(Recorded):
    """Build and restore a trainer, without training."""

    def run(self, stop=None):
        return None


def answered(name, *arguments):
    """Run a command; return 0 after success, 2 after one clean message, and fail on anything else."""
    out, error = io.StringIO(), io.StringIO()
    with time_limit(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        code = command(name, *arguments, trainer=Idle)
    said = error.getvalue()
    assert code in (0, 2), f"exit code {code}: {said}"
    assert "Traceback" not in said
    if code == 2:
        lines = [line for line in said.splitlines() if line.startswith("error: ")]
        assert len(lines) == 1 and len(lines[0]) > len("error: "), said
        print(lines[0])
    return code


def clean(call):
    """Call the library and return whether it succeeded; only its own errors are allowed."""
    with time_limit(), contextlib.redirect_stderr(io.StringIO()):
        try:
            call()
        except GCTD3Error as error:
            assert str(error)
            return False
    return True


@st.composite
def damages(draw):
    """Return a function from bytes to damaged bytes."""
    kind = draw(st.sampled_from(["flip", "cut", "drop", "insert", "zero"]))
    where, what = draw(st.floats(0, 1, exclude_max=True)), draw(st.integers(1, 255))
    count = draw(st.integers(1, 40))

    def damage(content):
        data = bytearray(content)
        if not data:
            return bytes(data)
        at = int(where * len(data))
        if kind == "flip":
            for i in range(count):
                data[(at + 97 * i) % len(data)] ^= what
        elif kind == "cut":
            del data[at:]
        elif kind == "drop":
            del data[at : at + count]
        elif kind == "insert":
            data[at:at] = bytes([what]) * count
        else:
            data[at : at + count] = bytes(len(data[at : at + count]))
        return bytes(data)

    return damage


def tree(folder):
    """Return every path below a folder."""
    return {os.path.join(here, name) for here, folders, files in os.walk(folder) for name in (*folders, *files)}


def fresh(source, target):
    """Make a new copy of a directory."""
    shutil.rmtree(target, ignore_errors=True)
    return type(target)(shutil.copytree(source, target))
