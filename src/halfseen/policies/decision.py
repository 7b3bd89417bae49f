"""The port: whatever decides is asked for a `Decision`, by a command line, a study or a server alike."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Protocol, runtime_checkable

import numpy as np

from halfseen.shapes import Float


@dataclass(frozen=True)
class Decision:
    """What to do, and why.

    Parameters
    ----------
    action
        What to do, by name; on a table such as ``"LIFT 2"``.
    q_values
        What the policy goes by: Q of each action by name, with pessimism lowered by its margin [reward]; None where it
        is not possible. Empty where the policy values nothing.
    reason
        Why it is best, in one sentence.
    warnings
        What is doubtful, the gravest first.
    intervals
        95 % interval of Q itself, by name of each possible action [reward]; empty where nobody knows it.
    chance_best
        Probability that no action is better, by name of each possible action; empty where nobody knows it.
    filled
        Covariates that were missing, and were filled in; `warnings` say by what.
    """

    action: Any
    q_values: dict[str, float | None]
    reason: str
    warnings: tuple[str, ...] = ()
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    chance_best: Mapping[str, float] = field(default_factory=dict)
    filled: tuple[str, ...] = ()


@runtime_checkable
class Decider(Protocol):
    """Decides from what is observed: a `NamedObservation`, or where a table's trajectory stands (`Present`)."""

    def decide(self, observation: Any) -> Decision:
        """Decide once.

        Raises
        ------
        HalfseenError
            The observation is not one that the policy can decide from.
        """
        ...


SAME_VALUE = 1e-5
_LIKELIER = 0.05
"""By which another action must be likelier the best before the reason tells of it."""


def next_best(q: Float[np.ndarray, " A"], best: int) -> int | None:
    """Find the best of the other actions; None where nothing else is possible."""
    others = np.where(np.arange(len(q)) == best, -np.inf, q)
    other = int(np.argmax(others))
    return other if np.isfinite(others[other]) else None


def lead(names: Sequence[str], q: Float[np.ndarray, " A"], best: int, chance_best: Mapping[str, float]) -> str:
    """Say what the best action is worth more than the next best, and how sure that is."""
    other = next_best(q, best)
    if other is None:
        return f"{names[best]}: nothing else is possible"
    gap = float(q[best] - q[other])
    is_same = gap < SAME_VALUE * max(1.0, abs(float(q[best])))
    worth = f"worth as much as {names[other]}" if is_same else f"worth {gap:.2f} more than {names[other]}"
    return f"{names[best]}: {worth}{_how_sure(names[best], chance_best)}"


def _how_sure(best: str, chance_best: Mapping[str, float]) -> str:
    if not chance_best:
        return ""
    likeliest = max(chance_best, key=lambda name: chance_best[name])
    sure = f", and best with a chance of {chance_best[best]:.0%}"
    if chance_best[likeliest] < chance_best[best] + _LIKELIER:
        return sure
    return f"{sure}; {likeliest} is likelier best ({chance_best[likeliest]:.0%}), but the logs bear it out less"


def values_by_name(names: Sequence[str], q: Float[np.ndarray, " A"]) -> dict[str, float | None]:
    """Q of each action by name; None where it is not possible."""
    return {name: float(value) if isfinite(value) else None for name, value in zip(names, q, strict=True)}
