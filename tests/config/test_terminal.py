"""Results survive the terminal: one that shows ASCII only, one that is gone, signals close to one another."""

import errno
import io
import itertools
import os
import signal
import subprocess
import sys
import textwrap

import pytest

from gctd3.config.terminal import PLAIN, Enduring, enduring_output, prepare_output
from gctd3.signals import SIGNALS


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "utf-8"])
def test_every_text_can_be_shown(monkeypatch, encoding):
    content = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(content, encoding=encoding))
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(io.BytesIO(), encoding=encoding))
    prepare_output()
    print("return 1 ± 2, ≥ 3, läuft, \udcff", flush=True)
    shown = content.getvalue().decode(encoding)
    expected = {
        "ascii": r"return 1 +- 2, >= 3, l\xe4uft, \udcff",
        "latin-1": r"return 1 ± 2, >= 3, läuft, \udcff",
        "cp1252": r"return 1 ± 2, >= 3, läuft, \udcff",
        "utf-8": r"return 1 ± 2, ≥ 3, läuft, \udcff",
    }
    assert shown == expected[encoding] + "\n"


def test_replacements_are_themselves_plain():
    assert all(plain.isascii() and not special.isascii() for special, plain in PLAIN.items())


@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_a_stream_that_the_shell_closed(monkeypatch, name):
    monkeypatch.setattr(sys, name, None)
    prepare_output()
    print("nobody reads this", file=getattr(sys, name), flush=True)
    getattr(sys, name).close()


class Gone(io.StringIO):
    """Fail as the system does when a pipe or a terminal is gone."""

    def __init__(self, number, late):
        super().__init__()
        self.number, self.late = number, late

    def write(self, text):
        if not self.late:
            raise OSError(self.number, os.strerror(self.number))
        return super().write(text)

    def flush(self):
        raise OSError(self.number, os.strerror(self.number))


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("number", [errno.EPIPE, errno.EIO, errno.ENOSPC])
def test_what_cannot_be_shown_ends_nothing(monkeypatch, number, late):
    monkeypatch.setattr(sys, "stdout", Gone(number, late))
    with enduring_output():
        print("a line", flush=True)
        done = True
    assert done
    with pytest.raises(OSError):
        print("after it as before", flush=True)


def test_what_a_closed_stream_still_holds_back_is_not_reported():
    """Python flushes at its end: the pipe is closed, and so exit code and standard error would tell of it."""
    script = """
        import sys
        from gctd3.config.terminal import enduring_output
        sys.stdin.readline()  # the reader has closed by now
        with enduring_output():
            for _ in range(3):
                print("x" * 100_000, flush=True)
        print("y" * 100)
        print("result", file=sys.stderr)
    """
    call = [sys.executable, "-c", textwrap.dedent(script)]
    with subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        process.stdin.write(b"\n")
        process.stdin.close()
        assert process.stderr.read() == b"result\n"
    assert process.returncode == 0


def test_a_stream_keeps_its_other_members():
    stream = io.StringIO()
    assert Enduring(stream).getvalue == stream.getvalue


@pytest.mark.parametrize("kind", ["StopRequest", "Interruption"])
@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(SIGNALS, 2)))
def test_two_signals_at_once_leave_without_a_traceback(kind, first, second):
    """Python calls both handlers, one right after the other, with nothing in between."""
    script = f"""
        import os, signal, sys
        from gctd3.signals import {kind}
        heard = {kind}()
        both = {{{int(first)}, {int(second)}}}
        try:
            with heard.listening():
                signal.pthread_sigmask(signal.SIG_BLOCK, both)
                for number in both:
                    os.kill(os.getpid(), number)
                signal.pthread_sigmask(signal.SIG_UNBLOCK, both)
                for _ in range(100_000):
                    pass
        except KeyboardInterrupt:
            pass
        print("still there")
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True)
    assert -done.returncode in (first, second)
    assert done.stderr == "" and "still there" not in done.stdout


def test_a_hang_up_that_is_ignored_stays_ignored():
    """``nohup`` sets it so; what it starts goes on when the terminal closes."""
    script = """
        import os, signal
        from gctd3.signals import StopRequest
        stop = StopRequest()
        with stop.listening():
            os.kill(os.getpid(), signal.SIGHUP)
            for _ in range(1000):
                pass
        print(bool(stop))
    """
    for ignored, stopped in ((True, "False"), (False, "True")):
        prefix = "import signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n" if ignored else ""
        done = subprocess.run([sys.executable, "-c", prefix + textwrap.dedent(script)], capture_output=True, text=True)
        assert done.stdout.split()[-1] == stopped and done.returncode == 0


@pytest.mark.parametrize("failure", [OSError(errno.EIO, "gone"), RuntimeError("reentrant call")])
def test_a_signal_is_remembered_though_it_cannot_be_announced(monkeypatch, failure):
    from gctd3.signals import StopRequest

    class Broken(io.StringIO):
        def write(self, text):
            raise failure

    monkeypatch.setattr(sys, "stdout", Broken())
    stop = StopRequest()
    with stop.listening():
        signal.raise_signal(signal.SIGTERM)
    assert stop and stop.exit_code == 143
