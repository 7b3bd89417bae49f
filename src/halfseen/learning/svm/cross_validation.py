"""Rows that are held out: they choose λ and the kernel's width, and turn values f into probabilities [Platt1999]_."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.special import expit, logit
from sklearn.model_selection import KFold, StratifiedKFold, check_cv

from halfseen.arrays import RowIds, Rows
from halfseen.errors import ArgumentError
from halfseen.learning.svm.losses import Logistic, ProximalLoss, SmoothLoss
from halfseen.learning.svm.solver import Problem, Solution, solve
from halfseen.learning.svm.spaces import Design, FeatureSpace
from halfseen.progress import Progress

Fold = tuple[Int[np.ndarray, " _"], Int[np.ndarray, " _"]]
"""Rows fitted to, rows held out."""


def dealt(cv: Any, seen: RowIds, num_rows: int, rng: np.random.Generator, classes: Rows | None = None) -> list[Fold]:
    """Rows fitted to and rows held out, among all rows.

    Parameters
    ----------
    cv
        A number of folds, into which the rows seen are dealt; or a splitter or splits of all rows.
    seen
        Rows of positive weight.
    num_rows
        n.
    rng
        Deals.
    classes
        Class of each row seen, so that each fold gets its share of both.

    Raises
    ------
    ArgumentError
        There are fewer than two folds or rows.
    """
    if not isinstance(cv, (int, np.integer)):
        splitter: Any = check_cv(cv)
        return list(splitter.split(np.zeros(num_rows)))
    if cv < 2:
        raise ArgumentError(f"cv is {cv}; cross-validation needs at least 2 folds")
    if len(seen) < 2:
        raise ArgumentError(
            f"rows are to be held out, and {len(seen)} sample was seen (n_samples = {len(seen)}); give numbers for reg "
            "and gamma, or more rows"
        )
    seed = int(rng.integers(2**31))
    rarest = 0 if classes is None else int(np.unique(classes, return_counts=True)[1].min())
    if rarest >= 2:
        splitter = StratifiedKFold(min(int(cv), rarest), shuffle=True, random_state=seed)
    else:
        splitter = KFold(min(int(cv), len(seen)), shuffle=True, random_state=seed)
    return [(seen[fitted], seen[held]) for fitted, held in splitter.split(seen, classes)]


_TOLERANCE = 1e-4
_LEAST_OBJECTIVE = 1e-2
"""Relative duality gap of fits that are only compared, and the share of the loss of f = 0 that it is at least of."""

_TELLING = 30
_HOPELESS = 1.2
"""Held-out rows whose loss tells something, and the share of the least loss above which a fold gives up."""


@dataclass(frozen=True)
class Task:
    """What is fitted, whatever the design and λ; row k of these is a row that was seen."""

    y: Rows
    weight: Rows
    """w > 0."""
    loss: SmoothLoss | ProximalLoss
    has_offset: bool

    def problem(self, design: Design, rows: RowIds, num_rows: float, reg: float) -> Problem:
        """The problem on some of the rows, as a share of `num_rows`, the unseen ones included."""
        return Problem(design.space(rows), self.y[rows], self.weight[rows] / num_rows, self.loss, reg, self.has_offset)


@dataclass(frozen=True)
class Choice:
    """What cross-validation chose."""

    gamma: float
    reg: float
    held_out: Rows
    """f of each row by fits that did not see it, NaN where no fold held the row out."""
    regs: Float[np.ndarray, " L"]
    """Every λ tried, from the largest."""
    losses: Float[np.ndarray, "G L"]
    """Weighted mean loss of each width and λ; ∞ where some fold gave up before."""


def choose(
    task: Task,
    design_of: Callable[[float], Design],
    gammas: Float[np.ndarray, " G"],
    regs: Float[np.ndarray, " L"],
    folds: Sequence[Fold],
    num_rows: float,
    seen: RowIds,
) -> Choice:
    """Try every width and every λ; the larger λ wins a tie.

    From the largest λ down, a fold of 30 rows or more gives up where its loss is a fifth above the least that it has
    seen: what comes then fits ever closer, costs most, and is not chosen.

    Parameters
    ----------
    task
        What is fitted to the rows that were seen.
    design_of
        Makes the design of a width; only one is held at a time.
    gammas, regs
        Candidates.
    folds
        Rows fitted to and held out, among all rows.
    num_rows
        n of the objective.
    seen
        Where the rows of `task` stand among all rows.

    Raises
    ------
    ArgumentError
        A split fits to no row that was seen, or none holds one out.
    """
    falling, splits = np.sort(regs)[::-1], _splits_of_seen(folds, seen)
    held_out = np.full((len(gammas), len(falling), len(task.y)), np.nan)
    lost = np.zeros((len(gammas), len(falling)))
    with Progress(len(gammas) * len(splits), "cross-validation", "folds") as bar:
        for g, gamma in enumerate(gammas):
            design = design_of(gamma)
            for fitted, held in splits:
                values = _held_out(task, design, (fitted, held), num_rows * len(fitted) / len(seen), falling)
                held_out[g][:, held] = values
                lost[g] += [_loss(task, f, held) for f in values]
                bar.update()
    losses = np.where(np.isnan(lost), np.inf, lost) / sum(task.weight[held].sum() for _, held in splits)
    g, k = divmod(int(np.argmin(losses)), len(falling))
    return Choice(float(gammas[g]), float(falling[k]), held_out[g, k], falling, losses)


def hold_out(task: Task, design: Design, reg: float, folds: Sequence[Fold], num_rows: float, seen: RowIds) -> Rows:
    """Values of f by fits that did not see the row, NaN where no fold held it out."""
    return choose(task, lambda _: design, np.ones(1), np.array([reg]), folds, num_rows, seen).held_out


def _held_out(
    task: Task, design: Design, fold: Fold, num_rows: float, falling: Float[np.ndarray, " L"]
) -> Float[np.ndarray, "L h"]:
    """Values of f at the rows held out, a row for each λ; NaN where the fold had given up."""
    fitted, held = fold
    values, least = np.full((len(falling), len(held)), np.nan), np.inf
    for k, solution in enumerate(_path(task, design, fitted, num_rows, falling)):
        values[k] = design.values(solution.coefficients, fitted, held) + solution.offset
        loss = _loss(task, values[k], held)
        least = min(least, loss)
        if len(held) >= _TELLING and loss > _HOPELESS * least:
            break
    return values


def _path(
    task: Task, design: Design, rows: RowIds, num_rows: float, falling: Float[np.ndarray, " L"]
) -> Iterator[Solution]:
    """Fits from the largest λ down, each from the one before."""
    solution = None
    whole = task.problem(design, rows, num_rows, falling[0])
    for reg in falling:
        problem = Problem(whole.space, whole.y, whole.mass, whole.loss, reg, whole.has_offset)
        solution = solve(problem, _TOLERANCE, solution, _LEAST_OBJECTIVE)
        yield solution


def _splits_of_seen(folds: Sequence[Fold], seen: RowIds) -> list[Fold]:
    """The folds, as positions among the rows that were seen; those that hold none of them out tell nothing."""
    splits = [(np.flatnonzero(np.isin(seen, fitted)), np.flatnonzero(np.isin(seen, held))) for fitted, held in folds]
    for place, (fitted, _) in enumerate(splits):
        if len(fitted) == 0:
            raise ArgumentError(
                f"cv: split {place} fits to no row that was seen; give each split rows that were not cut"
            )
    telling = [split for split in splits if len(split[1])]
    if not telling:
        raise ArgumentError("cv: no split holds out a row that was seen; hold out rows that were not cut")
    return telling


def _loss(task: Task, f: Float[np.ndarray, " h"], rows: Int[np.ndarray, " h"]) -> float:
    """Weighted loss of some rows, by their f; NaN where f is."""
    if np.isnan(f).any():
        return np.nan
    return float(task.weight[rows] @ task.loss.value(task.y[rows], f))


_REG = 1e-6


@dataclass(frozen=True)
class Sigmoid:
    """P(second class | f) = 1 / (1 + exp(−(slope · f + offset)))."""

    slope: float
    offset: float

    def probability(self, f: Rows) -> Rows:
        """P(second class) at values of f."""
        return expit(self.slope * f + self.offset)


def fit_sigmoid(f: Rows, y: Rows, weight: Rows) -> Sigmoid:
    """Fit by weighted maximum likelihood, with Platt's targets in place of certainty.

    Parameters
    ----------
    f
        Values by fits that did not see the row; NaN rows are left out.
    y
        ±1.
    weight
        w > 0.
    """
    held = ~np.isnan(f)
    f, y, weight = f[held], y[held], weight[held]
    spread = float(np.sqrt(weight @ np.square(f) / weight.sum())) or 1.0
    # A row of class ±1 counts as that class with the probability by the rule of succession, else as the other.
    sample_size = weight.sum() ** 2 / np.square(weight).sum()
    proportion_second = weight[y > 0].sum() / weight.sum()
    num_of = sample_size * np.where(y > 0, proportion_second, 1.0 - proportion_second)
    sure = (num_of + 1.0) / (num_of + 2.0)
    twice = np.concatenate([f, f])[:, None] / spread
    mass = np.concatenate([weight * sure, weight * (1.0 - sure)]) / weight.sum()
    problem = Problem(FeatureSpace(twice), np.concatenate([y, -y]), mass, Logistic(), _REG, True)
    solution = solve(problem)
    slope = float(solution.coefficients[0]) / spread
    # Held-out values that speak for the wrong class tell nothing but how common the classes are.
    return Sigmoid(slope, solution.offset) if slope > 0.0 else Sigmoid(0.0, float(logit(proportion_second)))
