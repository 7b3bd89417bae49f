"""End times of steps in datasets of other programs.

Times count from the beginning of an episode. The times of T + 1 observations include that beginning. The end times of
T steps do not: such a clock either starts at 0 in each episode, or runs on across episodes, each of which begins when
the one before ended.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from halfseen.errors import LogError, warn
from halfseen.logs.columns import first_true, shown
from halfseen.shapes import Float, Int, Shaped

MOST_FIRST = 3.0
"""Largest ratio of a first step with unknown beginning to the longest other step."""
LATEST_S = 1e11
"""Later times are no dates in seconds since 1970, as this is the year 5138 [s]."""
LONGEST_S = 1e6
"""Longer steps in whole numbers are not in seconds: this is 12 days in seconds, but 1 ms in nanoseconds."""


def even_ends(begins: Int[np.ndarray, " E1"], step_s: float) -> Float[np.ndarray, " M"]:
    """Ends of steps of equal length since their episode began [s]; `begins` holds the first step of each episode."""
    return step_s * (np.arange(1.0, begins[-1] + 1) - np.repeat(begins[:-1], np.diff(begins)))


def ends_by_observations(
    times_s: Float[np.ndarray, " N"], begins: Int[np.ndarray, " E1"], last_s: float = 0.0
) -> Float[np.ndarray, " N"]:
    """Ends of rows since their episode began [s], from their observation times [s]; the last row lasts `last_s` [s]."""
    ends_s, last = np.append(times_s[1:], 0.0), begins[1:] - 1
    ends_s[last] = times_s[last] + last_s
    return ends_s - np.repeat(times_s[begins[:-1]], np.diff(begins))


def ends_by_steps(
    place: str, clock: str, names: Sequence[int | str], times_s: Sequence[Float[np.ndarray, " _"]]
) -> list[Float[np.ndarray, " _"]]:
    """Ends of steps since their episode began [s], from the clock at the ends of each episode's steps, in order [s].

    Raises
    ------
    LogError
        The beginning of an episode is unknown: its first step would last far longer than any later one.
    """
    runs_on = np.array([one[-1] < other[0] for one, other in pairwise(times_s)], dtype=bool)
    if not runs_on.any():
        return list(times_s)
    is_on = bool(runs_on.all())
    begins_s = [0.0, *(float(one[-1]) if is_on else 0.0 for one in times_s[:-1])]
    first_s = np.array([float(one[0]) - begin_s for one, begin_s in zip(times_s, begins_s, strict=True)])
    later_s = np.concatenate([np.diff(one) for one in times_s])
    unsure_s = np.where(np.append(is_on, runs_on), first_s, 0.0)
    k = first_true(unsure_s > MOST_FIRST * later_s.max(initial=-np.inf))
    if len(later_s) and k is not None:
        raise LogError(
            f"{place}, episode {shown(names[k])}: by {clock} its first step would last {unsure_s[k]:g} s, but no "
            f"later step lasts more than {later_s.max():g} s; start {clock} at 0 in each episode, name a clock of the "
            "observations, or give step_s"
        )
    on, own = "begins when the one before ended, and the first at 0", "counts from its own beginning, as others do"
    warn(
        place,
        f"{clock} is later in the first step of an episode than at the end of the one before, {int(runs_on.sum())} of "
        f"{len(runs_on)} times: each {on if is_on else own}; the first steps last up to {first_s.max():g} s",
    )
    return [one - begin_s for one, begin_s in zip(times_s, begins_s, strict=True)]


def refuse_other_unit(place: str, clock: str, times_s: Shaped[np.ndarray, " N"]) -> None:
    """Refuse dates that are not in seconds, given N times [s] (`LogError`)."""
    latest = float(np.abs(times_s).max(initial=0))
    if latest > LATEST_S:
        raise LogError(
            f"{place}: {clock} is {latest:.4g}, which is no date in seconds, but may be one in milliseconds or a finer "
            "unit; write it in seconds, or give step_s (--step-s) in its place"
        )


def refuse_rounded(place: str, clock: str, times_s: Float[np.ndarray, " N"]) -> None:
    """Refuse a clock of single precision whose rounding is a tenth of a step or more (`LogError`); N times [s]."""
    steps_s = np.abs(np.diff(times_s.astype(np.float64)))
    if times_s.dtype.kind != "f" or not (steps_s > 0).any():
        return
    rounding_s, step_s = float(np.spacing(np.abs(times_s).max())), float(np.median(steps_s[steps_s > 0]))
    if times_s.dtype.itemsize < 8 and rounding_s >= step_s / 10:
        raise LogError(
            f"{place}: {clock} holds {times_s.dtype}, which rounds its times to multiples of {rounding_s:g} s, and "
            f"steps last {step_s:g} s; write it as float64, or start it at 0 in each episode"
        )


def refuse_counts(place: str, ends_s: Float[np.ndarray, " M"], num_steps: Int[np.ndarray, " E"]) -> None:
    """Refuse whole numbers that cannot be seconds, given M ends of steps [s] in E episodes.

    Raises
    ------
    LogError
        At least half of the steps last `LONGEST_S` or more, and at least half end at whole numbers.
    """
    first = np.cumsum(num_steps) - num_steps
    lasted_s = np.diff(ends_s, prepend=0.0)
    lasted_s[first] = ends_s[first]
    middle_s = float(np.median(lasted_s))
    # The length of the last step of an episode may come from the rate of the dataset.
    if middle_s >= LONGEST_S and np.mean(ends_s == np.floor(ends_s)) >= 0.5:
        raise LogError(
            f"{place}: steps last {middle_s:.4g} s by its clock, in whole numbers, as if it counted nanoseconds or "
            "microseconds; give the clock in seconds, or step_s (--step-s) in its place"
        )
