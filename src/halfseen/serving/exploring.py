"""Now and then another action than the best, drawn at random, so that the log tells what it is worth.

With ε and k possible actions, the best is taken with probability 1 − ε + ε/k and each other with ε/k: every action that
is possible has a probability above 0, and the log says which.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from halfseen.policies.decision import Decision


class Taken(NamedTuple):
    """What is done, and how likely that was."""

    decision: Decision
    """With the action that is taken; where it was drawn, the reason says so."""
    probability: float
    """With which it is taken; above 0."""
    is_explored: bool
    """Whether another than the best was drawn."""


def taken(decision: Decision, epsilon: float, rng: np.random.Generator) -> Taken:
    """Take the action of a decision, or with probability ε one of all that are possible.

    Parameters
    ----------
    decision
        What the policy decides, with the Q of each possible action.
    epsilon
        ε, in [0, 1).
    rng
        What is drawn with; it is left alone where ε is 0.

    Examples
    --------
    >>> best = Decision("A", {"A": 1.0, "B": 0.5, "C": None}, "A: worth 0.50 more than B.")
    >>> taken(best, 0.0, np.random.default_rng(0)).probability
    1.0
    >>> drawn = [taken(best, 0.5, np.random.default_rng(seed)) for seed in range(99)]
    >>> sorted({(one.decision.action, one.probability) for one in drawn})
    [('A', 0.75), ('B', 0.25)]
    """
    if epsilon == 0.0:
        return Taken(decision, 1.0, False)
    possible = [name for name, q in decision.q_values.items() if q is not None]
    each = epsilon / len(possible)
    drawn = possible[int(rng.integers(len(possible)))] if rng.random() < epsilon else str(decision.action)
    if drawn == str(decision.action):
        return Taken(decision, 1.0 - epsilon + each, False)
    reason = f"{drawn}: by chance, to explore; left to itself the policy takes {decision.reason}"
    return Taken(replace(decision, action=drawn, reason=reason), each, True)
