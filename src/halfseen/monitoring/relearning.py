"""When learning again may pay: how many trajectories there are since the change, and how many are needed.

A policy that was learned from n trajectories has a promise with a standard error s, so one of m later ones would have
about s √(n/m). What was lost, d, is clearly more than that from m = n (2s/d)² on. How much of it can be had again only
what is learned can tell.
"""

from collections.abc import Mapping

import numpy as np

from halfseen.wording import counted

CLEARLY = 2.0
"""Standard errors."""
FEWEST = 200
"""Trajectories; where nothing changes, a policy of the bin from 100 earns a fifth less than one from 500, and one from
200 a twentieth less than one from 600 (`benchmarks/relearning.py`)."""
MEND_FIRST = "Mend what is recorded before you learn again: columns have changed, and perhaps not the cell."
OWN = 0.98
"""Share of the actions that are the policy's, from which on the log says too little of all others."""


def num_needed(value: Mapping[str, float] | None, num_learned: int, now: float | None) -> int | None:
    """Tell from how many trajectories on learning again may pay; None where nothing was lost.

    Parameters
    ----------
    value
        What was promised, ``value`` and ``standard_error``; None where nothing was.
    num_learned
        n, trajectories behind the promise.
    now
        What is earned since the change; None where that is not known.

    Examples
    --------
    >>> num_needed({"value": 0.75, "standard_error": 0.125}, 400, 0.5)
    400
    >>> num_needed({"value": 0.75, "standard_error": 0.125}, 400, -0.25)
    200
    """
    if value is None or now is None:
        return FEWEST
    lost = value["value"] - now
    if lost <= 0.0:
        return None
    return max(FEWEST, int(np.ceil(num_learned * (CLEARLY * value["standard_error"] / lost) ** 2)))


def relearning(num_since: int, since: str | int, needed: int | None, own: float) -> str:
    """Say whether learning again may pay.

    Parameters
    ----------
    num_since
        Trajectories since the change.
    since
        Name of the first of them.
    needed
        As `num_needed` tells.
    own
        Share of their actions that are the policy's.
    """
    there = f"{counted(num_since, 'trajectory')} since the change"
    if needed is None:
        return f"Learning again need not pay: nothing is lost in {there}."
    blind = "; serve with --explore first, for they show hardly any action but the policy's" if own > OWN else ""
    if num_since < needed:
        return f"Learning again will not pay yet: there are {there}, and about {needed:,} are needed{blind}."
    how = f"halfseen learn LOGS --out FOLDER --since {since}"
    return f"Learning again may pay: there are {there}, and about {needed:,} are needed ({how}){blind}."
