"""Runs of a clock of messages: a simulation's clock falls back when it is reset, and what follows is of another run.

Messages of several topics come a little out of order, so that a small fall is none. Nor is one of some seconds where
the clock goes on as before: that message was late. Just after a reset some messages may still be of the run before.
When each was recorded tells all these apart.
"""

from bisect import bisect_right
from collections.abc import Sequence

JITTER_NS = 10**9
"""How far stamps fall at most without a reset, and how long after one messages of the run before still come [ns]."""
MOST_LATE_NS = 5 * 10**9
"""How late a message may be of which the clock goes on as before [ns]."""


def runs_of(stamps_ns: Sequence[int], recorded_ns: Sequence[int]) -> list[int]:
    """Number the run, from 0, of each of N messages.

    Parameters
    ----------
    stamps_ns
        Clock of each message [ns].
    recorded_ns
        When it was recorded [ns]; never falls.
    """
    # Of Python's own: a broken stamp may have any number of digits.
    ahead_ns = [stamp_ns - at_ns for stamp_ns, at_ns in zip(stamps_ns, recorded_ns, strict=True)]
    runs: list[int] = []
    run = reset_ns = highest_ns = 0
    now = before = 0  # how far ahead of the recorder's the clock is, in this run and in the one before
    for k, (stamp_ns, offset) in enumerate(zip(stamps_ns, ahead_ns, strict=True)):
        if run and recorded_ns[k] - reset_ns <= JITTER_NS and abs(offset - before) < abs(offset - now):
            runs.append(run - 1)
            continue
        is_fall = bool(runs) and stamp_ns < highest_ns - JITTER_NS
        if is_fall and not (now - offset <= MOST_LATE_NS and _goes_on(k, now, ahead_ns, recorded_ns)):
            run, reset_ns, before = run + 1, recorded_ns[k], now
            highest_ns, now = stamp_ns, offset
        elif not runs or stamp_ns > highest_ns:
            highest_ns, now = stamp_ns, offset
        runs.append(run)
    return runs


def _goes_on(k: int, now: int, ahead_ns: Sequence[int], recorded_ns: Sequence[int]) -> bool:
    """Whether the clock goes on after message k as if that had not come, rather than from there."""
    begin = bisect_right(recorded_ns, recorded_ns[k] + JITTER_NS)
    end = bisect_right(recorded_ns, recorded_ns[k] + 2 * JITTER_NS)
    return any(abs(each - now) < abs(each - ahead_ns[k]) for each in ahead_ns[begin : max(end, begin + 1)])
