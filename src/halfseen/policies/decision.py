"""The interface of all deciders: they return a `Decision`, with the certainty of each action's Q.

A policy learned with pessimism holds M. M = c·R, where c is its number of standard errors (*pessimism*) and R a root of
the covariance of each block's coefficients. So with x = (1, φ(S, a)) and k the block of action a,

    Q_a = Q̂_a + (Rₖᵀ x_a)ᵀ z_k,    z_k ~ N(0, I).

Blocks share no rows and so no z: errors are correlated within a block and independent between blocks. This is the error
of one regression. Q̂ also rests on the regressions of the m − 1 later stages, on average, whose errors are assumed to
be as large:

- *An interval* is Q̂ ± 1.96 √(m²‖Rₖᵀ x_a‖² + ℓ²). Regressions that share rows may all err in the same direction, so
  their standard errors are added, which is an upper bound. ℓ is a model error of Q that no larger log removes: Q may
  not have the fitted form. It was chosen on tables of three cups over five steps, whose exact Q is known.
- *The chance of being best* comes from draws with √(m + ℓ²/s²)·z, where s² is the mean of ‖Rₖᵀ x_a‖² over the actions,
  as if the errors of stages were independent: an error common to all actions does not change which is best.

*Not covered:* the selection of the best-looking action, the pessimism of the learned Q, and confounders missing from
the log. ``benchmarks/calibration.py`` measures the coverage on small tables, where Q is known.
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
    """An action, with the reasons for it.

    Parameters
    ----------
    action
        The action, by name; on a table such as ``"LIFT 2"``.
    q_values
        The values that are compared: Q of each action by name, less its margin for pessimism [reward]; None if it is
        impossible. Empty if the policy has no values.
    reason
        Why the action is best, in one sentence.
    warnings
        Doubts about the decision, the gravest first.
    intervals
        95 % confidence interval of Q itself, by name of each possible action [reward]; empty if unknown.
    chance_best
        Probability that no action is better, by name of each possible action; empty if unknown.
    filled
        Missing covariates that were filled in; `warnings` give the values.
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
    """Decides from an observation: a `NamedObservation`, or the present state of a table's trajectory (`Present`)."""

    def decide(self, observation: Any) -> Decision:
        """Decide once.

        Raises
        ------
        HalfseenError
            The policy cannot decide from this observation.
        """
        ...


SAME_VALUE = 1e-5
"""Values that differ by less are tied, relative to the largest; float32 cannot distinguish them."""
_LIKELIER = 0.05
"""Difference in the chance of being best from which the reason mentions another action."""


def least_gap(values: Float[np.ndarray, " A"]) -> float:
    """Difference up to which values are tied, whatever the unit of rewards [reward]."""
    return SAME_VALUE * float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def written_gap(gap: float) -> str:
    """Write a difference of values [reward]; one that two decimals would hide, with two digits."""
    return f"{gap:.2f}" if gap >= 0.005 or not gap else f"{gap:.2g}"


def next_best(q: Float[np.ndarray, " A"], best: int) -> int | None:
    """Find the best of the other actions; None if no other is possible."""
    others = np.where(np.arange(len(q)) == best, -np.inf, q)
    other = int(np.argmax(others))
    return other if np.isfinite(others[other]) else None


def lead(names: Sequence[str], q: Float[np.ndarray, " A"], best: int, chance_best: Mapping[str, float]) -> str:
    """Say by how much the best action leads the next best, and how sure that is."""
    other = next_best(q, best)
    if other is None:
        return f"{names[best]}: no other action is possible"
    gap = float(q[best] - q[other])
    is_same = gap <= least_gap(q)
    worth = f"worth as much as {names[other]}" if is_same else f"worth {written_gap(gap)} more than {names[other]}"
    return f"{names[best]}: {worth}{_how_sure(names[best], chance_best)}"


def _how_sure(best: str, chance_best: Mapping[str, float]) -> str:
    if not chance_best:
        return ""
    likeliest = max(chance_best, key=lambda name: chance_best[name])
    sure = f", and best with a chance of {chance_best[best]:.0%}"
    if chance_best[likeliest] < chance_best[best] + _LIKELIER:
        return sure
    return (
        f"{sure}; {likeliest} is more likely the best ({chance_best[likeliest]:.0%}), but has less support in the logs"
    )


def values_by_name(names: Sequence[str], q: Float[np.ndarray, " A"]) -> dict[str, float | None]:
    """Q of each action by name; None if it is impossible."""
    return {name: float(value) if isfinite(value) else None for name, value in zip(names, q, strict=True)}


LEVEL = 0.95
"""Nominal coverage of an interval."""

NUM_DRAWS = 20_000
"""Number of draws for a chance of being best: its standard error is at most 0.004."""

SEED = 0

LASTING_ERROR = 0.2
"""ℓ in standard deviations of the reward of a stage."""


@dataclass(frozen=True)
class QError:
    """Errors of a learned Q, besides its margin.

    Parameters
    ----------
    pessimism
        c, the number of standard errors in the margin; above 0.
    stages_left
        For each stage, the mean number of stages from it to the end of a trajectory; for stages that are not listed,
        all that the horizon leaves.
    lasting
        ℓ, the error of Q that no larger log removes, as a standard deviation [reward].
    """

    pessimism: float
    stages_left: Sequence[float] = ()
    lasting: float = 0.0

    def stages_from(self, stage: int, horizon: int) -> float:
        """Mean number of stages from one to the end of a trajectory."""
        known = self.stages_left
        return float(known[stage - 1]) if stage <= len(known) else float(horizon - stage + 1)


class Certainty(NamedTuple):
    """Certainty of Q, by action."""

    low: Float[np.ndarray, " A"]
    """Lower end of the interval [reward]; −∞ if the action is impossible."""
    high: Float[np.ndarray, " A"]
    """Upper end [reward]; −∞ if the action is impossible."""
    chance_best: Float[np.ndarray, " A"]
    """Probability that no action is better; 0 where the action is impossible."""

    def by_name(self, names: Sequence[str]) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
        """Intervals and chances of the possible actions, in the form of a `Decision`."""
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
    """Return the certainty of Q in one state.

    Parameters
    ----------
    q
        Q̂ of each action, without any margin [reward]; arbitrary where impossible.
    deviations
        Rₖᵀ (1, φ(S, a)) of each action; its norm is the standard error of this stage's regression [reward].
    block_of_action
        Block of coefficients of each action.
    is_possible
        Which actions are possible; at least one.
    stages_left
        m, the mean number of stages from this one to the end of a trajectory; 1 if this is the last.
    lasting
        ℓ, the error of Q that no larger log removes, as a standard deviation [reward].

    Returns
    -------
    Certainty
        Intervals have 95 % nominal coverage. A chance is a proportion of 20,000 draws from a fixed seed; actions tied
        for the best in a draw all count, so chances sum to 1 or more.

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
    is_best = draws >= draws.max(axis=1, keepdims=True) - least_gap(np.append(q[is_possible], stretch * spread))
    chance_best[is_possible] = [np.count_nonzero(of_action) / NUM_DRAWS for of_action in is_best.T]
    return Certainty(low, high, chance_best)


def reach(error: Float[np.ndarray, "*S"], stages_left: float, lasting: float) -> Float[np.ndarray, "*S"]:
    """Half-width of the interval of Q, given standard errors of this stage's regression [reward]."""
    return np.asarray(NormalDist().inv_cdf((1.0 + LEVEL) / 2.0) * np.hypot(stages_left * error, lasting))


def _draws(
    q: Float[np.ndarray, " A"], deviations: Float[np.ndarray, "A F"], block_of_action: Int[np.ndarray, " A"]
) -> Float[np.ndarray, "B A"]:
    """Draws for all actions jointly, block by block in order."""
    is_of = [block_of_action == block for block in np.unique(block_of_action)]
    # One normal number per action suffices, however many features a block has; a number is its own root.
    blocks = [deviations[these].T for these in is_of]
    roots = [block if block.size == 1 else np.linalg.qr(block, mode="r") for block in blocks]
    # Actions are the first axis: the maximum of each draw is then as fast to find as that of whole columns.
    draws = np.empty((len(q), NUM_DRAWS)).T
    for these, root, normal in zip(is_of, roots, _normals(tuple(map(len, roots))), strict=True):
        # A block of width 1 needs no matrix product.
        draws[:, these] = q[these] + (normal * root if len(root) == 1 else normal @ root)
    return draws


@lru_cache(maxsize=8)
def _normals(widths: tuple[int, ...]) -> list[Float[np.ndarray, "B _"]]:
    """Standard normal numbers for blocks of these widths, from the fixed seed; cached for servers."""
    rng = np.random.default_rng(SEED)
    return [rng.standard_normal((NUM_DRAWS, width)) for width in widths]
