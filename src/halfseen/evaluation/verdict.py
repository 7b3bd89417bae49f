"""Better than the logging policy, not better, or cannot be said; and why, in one plain sentence."""

from typing import Literal

import numpy as np
from jaxtyping import Float

from halfseen.evaluation.estimate import Estimate

Verdict = Literal["better", "not better", "cannot be said"]

FEWEST_PATHS = 10.0
"""Below this effective sample size no interval is believed."""


def verdict_of(
    difference: Estimate, support: Float[np.ndarray, " T"], num_reached: int, unseen: str | None = None
) -> tuple[Verdict, str]:
    """Judge by the interval of the paired difference, where the log supports one.

    Parameters
    ----------
    difference
        Value of the policy less that of the logging policy; its effective sample size is that of the policy's paths.
    support
        Of each stage, the share of the logged actions that the policy would take at all.
    num_reached
        Stages that the log holds.
    unseen
        An action that the policy takes and that the log never saw completed.
    """
    if unseen is not None:
        return "cannot be said", (
            f"the policy takes {unseen}, which no path of the log was seen to complete, so nothing is known of what it "
            "brings; log some paths that take it, uniformly at random now and then"
        )
    lacking = np.flatnonzero(support[:num_reached] == 0)
    if len(lacking):
        return "cannot be said", (
            f"no logged action of stage {lacking[0] + 1} is one that the policy would take; log some paths that take "
            "them, uniformly at random now and then"
        )
    paths = difference.effective_sample_size
    if paths < FEWEST_PATHS:
        return "cannot be said", (
            f"the effective sample size is {paths:.1f} paths that follow the policy, and fewer than {FEWEST_PATHS:g} "
            "tell nothing; record more paths, or some of a logging policy that is closer to this one"
        )
    within = f"between {difference.low:.3g} and {difference.high:.3g}"
    if difference.low > 0:
        return "better", f"it earns {difference.value:.3g} more a path than the logging policy, {within}"
    if difference.high <= 0:
        less = f"{-difference.value:.3g} less a path than" if difference.value < 0 else "as much a path as"
        return "not better", f"it earns {less} the logging policy, {within} more"
    return "cannot be said", f"it earns {within} more a path than the logging policy; {_more_paths(difference)}"


def _more_paths(difference: Estimate) -> str:
    reach = (difference.high - difference.low) / 2.0
    times = (reach / abs(difference.value)) ** 2 if difference.value else np.inf
    if times > 100.0:
        return "there is no significant difference, nor would a log many times as large show one if that is all"
    return f"if it is {difference.value:.3g}, some {np.ceil(times * 10) / 10:.1f} times as many paths would tell"
