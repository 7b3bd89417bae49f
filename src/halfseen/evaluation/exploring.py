"""Which actions to explore, and in which states, so that the next log is more informative about a policy.

The contribution of a stage to the variance of a doubly robust value is (w_t (Y_t − Q̂_t))². If the log takes the action
of the policy more often, the weights of that stage and of all later ones shrink in proportion. Consider a region c of
states with n stages, in which the log takes that action in a share p, and let V be the variance contributed by these
stages and all later ones. Another share p′ would change V to about V·p/p′. For a fixed number of tries, Σ n p′, equal
to the number of stages in which the log takes an action other than its most frequent one, the variance is minimised by

    p′ ∝ √(V p / n),

Neyman's allocation [Neyman1934]_. Regions are the leaves of a small tree, grown where V differs, over the states in
which the policy deviates from the log's most frequent action.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from halfseen.evaluation.logging_rule import ranks
from halfseen.evaluation.marginal import laid_out
from halfseen.evaluation.off_policy import Case
from halfseen.learning.covariates import is_numeric
from halfseen.learning.named_task import NamedActions
from halfseen.shapes import Float, Int
from halfseen.text_table import aligned

MOST_REGIONS = 4
"""Per action."""
FEWEST_STAGES = 30
"""Per region."""
LARGEST_SHARE = 0.5
"""Largest share to explore: above it, the current rule becomes the exploration."""
LEAST_GAIN = 1.05
"""An interval narrower by less than this factor is not worth the exploration."""
LEAST_PART = 0.02
"""Of the variance; regions with less are omitted."""


class Exploration(NamedTuple):
    """What to explore, and the benefit."""

    regions: tuple["Region", ...]
    """Those with the most variance first."""
    narrower: float
    """Approximate factor by which the interval would be narrower, with as many trajectories."""

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {"regions": [region._asdict() for region in self.regions], "narrower": self.narrower}

    def __str__(self) -> str:
        rows = [("try", "where", "now", "then", "of the variance"), *(region.cells for region in self.regions)]
        hint = (
            "Or try the most informative actions more often: from as many trajectories the interval would be "
            f"{self.narrower:.1f} times narrower (for `halfseen serve --explore FILE`, which --exploration FILE "
            "writes)."
        )
        return "\n".join([hint, "", *aligned(rows, left=(0, 1))])


class Region(NamedTuple):
    """A region in which to take an action of the policy more often."""

    conditions: dict[str, str]
    """Conditions by column, as in a rule."""
    action: str
    now: float
    """Share of its stages in which the log takes the action."""
    wanted: float
    """The share that is most informative for the same number of tries."""
    part: float
    """Share of the variance that depends on these tries; regions may overlap."""

    @property
    def cells(self) -> tuple[str, ...]:
        """Its row of a table for readers."""
        where = ", ".join(f"{name} {condition}" for name, condition in self.conditions.items()) or "everywhere"
        return self.action, where, f"{self.now:.0%}", f"{self.wanted:.0%}", f"{self.part:.0%}"


NOWHERE = Exploration((), 1.0)
"""Nothing is worth exploring more often."""


def exploration_of(case: Case) -> Exploration:
    """Find where to explore the actions of a deterministic policy.

    The result is empty if states are not rows of covariates or if the log takes these actions often.
    """
    problem, task = case.problem, case.problem.model.task
    if not isinstance(task, NamedActions) or problem.log.policy is None:
        return NOWHERE
    trajectories, each = problem.trajectories, _variance(case)
    begun = trajectories.is_begun & trajectories.has_action
    wanted, taken = problem.log.policy[begun].argmax(axis=1), trajectories.action[begun]
    hangs = np.where(taken == wanted, each[:, ::-1].cumsum(axis=1)[:, ::-1][begun], 0.0)
    own = [name for name in task.covariates if "*" not in name]
    names = [name for name in dict.fromkeys(["stage", *own]) if is_numeric(problem.logs.stages, name)]
    columns = laid_out(problem.logs.stages[names].to_numpy(dtype=np.float64), problem.logs, trajectories)[begun]
    leaves = [
        _Leaf(names, limits, int(action), rows, taken[rows], hangs[rows], columns)
        for action in np.unique(wanted)
        for limits, rows in _leaves(columns, hangs, np.flatnonzero(wanted == action))
    ]
    whole = float(each.sum())
    kept = [leaf for leaf in leaves if leaf.share < LARGEST_SHARE and leaf.hanging > max(LEAST_PART * whole, 0.0)]
    shares, ratio = _allotted(kept), np.ones(len(wanted))
    for leaf, share in zip(kept, shares, strict=True):
        ratio[leaf.rows] = leaf.share / share
    factor = np.ones(begun.shape)
    factor[begun] = np.where(taken == wanted, ratio, 1.0)
    left = float((each * factor.cumprod(axis=1)).sum())
    owner = np.nonzero(begun)[0]
    # Each trajectory counts once, by its first stage in a region: what hangs on its later ones hangs on that, too.
    parts = [leaf.hangs[np.unique(owner[leaf.rows], return_index=True)[1]].sum() for leaf in kept]
    regions = [
        Region(leaf.conditions, str(task.names[leaf.action]), leaf.share, share, float(part) / whole)
        for leaf, share, part in zip(kept, shares, parts, strict=True)
    ]
    regions.sort(key=lambda region: -region.part)
    narrower = (whole / left) ** 0.5 if left > 0 else 1.0
    return Exploration(tuple(regions), narrower) if narrower >= LEAST_GAIN else NOWHERE


def _variance(case: Case) -> Float[np.ndarray, "n T"]:
    """(w_t (Y_t − Q̂_t))² of each stage."""
    problem, judged = case.problem, case.judged
    trajectory = np.arange(problem.trajectories.num_trajectories)
    target, taken = (np.asarray(leaf)[problem.fold, trajectory] for leaf in (judged.target, judged.taken))
    weight = problem.stage_weights[-1].normalised
    return np.where(weight > 0, weight * (target - taken), 0.0) ** 2


FEW_MOVED = 0.01
"""Largest share of the states on the other side of a limit as it is written."""


class _Leaf(NamedTuple):
    names: Sequence[str]
    limits: dict[int, tuple[float, float]]
    action: int
    rows: Int[np.ndarray, " m"]
    taken: Int[np.ndarray, " m"]
    hangs: Float[np.ndarray, " m"]
    columns: Float[np.ndarray, "n G"]
    """Of all stages."""

    @property
    def share(self) -> float:
        """Share of its stages in which the action was taken."""
        return float((self.taken == self.action).mean())

    @property
    def tries(self) -> float:
        """Stages in which an action other than the most frequent one was taken."""
        return float(len(self.taken) - np.bincount(self.taken).max())

    @property
    def hanging(self) -> float:
        """V."""
        return float(self.hangs.sum())

    @property
    def conditions(self) -> dict[str, str]:
        """Conditions by column."""
        ranges = {}
        for column, limits in self.limits.items():
            parts = [
                f"{sign} {_written(limit, self.columns[:, column])}"
                for sign, limit in zip((">", "<="), limits, strict=True)
                if np.isfinite(limit)
            ]
            ranges[self.names[column]] = " and ".join(parts)
        return ranges


def _written(limit: float, values: Float[np.ndarray, " m"]) -> str:
    """Write a limit with four digits, or as many as keep all but few values on their side."""
    texts = (f"{limit:.{digits}g}" for digits in range(4, 17))
    is_low = values <= limit
    return next((text for text in texts if np.mean((values <= float(text)) != is_low) <= FEW_MOVED), repr(limit))


def _leaves(
    columns: Float[np.ndarray, "m G"], hangs: Float[np.ndarray, " m"], rows: Int[np.ndarray, " k"]
) -> list[tuple[dict[int, tuple[float, float]], Int[np.ndarray, " l"]]]:
    """Limits and rows of each region: a regression tree that splits best-first [BreimanEtAl1984]_."""
    from sklearn.tree import DecisionTreeRegressor

    if not columns.shape[1] or len(rows) < 2 * FEWEST_STAGES:
        return [({}, rows)]
    ordered, found = ranks(columns), []
    model = DecisionTreeRegressor(max_leaf_nodes=MOST_REGIONS, min_samples_leaf=FEWEST_STAGES, random_state=0)
    tree = model.fit(ordered[rows], hangs[rows]).tree_
    nodes = [(0, {}, rows)]
    while nodes:
        node, limits, kept = nodes.pop()
        if tree.children_left[node] == tree.children_right[node]:
            found.append((limits, kept))
            continue
        column, values = int(tree.feature[node]), columns[kept, tree.feature[node]]
        is_low = ordered[kept, column] <= tree.threshold[node]
        threshold = float(values[is_low].max() + values[~is_low].min()) / 2.0
        low, high = limits.get(column, (-np.inf, np.inf))
        nodes.append((tree.children_right[node], limits | {column: (threshold, high)}, kept[~is_low]))
        nodes.append((tree.children_left[node], limits | {column: (low, threshold)}, kept[is_low]))
    return found


def _allotted(leaves: Sequence[_Leaf]) -> list[float]:
    """p′ of each region."""
    size = np.array([float(len(leaf.rows)) for leaf in leaves])
    by = np.sqrt([leaf.hanging * leaf.share for leaf in leaves] / size)
    return _shares(by, size, sum((leaf.tries for leaf in leaves), 0.0)).tolist()


def _shares(by: Float[np.ndarray, " c"], size: Float[np.ndarray, " c"], tries: float) -> Float[np.ndarray, " c"]:
    """Shares in proportion to `by` that use the given number of tries over all regions; none above the largest."""
    share, is_free = np.full(len(by), LARGEST_SHARE), np.ones(len(by), dtype=bool)
    while is_free.any():
        left = tries - float(size[~is_free] @ share[~is_free])
        free = left * by[is_free] / float(size[is_free] @ by[is_free])
        if (free <= LARGEST_SHARE).all():
            share[is_free] = np.maximum(free, 0.0)
            break
        over = np.flatnonzero(is_free)[free > LARGEST_SHARE]
        is_free[over] = False
    return share
