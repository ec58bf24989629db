"""Progress: drawn over on a terminal, in plain lines elsewhere, and silent about what is done at once."""

import io
import os

import pytest

from gctd3 import progress
from gctd3.progress import tracked
from gctd3.training.progress import ProgressLine


class Clock:
    """Stand in for ``time``: each look at it takes ``step`` seconds."""

    def __init__(self, step):
        self.now, self.step = 0.0, step

    def monotonic(self):
        self.now += self.step
        return self.now


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def screen(monkeypatch):
    def make(kind, step, columns=80):
        clock, stream = Clock(step), kind()
        monkeypatch.setattr("sys.stderr", stream)
        monkeypatch.setattr(progress, "time", clock)
        monkeypatch.setattr("gctd3.training.progress.time", clock)
        monkeypatch.setattr("shutil.get_terminal_size", lambda *_, **__: os.terminal_size((columns, 24)))
        return stream

    return make


def test_plain_lines_are_far_apart(screen):
    # The clock is at 1 s when the line begins: after a second there is one, and then one each half minute.
    stream = screen(io.StringIO, 1.0)
    assert list(tracked(iter("x" * 70), "drawing pictures", 70)) == ["x"] * 70
    lines = stream.getvalue().splitlines()
    assert lines == [f"drawing pictures: {done} of 70" for done in (0, 30, 60)]


@pytest.mark.parametrize("kind", [io.StringIO, Terminal])
def test_what_is_done_at_once_shows_nothing(screen, kind):
    stream = screen(kind, 0.001)
    assert list(tracked([1, 2], "drawing", 2)) == [1, 2] and stream.getvalue() == ""


def test_a_terminals_line_is_drawn_over_cut_and_wiped_out(screen):
    stream = screen(Terminal, 1.0, columns=20)
    list(tracked(range(5), "evaluating runs", 5))
    *shown, last = stream.getvalue().split("\r\033[K")[1:]
    assert shown == [f"evaluating runs: {done} " for done in range(5)] and last == ""
    assert "\n" not in stream.getvalue()


def test_a_training_without_a_terminal_prints_a_line_for_each_evaluation(screen):
    stream = screen(io.StringIO, 1.0)
    with ProgressLine(1000, 0) as line:
        line.advance(100)
        line.evaluated({"return": "481", "success": "100%", "best": "488"})
    (said,) = stream.getvalue().splitlines()
    # The clock has been looked at when the line began, at the advance, and now.
    assert said == "100 of 1,000 frames, 50/s, return 481 success 100% best 488"


def test_a_training_says_all_its_numbers_on_80_columns(screen, monkeypatch):
    stream = screen(Terminal, 0.0)
    monkeypatch.setenv("COLUMNS", "80")
    with ProgressLine(1_000_000, 0) as line:
        line.advance(512_000)
        line.evaluated({"return": "481", "success": "100%", "best": "488"})
    drawn = [text for text in stream.getvalue().split("\r") if "return" in text]
    # The bar takes what is left, and what does not fit is cut off at the right.
    numbers = drawn[-1].partition("best 488")
    assert numbers[1] and len(numbers[0] + numbers[1]) < 80
    assert "512k/1.00M frames" in numbers[0] and "return 481 success 100%" in numbers[0]
