"""What a source's clock counts from: seconds since an episode began, and the runs of a simulation that is reset.

The times of T + 1 observations say when an episode began. The times at which its T steps ended do not: such a clock
begins at 0 in each episode, or it runs on over episodes, and each begins when the one before ended.

A simulation's clock falls back when it is reset, and what follows is of another run. Messages of several topics come a
little out of order, so that a small fall is none. Nor is one of some seconds where the clock goes on as before: that
message was late. Just after a reset some messages may still be of the run before. When each was recorded tells all
these apart.
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from halfseen.errors import LogError, warn
from halfseen.logs.columns import shown
from halfseen.shapes import Bool, Float

MOST_FIRST = 3.0
"""How many times as long as the longest other step a first one may be, where it is not sure when it began."""


def even_ends(num_steps: int, step_s: float) -> Float[np.ndarray, " T"]:
    """Ends of steps that last the same time each."""
    return step_s * np.arange(1.0, num_steps + 1)


def ends_by_observations(times_s: Float[np.ndarray, " T1"]) -> Float[np.ndarray, " T"]:
    """Ends of steps since their episode began [s], by the times of the T + 1 observations."""
    return times_s[1:] - times_s[0]


def ends_by_steps(
    place: str, clock: str, names: Sequence[int | str], times_s: Sequence[Float[np.ndarray, " _"]]
) -> list[Float[np.ndarray, " _"]]:
    """Ends of steps since their episode began [s], by the clock at the ends of the steps of each episode, in order.

    Parameters
    ----------
    place, clock, names
        The dataset, the clock and each episode, for messages.
    times_s
        Clock at the end of each step, by episode [s]; each has a step.

    Raises
    ------
    LogError
        An episode begins at a time that nobody can tell.
    """
    runs_on = np.array([one[-1] < other[0] for one, other in pairwise(times_s)], dtype=bool)
    if not runs_on.any():
        return list(times_s)
    is_on = bool(runs_on.all())
    begins_s = [0.0, *(float(one[-1]) if is_on else 0.0 for one in times_s[:-1])]
    first_s = np.array([float(one[0]) - begin_s for one, begin_s in zip(times_s, begins_s, strict=True)])
    _refuse_unlikely(place, clock, names, times_s, np.where(np.append(is_on, runs_on), first_s, 0.0))
    count = f"{int(runs_on.sum())} of {len(runs_on)}"
    how = (
        "begins when the one before ended, and the first at 0"
        if is_on
        else "counts from its own beginning, as others do"
    )
    warn(
        place,
        f"{clock} is later in the first step of an episode than at the end of the one before, {count} times: "
        f"each {how}; the first steps last up to {first_s.max():g} s",
    )
    return [one - begin_s for one, begin_s in zip(times_s, begins_s, strict=True)]


def _refuse_unlikely(
    place: str,
    clock: str,
    names: Sequence[int | str],
    times_s: Sequence[Float[np.ndarray, " _"]],
    first_s: Float[np.ndarray, " E"],
) -> None:
    """Refuse a first step that would last far longer than any later one."""
    later_s = np.concatenate([np.diff(one) for one in times_s])
    wrong: Bool[np.ndarray, " E"] = first_s > MOST_FIRST * later_s.max(initial=-np.inf)
    if len(later_s) and wrong.any():
        k = int(np.argmax(wrong))
        raise LogError(
            f"{place}, episode {shown(names[k])}: by {clock} its first step would last {first_s[k]:g} s, and no later "
            f"step lasts more than {later_s.max():g} s; let {clock} begin at 0 in each episode, name a clock of the "
            "observations, or give step_s"
        )


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
