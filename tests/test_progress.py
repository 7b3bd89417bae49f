import io
import re
import sys
import time
from functools import partial

import pytest

from halfseen import progress
from halfseen.progress import Progress, Verbosity, in_words, time_left_s, verbosity


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def fast(monkeypatch):
    """Bars and lines that do not wait for a minute."""
    monkeypatch.setattr(progress, "DELAY_S", 0.01)
    monkeypatch.setattr(progress, "TICK_S", 0.01)
    monkeypatch.setattr(progress, "LINE_S", 0.05)


def shown(monkeypatch, file, what, work):
    monkeypatch.setattr("sys.stderr", file)
    with verbosity(what):
        work()
    return file.getvalue()


def linger(shows=None):
    """Stay until something is shown, however long that takes; or for a while, if nothing is to be."""
    end_s = time.monotonic() + 60.0
    if shows is None:
        time.sleep(0.15)
    while shows is not None and not re.search(shows, sys.stderr.getvalue()):
        assert time.monotonic() < end_s, sys.stderr.getvalue()
        time.sleep(0.01)


def two_steps(shows=None):
    with Progress(4, "read") as bar:
        bar.begin("learn")
        linger(shows)


def nested(shows):
    with Progress(2, "outside"), Progress(2, "inside", "draws") as bar:
        bar.update()
        linger(shows)


def test_a_terminal_sees_a_bar_with_the_time_left_that_goes_when_it_is_over(fast, monkeypatch):
    bar = r"learn +25%\|.*\| \d\d:\d\d, (\?|\d\d:\d\d) left"
    output = shown(monkeypatch, Terminal(), Verbosity.BARS, partial(two_steps, bar))
    assert output.split("\r")[-1].strip() == ""


def test_a_part_has_its_bar_below_on_a_terminal(fast, monkeypatch):
    below = r"(?s)outside   0%.*inside +50%\|[^|]*\| 1/2 draws \d\d:\d\d|inside +50%\|[^|]*\| 1/2 draws.*outside   0%"
    shown(monkeypatch, Terminal(), Verbosity.LINES, partial(nested, below))


def test_elsewhere_lines_are_for_the_command_line_alone(fast, monkeypatch):
    assert shown(monkeypatch, io.StringIO(), Verbosity.BARS, two_steps) == ""
    output = shown(monkeypatch, io.StringIO(), Verbosity.LINES, partial(two_steps, "learn.*\n"))
    assert re.fullmatch(r"(halfseen: learn, 25%, \d+ s so far(, about \d+ s left)?\n)+", output)


def test_lines_are_of_the_work_and_not_of_its_parts(fast, monkeypatch):
    assert "inside" not in shown(monkeypatch, io.StringIO(), Verbosity.LINES, partial(nested, "outside"))


@pytest.mark.parametrize("file", [io.StringIO, Terminal])
def test_quiet_is_quiet(fast, monkeypatch, file):
    assert shown(monkeypatch, file(), Verbosity.NOTHING, partial(nested, None)) == ""


@pytest.mark.parametrize("file", [io.StringIO, Terminal])
def test_what_is_over_at_once_shows_nothing(monkeypatch, file):
    def work():
        with Progress(3, "short") as bar:
            bar.update(3)

    assert shown(monkeypatch, file(), Verbosity.LINES, work) == ""


def test_an_error_leaves_no_bar_and_the_same_telling(fast, monkeypatch):
    def stop():
        with Progress(None, "convert", "clouds"):
            linger("convert 0 clouds")
            raise KeyError

    def fails():
        with pytest.raises(KeyError):
            stop()

    output = shown(monkeypatch, Terminal(), Verbosity.BARS, fails)
    assert output.split("\r")[-1].strip() == ""
    assert shown(monkeypatch, io.StringIO(), Verbosity.BARS, two_steps) == ""


def test_a_line_says_how_far_it_is():
    bar = Progress(200, "run", "tables")
    bar._begin_s = time.monotonic() - 120.0
    bar.update(50)
    assert bar.line() == "halfseen: run, 50 of 200 tables, 2 min so far, about 6 min left"


@pytest.mark.parametrize(
    ("marks_s", "marks", "now_s", "left_s"),
    [
        ([0.0], [0.0], 5.0, None),  # nothing is done yet
        ([0.0, 10.0], [0.0, 1.0], 10.0, 30.0),
        ([0.0, 10.0], [0.0, 1.0], 16.0, 24.0),  # it runs on between two marks
        ([0.0, 10.0], [0.0, 1.0], 40.0, 24.0),  # and beyond what was expected: 2.5 of 4 in 40 s
        ([0.0, 10.0, 12.0, 14.0], [0.0, 1.0, 2.0, 3.0], 14.0, 14.0 / 3.0),  # the first step is in the latter half
        ([0.0, 0.1, 20.1], [0.0, 2.0, 3.0], 20.1, 20.0),  # two were kept of an earlier run
        ([0.0, 10.0], [0.0, 4.0], 10.0, 0.0),
    ],
)
def test_the_time_left_of_four_steps(marks_s, marks, now_s, left_s):
    assert time_left_s(4.0, marks_s, marks, now_s) == (left_s if left_s is None else pytest.approx(left_s))


@pytest.mark.parametrize(
    ("time_s", "words"), [(0.4, "0 s"), (59.0, "59 s"), (90.0, "2 min"), (3540.0, "59 min"), (7300.0, "2 h 2 min")]
)
def test_times_in_words(time_s, words):
    assert in_words(time_s) == words
