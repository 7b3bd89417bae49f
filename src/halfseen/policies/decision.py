"""The port: whatever decides is asked for a `Decision`; and how sure that is, by action.

A policy that was learned with pessimism holds M, and M = c·R with c its standard errors (*pessimism*) and R a root of
the covariance of each block's coefficients. So with x = (1, φ(S, a)) and k the block of action a,

    Q_a = Q̂_a + (Rₖᵀ x_a)ᵀ z_k,    z_k ~ N(0, I),

where blocks share no rows and so no z: actions of one block err together, those of different blocks independently.
That is the error of one regression. Q̂ also rests on those of the m − 1 stages that are still to come, on average,
whose errors are taken to be as large:

- *An interval* is Q̂ ± 1.96 √(m²‖Rₖᵀ x_a‖² + ℓ²). Regressions that share rows may all err the same way, and then their
  errors add up; larger than that sum a standard error cannot be. ℓ is an error of Q that no larger log mends: Q may not
  be of the form that was fitted. It was chosen on tables of three cups over five steps, whose exact Q is known.
- *The chance of being best* comes from draws with √(m + ℓ²/s²)·z, s² the mean of ‖Rₖᵀ x_a‖² over the actions, as if the
  errors of stages were independent: what actions have in common is no reason to doubt which is better.

*What this does not know:* what was chosen because it looked best, that Q was learned with caution, and causes that the
log does not hold. ``benchmarks/calibration.py`` says how often all this holds of small tables, where Q is known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from math import isfinite
from statistics import NormalDist
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from halfseen.shapes import Bool, Float, Int


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
"""Values that differ by less are tied [reward]: more than float32 can tell apart."""
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


LEVEL = 0.95
"""Probability with which an interval is to hold."""

NUM_DRAWS = 20_000
"""Of which a chance of being best is the share: it errs by 0.004 at most, by one standard error."""

SEED = 0

LASTING_ERROR = 0.2
"""ℓ in standard deviations of what a stage pays."""


@dataclass(frozen=True)
class QError:
    """What is known of the errors of a learned Q, besides its margin.

    Parameters
    ----------
    pessimism
        c, the standard errors that the margin is; above 0.
    stages_left
        By stage, how many there are from it to the end of a trajectory, on average; for stages that are not there, all
        that the horizon leaves.
    lasting
        Error of Q that no log takes away, as a standard deviation [reward].
    """

    pessimism: float
    stages_left: Sequence[float] = ()
    lasting: float = 0.0

    def stages_from(self, stage: int, horizon: int) -> float:
        """Stages from one to the end of a trajectory, on average."""
        known = self.stages_left
        return float(known[stage - 1]) if stage <= len(known) else float(horizon - stage + 1)


class Certainty(NamedTuple):
    """What is known of Q, by action."""

    low: Float[np.ndarray, " A"]
    """Least value that the interval holds [reward]; −∞ where the action is impossible."""
    high: Float[np.ndarray, " A"]
    """Largest value [reward]; −∞ where the action is impossible."""
    chance_best: Float[np.ndarray, " A"]
    """Probability that no action is better; 0 where the action is impossible."""

    def by_name(self, names: Sequence[str]) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
        """Intervals and chances of the possible actions, as a `Decision` holds them."""
        possible = [(name, k) for k, name in enumerate(names) if np.isfinite(self.low[k])]
        intervals = {name: (float(self.low[k]), float(self.high[k])) for name, k in possible}
        return intervals, {name: float(self.chance_best[k]) for name, k in possible}


def certainty(
    q: Float[np.ndarray, " A"],
    deviations: Float[np.ndarray, "A F"],
    block_of_action: Int[np.ndarray, " A"],
    is_possible: Bool[np.ndarray, " A"],
    stages_left: float = 1.0,
    lasting: float = 0.0,
) -> Certainty:
    """Tell how sure Q̂ of one state is.

    Parameters
    ----------
    q
        Q̂ of each action, without any margin [reward]; anything where it is impossible.
    deviations
        Rₖᵀ (1, φ(S, a)) of each action: its length is the standard error of this stage's regression [reward].
    block_of_action
        Block of coefficients of each action.
    is_possible
        Which actions there are to choose from; at least one.
    stages_left
        m, stages from this one to the end of a trajectory, on average; 1 where this is the last.
    lasting
        ℓ, the error of Q that no log takes away, as a standard deviation [reward].

    Returns
    -------
    Certainty
        Intervals hold with 95 %. A chance is a share of 20,000 draws from a fixed seed; actions that are equally good
        in a draw are all the best there, so that chances sum to 1 or more.

    Examples
    --------
    Two actions that err independently: the first is better with probability Φ(1 / √2).

    >>> found = certainty(
    ...     np.array([1.0, 0.0]), np.array([[1.0], [1.0]]), np.array([0, 1]), np.ones(2, dtype=bool)
    ... )
    >>> found.low.round(2), found.high.round(2), found.chance_best.round(1)
    (array([-0.96, -1.96]), array([2.96, 1.96]), array([0.8, 0.2]))
    """
    error = np.linalg.norm(deviations, axis=1)
    half = reach(error, stages_left, lasting)
    low, high = (np.where(is_possible, q + side * half, -np.inf) for side in (-1.0, 1.0))
    spread = float(np.sqrt(np.mean(error[is_possible] ** 2)))
    stretch = np.hypot(np.sqrt(stages_left), lasting / spread if spread > 0 else 0.0)
    draws = _draws(q[is_possible], stretch * deviations[is_possible], block_of_action[is_possible])
    chance_best = np.zeros(len(q))
    is_best = draws >= draws.max(axis=1, keepdims=True) - SAME_VALUE
    chance_best[is_possible] = [np.count_nonzero(of_action) / NUM_DRAWS for of_action in is_best.T]
    return Certainty(low, high, chance_best)


def reach(error: Float[np.ndarray, "*S"], stages_left: float, lasting: float) -> Float[np.ndarray, "*S"]:
    """Half the width of the interval of Q, given standard errors of this stage's regression [reward]."""
    return np.asarray(NormalDist().inv_cdf((1.0 + LEVEL) / 2.0) * np.hypot(stages_left * error, lasting))


def _draws(
    q: Float[np.ndarray, " A"], deviations: Float[np.ndarray, "A F"], block_of_action: Int[np.ndarray, " A"]
) -> Float[np.ndarray, "B A"]:
    """Draws of all actions together, block by block in their order."""
    is_of = [block_of_action == block for block in np.unique(block_of_action)]
    # As many normal numbers as there are actions do, however many features a block has.
    roots = [np.linalg.qr(deviations[these].T, mode="r") for these in is_of]
    # By action first, which makes the largest of each draw as fast to find as that of whole columns.
    draws = np.empty((len(q), NUM_DRAWS)).T
    for these, root, normal in zip(is_of, roots, _normals(tuple(map(len, roots))), strict=True):
        # A product of one number each is no matter for a matrix product.
        draws[:, these] = q[these] + (normal * root if len(root) == 1 else normal @ root)
    return draws


@lru_cache(maxsize=8)
def _normals(widths: tuple[int, ...]) -> list[Float[np.ndarray, "B _"]]:
    """Standard normal numbers for blocks of these widths, from the fixed seed; a server wants the same ones often."""
    rng = np.random.default_rng(SEED)
    return [rng.standard_normal((NUM_DRAWS, width)) for width in widths]
