"""What a log can vouch for: of some policies the one whose gain has the largest lower bound, and a claim that holds.

The lower bound of what was chosen for its large lower bound is too large. So for each fold of the paths the policy is
chosen by the paths of the others alone, and judged by its own; what all folds say of what was chosen without them is
one contender. Its lower bound holds as often as that of a policy that was given [Thomas2015]_: each path counts for a
choice in which it had no say. What is vouched for in the end is the choice by all paths.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from halfseen.evaluation.comparison import Contender
from halfseen.shapes import Bool, Float, Int


class Vouched(NamedTuple):
    """The choice among some policies."""

    chosen: int
    """By all paths."""
    claim: Contender
    """What each path says of the policy that was chosen without its fold."""


def vouched(
    candidates: Sequence[Contender], opponents: Sequence[Contender], fold: Int[np.ndarray, " n"], level: float
) -> Vouched:
    """Choose among policies, for each fold and for all paths.

    Parameters
    ----------
    candidates
        What the log knows of each; the first is taken where nothing is known of any.
    opponents
        What each has to beat; those of which nothing is known do not count.
    fold
        Of each path.
    level
        Of the intervals.
    """
    known = [each for each in opponents if each.values is not None and each.why_unknown is None]

    def chosen(kept: Bool[np.ndarray, " n"]) -> int:
        return int(
            np.argmax([_least(_kept(one, kept), [_kept(each, kept) for each in known], level) for one in candidates])
        )

    of_fold = np.array([chosen(fold != k) for k in range(int(fold.max()) + 1)])
    return Vouched(chosen(np.ones(len(fold), dtype=bool)), _mixed(candidates, of_fold[fold]))


def _least(one: Contender, opponents: Sequence[Contender], level: float) -> float:
    """The smallest lower bound of what it earns more than an opponent."""
    if one.values is None or one.why_unknown is not None:
        return -np.inf
    return min((one.less(each, level).low for each in opponents), default=-np.inf)


def _kept(one: Contender, kept: Bool[np.ndarray, " n"]) -> Contender:
    """What some paths say."""
    size = one.effective_sample_size * float(kept.mean())
    return one._replace(
        values=None if one.values is None else one.values[kept], without=None, effective_sample_size=size
    )


def _mixed(candidates: Sequence[Contender], of_path: Int[np.ndarray, " n"]) -> Contender:
    """Each path says of a policy of its own."""
    taken = [candidates[k] for k in np.unique(of_path)]
    unknown = next((each for each in taken if each.values is None or each.why_unknown is not None), None)
    if unknown is not None or len(taken) == 1:
        return unknown or taken[0]
    share = np.bincount(of_path, minlength=len(candidates))[np.unique(of_path)] / len(of_path)

    def by_path(leaf: str) -> np.ndarray:
        return np.stack([getattr(each, leaf) for each in candidates])[of_path, np.arange(len(of_path))]

    def by_share(leaf: str) -> Float[np.ndarray, "*_"]:
        return np.tensordot(share, np.stack([np.asarray(getattr(each, leaf)) for each in taken]), 1)

    return taken[0]._replace(
        values=by_path("values"),
        errors=by_path("errors"),
        without=by_share("without"),
        uncorrected=float(by_share("uncorrected")),
        truncated=float(by_share("truncated")),
        by_model=float(by_share("by_model")),
        effective_sample_size=min(each.effective_sample_size for each in taken),
    )
