"""Progress of long work: a bar with the time left on a terminal; elsewhere a line per minute, or nothing.

All of it goes to stderr, so that results are the same bytes whatever is shown. The command line uses `telling` to
choose the output where there is no terminal. Library calls show bars on a terminal, and nothing elsewhere.
"""

import sys
import time
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from enum import Enum
from threading import Event, Thread
from typing import Any

TICK_S = 0.25
"""Interval between two drawings of a bar [s]."""
DELAY_S = 1.0
"""Work that ends sooner shows no bar [s]."""
LINE_S = 60.0
"""Interval between two lines [s]."""
_FORM = "{desc} {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
_FORM_OF_UNITS = "{desc} {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} {unit} {elapsed}{postfix}"
_FORM_WITHOUT_END = "{desc} {n_fmt} {unit} {elapsed}"


class Verbosity(Enum):
    """What progress shows."""

    BARS = "bars on a terminal"
    LINES = "bars on a terminal, a line a minute elsewhere"
    NOTHING = "nothing"


_verbosity: ContextVar[Verbosity] = ContextVar("verbosity", default=Verbosity.BARS)


@contextmanager
def verbosity(what: Verbosity) -> Iterator[None]:
    """Set what progress shows within the block."""
    before = _verbosity.set(what)
    try:
        yield
    finally:
        _verbosity.reset(before)


class Progress:
    """Progress of one piece of work, between entering and leaving a ``with`` block.

    Nested pieces of work add a bar below on a terminal, and nothing elsewhere.

    Parameters
    ----------
    total
        Total amount of work, in any unit; None if unknown.
    what
        Name of the work, or of its first step.
    unit
        Unit of `total`, to be shown; none if its numbers mean nothing to a user.
    """

    def __init__(self, total: float | int | None, what: str, unit: str = "") -> None:
        self.total, self.what, self.unit = total, what, unit
        self._marks_s, self._marks, self._begin_s = [0.0], [0.0], 0.0
        self._is_over, self._inner, self._teller = Event(), ExitStack(), None

    def __enter__(self) -> "Progress":
        self._begin_s, shown = time.monotonic(), _verbosity.get()
        self._inner.enter_context(verbosity(Verbosity.BARS if shown is Verbosity.LINES else shown))
        is_drawn = shown is not Verbosity.NOTHING and sys.stderr.isatty()
        if is_drawn or shown is Verbosity.LINES:
            self._teller = Thread(target=self._draw if is_drawn else self._write, args=(sys.stderr,), daemon=True)
            self._teller.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._inner.close()
        self._is_over.set()
        if self._teller is not None:
            self._teller.join()

    @property
    def done(self) -> float:
        """Amount of work done."""
        return self._marks[-1]

    def update(self, by: float | int = 1) -> None:
        """Add to the amount done."""
        self.reach(self.done + by)

    def reach(self, done: float | int) -> None:
        """Set the amount done."""
        if done > self.done:
            self._marks_s.append(self._elapsed_s())
            self._marks.append(float(done))

    def begin(self, what: str, by: float | int = 1) -> None:
        """End a step, which was `by` of the total, and begin the step of this name."""
        self.update(by)
        self.what = what

    def left_s(self) -> float | None:
        """Time left [s], by the speed over the latter half of the time so far; None if that cannot be estimated."""
        return None if self.total is None else time_left_s(self.total, self._marks_s, self._marks, self._elapsed_s())

    def _elapsed_s(self) -> float:
        return time.monotonic() - self._begin_s

    def _draw(self, terminal: Any) -> None:
        """Keep a bar up to date, so that it moves during a long step."""
        if self._is_over.wait(DELAY_S):
            return
        from tqdm import tqdm

        form = _FORM_WITHOUT_END if self.total is None else _FORM_OF_UNITS if self.unit else _FORM
        with tqdm(desc=self.what, total=self.total, unit=self.unit, bar_format=form, file=terminal, leave=False) as bar:
            bar.start_t = time.time() - self._elapsed_s()
            while not self._is_over.is_set():
                left_s, done = self.left_s(), min(self.done, self.total or self.done)
                bar.n = int(done) if self.unit else done
                bar.set_description_str(self.what, refresh=False)
                bar.set_postfix_str(f"{'?' if left_s is None else bar.format_interval(left_s)} left", refresh=False)
                bar.refresh()
                self._is_over.wait(TICK_S)

    def _write(self, file: Any) -> None:
        while not self._is_over.wait(LINE_S):
            print(self.line(), file=file, flush=True)

    def line(self) -> str:
        """The progress in words."""
        left_s, so_far = self.left_s(), f"{in_words(self._elapsed_s())} so far"
        count = f"{self.done:g}" if self.total is None else f"{self.done:g} of {self.total:g}"
        share = "" if not self.total else f", {min(self.done / self.total, 1.0):.0%}"
        left = [] if left_s is None else [f"about {in_words(left_s)} left"]
        done = f", {count} {self.unit}" if self.unit else share
        return f"halfseen: {self.what}{done}, " + ", ".join([so_far, *left])


def time_left_s(total: float | int, marks_s: list[float], marks: list[float], now_s: float) -> float | None:
    """Time left [s], by the speed over the latter half of the time up to the last mark.

    Results kept from an earlier run are read back at once, and so say nothing about the rest. If a step takes longer
    than that, half of the remaining work is assumed done.

    Parameters
    ----------
    total
        Total amount of work.
    marks_s, marks
        Times [s] and the amounts done at them, from (0, 0) on.
    now_s
        Time since the beginning [s].

    Returns
    -------
    float or None
        None before the first mark.
    """
    if len(marks) < 2 or marks_s[-1] <= 0.0:
        return None
    begin = min(bisect_right(marks_s, marks_s[-1] / 2) - 1, len(marks) - 2)
    pace_s = (marks_s[-1] - marks_s[begin]) / (marks[-1] - marks[begin])
    left = max(total - marks[-1], 0.0)
    return max(left * pace_s - (now_s - marks_s[-1]), now_s * left / (total + marks[-1]))


def in_words(time_s: float) -> str:
    """Write a time [s] to the precision that is useful to someone waiting."""
    if time_s < 60:
        return f"{time_s:.0f} s"
    minutes = round(time_s / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
