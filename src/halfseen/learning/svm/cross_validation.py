"""Choose λ and the kernel's width by the weighted loss on rows that were held out."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from halfseen.arrays import RowIds, Rows
from halfseen.errors import ArgumentError
from halfseen.learning.svm.designs import Design
from halfseen.learning.svm.losses import ProximalLoss, SmoothLoss
from halfseen.learning.svm.solver import Problem, Solution, solve
from halfseen.progress import Progress

_TOLERANCE = 1e-4
_LEAST_OBJECTIVE = 1e-2
"""Relative duality gap of fits that are only compared, and the share of the loss of f = 0 that it is at least of."""

_TELLING = 30
_HOPELESS = 1.2
"""Held-out rows whose loss tells something, and the share of the least loss above which a fold gives up."""

Fold = tuple[Int[np.ndarray, " _"], Int[np.ndarray, " _"]]
"""Rows fitted to, rows held out."""


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
