"""Now and then another action than the best, drawn at random, so that the log tells what it is worth.

With ε and k possible actions, the best is taken with probability 1 − ε + ε/k and each other with ε/k: every action that
is possible has a probability above 0, and the log says which. A table draws the actions that it names instead, each
with a probability of its own, where they are wanted.
"""

from collections.abc import Mapping
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


def uniform_shares(decision: Decision, epsilon: float) -> dict[str, float]:
    """ε/k of each action that is possible."""
    possible = [name for name, q in decision.q_values.items() if q is not None]
    return {name: epsilon / len(possible) for name in possible} if epsilon > 0.0 else {}


def taken(decision: Decision, shares: Mapping[str, float], rng: np.random.Generator) -> Taken:
    """Take the action of a decision, or one that is drawn.

    Parameters
    ----------
    decision
        What the policy decides, with the Q of each possible action.
    shares
        Probability with which each action is drawn; of impossible ones it is left to the decision.
    rng
        What is drawn with; it is left alone where nothing can be drawn.

    Examples
    --------
    >>> best = Decision("A", {"A": 1.0, "B": 0.5, "C": None}, "A: worth 0.50 more than B.")
    >>> taken(best, {}, np.random.default_rng(0)).probability
    1.0
    >>> shares = uniform_shares(best, 0.5)
    >>> drawn = [taken(best, shares, np.random.default_rng(seed)) for seed in range(99)]
    >>> sorted({(one.decision.action, one.probability) for one in drawn})
    [('A', 0.75), ('B', 0.25)]
    """
    possible = {name: share for name, share in shares.items() if decision.q_values.get(name) is not None}
    if not possible:
        return Taken(decision, 1.0, False)
    best, luck = str(decision.action), rng.random()
    reached = np.cumsum(list(possible.values()))
    drawn = [*possible, best][int(np.searchsorted(reached, luck, side="right"))]
    if drawn == best:
        return Taken(decision, 1.0 - float(reached[-1]) + possible.get(best, 0.0), False)
    reason = f"{drawn}: by chance, to explore; left to itself the policy takes {decision.reason}"
    return Taken(replace(decision, action=drawn, reason=reason), possible[drawn], True)
