"""Choose λ and the kernel's width by the weighted loss on rows that were held out."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from halfseen.arrays import RowIds, Rows
from halfseen.learners.svm.designs import Design
from halfseen.learners.svm.losses import ProximalLoss, SmoothLoss
from halfseen.learners.svm.solver import Problem, Solution, solve

_TOLERANCE = 1e-4
_LEAST_OBJECTIVE = 1e-2
"""Relative duality gap of fits that are only compared, and the share of the loss of f = 0 that it is at least of."""

_TELLING = 30
_HOPELESS = 1.2
"""Held-out rows whose loss tells something, and the share of the least loss above which a fold gives up."""

Fold = tuple[Int[np.ndarray, "_"], Int[np.ndarray, "_"]]
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
    losses: Float[np.ndarray, "G L"]
    """Weighted mean loss of each width and λ, from the largest; ∞ where some fold gave up before."""


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
    """
    falling = np.sort(regs)[::-1]
    held_out = np.full((len(gammas), len(falling), len(task.y)), np.nan)
    is_tried = np.ones((len(gammas), len(falling)), dtype=bool)
    bar = tqdm(total=len(gammas) * len(folds), desc="cross-validation", unit="fold", delay=2, disable=None, leave=False)
    for g, gamma in enumerate(gammas):
        design = design_of(gamma)
        for fitted, held in _folds_of_seen(folds, seen):
            values = _held_out(task, design, (fitted, held), num_rows * len(fitted) / len(seen), falling)
            held_out[g][:, held] = values
            is_tried[g] &= ~np.isnan(values).any(axis=1)
            bar.update()
    bar.close()
    every = np.flatnonzero(~np.isnan(held_out[0, 0]))
    losses = np.full(is_tried.shape, np.inf)
    for g, k in np.argwhere(is_tried):
        losses[g, k] = _mean_loss(task, held_out[g, k, every], every)
    g, k = divmod(int(np.argmin(losses)), len(falling))
    return Choice(float(gammas[g]), float(falling[k]), held_out[g, k], losses)


def hold_out(task: Task, design: Design, reg: float, folds: Sequence[Fold], num_rows: float, seen: RowIds) -> Rows:
    """F of each row by a fit that did not see it, NaN where no fold held the row out."""
    return choose(task, lambda _: design, np.ones(1), np.array([reg]), folds, num_rows, seen).held_out


def _held_out(
    task: Task, design: Design, fold: Fold, num_rows: float, falling: Float[np.ndarray, " L"]
) -> Float[np.ndarray, "L h"]:
    """F of the rows held out, a row for each λ; NaN where the fold had given up."""
    fitted, held = fold
    values, least = np.full((len(falling), len(held)), np.nan), np.inf
    for k, solution in enumerate(_path(task, design, fitted, num_rows, falling)):
        values[k] = design.values(solution.coefficients, fitted, held) + solution.offset
        loss = _mean_loss(task, values[k], held)
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


def _folds_of_seen(folds: Sequence[Fold], seen: RowIds) -> Iterator[Fold]:
    """The folds, as positions among the rows that were seen."""
    for fitted, held in folds:
        yield np.flatnonzero(np.isin(seen, fitted)), np.flatnonzero(np.isin(seen, held))


def _mean_loss(task: Task, f: Float[np.ndarray, " h"], rows: Int[np.ndarray, " h"]) -> float:
    """Weighted mean loss of some rows, by their f."""
    return float(task.weight[rows] @ task.loss.value(task.y[rows], f) / task.weight[rows].sum())
