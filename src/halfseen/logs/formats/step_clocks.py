"""When the steps of other people's datasets ended.

Times count from the beginning of an episode. Those of T + 1 observations say when it began. Those at which its T steps
ended do not: such a clock begins at 0 in each episode, or it runs on over episodes, and each begins when the one before
ended.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from halfseen.errors import LogError, warn
from halfseen.logs.columns import shown
from halfseen.shapes import Float, Int

MOST_FIRST = 3.0
"""How many times as long as the longest other step a first one may be, where it is not sure when it began."""
LONGEST_S = 1e6
"""What lasts longer in whole numbers was counted in another unit: 12 days [s], and 1 ms in nanoseconds."""


def even_ends(begins: Int[np.ndarray, " E1"], step_s: float) -> Float[np.ndarray, " M"]:
    """Ends of steps since their episode began [s] that last the same time each, by the steps that begin episodes."""
    return step_s * (np.arange(1.0, begins[-1] + 1) - np.repeat(begins[:-1], np.diff(begins)))


def ends_by_observations(
    times_s: Float[np.ndarray, " N"], begins: Int[np.ndarray, " E1"], last_s: float = 0.0
) -> Float[np.ndarray, " N"]:
    """Ends of rows since their episode began [s], by when each was observed [s]; the last one lasts `last_s` [s]."""
    ends_s, last = np.append(times_s[1:], 0.0), begins[1:] - 1
    ends_s[last] = times_s[last] + last_s
    return ends_s - np.repeat(times_s[begins[:-1]], np.diff(begins))


def ends_by_steps(
    place: str, clock: str, names: Sequence[int | str], times_s: Sequence[Float[np.ndarray, " _"]]
) -> list[Float[np.ndarray, " _"]]:
    """Ends of steps since their episode began [s], by the clock at the ends of the steps of each, in order [s].

    Raises
    ------
    LogError
        An episode begins at a time that nobody can tell: its first step would last far longer than any later one.
    """
    runs_on = np.array([one[-1] < other[0] for one, other in pairwise(times_s)], dtype=bool)
    if not runs_on.any():
        return list(times_s)
    is_on = bool(runs_on.all())
    begins_s = [0.0, *(float(one[-1]) if is_on else 0.0 for one in times_s[:-1])]
    first_s = np.array([float(one[0]) - begin_s for one, begin_s in zip(times_s, begins_s, strict=True)])
    later_s = np.concatenate([np.diff(one) for one in times_s])
    unsure_s = np.where(np.append(is_on, runs_on), first_s, 0.0)
    wrong = unsure_s > MOST_FIRST * later_s.max(initial=-np.inf)
    if len(later_s) and wrong.any():
        k = int(np.argmax(wrong))
        raise LogError(
            f"{place}, episode {shown(names[k])}: by {clock} its first step would last {unsure_s[k]:g} s, and no later "
            f"step lasts more than {later_s.max():g} s; let {clock} begin at 0 in each episode, name a clock of the "
            "observations, or give step_s"
        )
    on, own = "begins when the one before ended, and the first at 0", "counts from its own beginning, as others do"
    warn(
        place,
        f"{clock} is later in the first step of an episode than at the end of the one before, {int(runs_on.sum())} of "
        f"{len(runs_on)} times: each {on if is_on else own}; the first steps last up to {first_s.max():g} s",
    )
    return [one - begin_s for one, begin_s in zip(times_s, begins_s, strict=True)]


def refuse_counts(place: str, ends_s: Float[np.ndarray, " M"], num_steps: Int[np.ndarray, " E"]) -> None:
    """Refuse whole numbers that cannot be seconds: of M ends of steps [s], so many in each of E episodes.

    Raises
    ------
    LogError
        Half of the steps or more last `LONGEST_S` or more, and as many end at whole numbers.
    """
    first = np.cumsum(num_steps) - num_steps
    lasted_s = np.diff(ends_s, prepend=0.0)
    lasted_s[first] = ends_s[first]
    middle_s = float(np.median(lasted_s))
    # The last step of an episode may last what one does by the rate of the dataset.
    if middle_s >= LONGEST_S and np.mean(ends_s == np.floor(ends_s)) >= 0.5:
        raise LogError(
            f"{place}: steps last {middle_s:.4g} s by its clock, in whole numbers, as if it counted nanoseconds or "
            "microseconds; give the clock in seconds, or step_s (--step-s) in its place"
        )
