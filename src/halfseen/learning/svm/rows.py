"""Rows of the estimators: their targets, their weights, and which are held out.

*Targets.* Y is a known function of the time. If it needs the time up to τ only, the event is that min(T, τ) was
observed, so a trajectory cut after τ counts fully (design, §2). Rows have weight w = δ / Ĝ(min(T, τ)⁻ | z).

*Held-out rows* choose λ and the kernel's width, and turn values f into probabilities [Platt1999]_.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import expit, logit

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.censoring import CensoringModel, censoring_weights, named_model, uses_covariates
from halfseen.censoring.clocks import clock_tolerance_s
from halfseen.censoring.inputs import checked_ends, checked_floats
from halfseen.errors import ArgumentError, PositivityError
from halfseen.learning.svm.losses import named_loss
from halfseen.learning.svm.newton import Features
from halfseen.learning.svm.solver import Problem, solve
from halfseen.shapes import Float, Int


class Ends(NamedTuple):
    """Observed ends of trajectories [s], and whether each trajectory finished; False if it was cut."""

    time: Rows
    is_finished: RowMask


def survival_array(time: ArrayLike, is_finished: ArrayLike) -> np.ndarray:
    """Times and whether they were observed as one structured array, which scikit-learn can split and shuffle.

    Parameters
    ----------
    time
        Observed end of each trajectory [s], shape (n,).
    is_finished
        False if the trajectory was cut, shape (n,).

    Returns
    -------
    ndarray
        Fields ``is_finished`` (bool) and ``time`` (float64), shape (n,), as in scikit-survival.
    """
    ends, finished = checked_ends(time, is_finished)
    array = np.empty(len(ends), dtype=[("is_finished", np.bool_), ("time", np.float64)])
    array["is_finished"], array["time"] = finished, ends
    return array


def as_ends(y: Any) -> Ends | None:
    """Read the ends of trajectories; None if `y` is a plain column of uncensored targets.

    Parameters
    ----------
    y
        A structured array with one boolean field and one of times, as in scikit-survival; a frame with the columns
        ``is_finished`` and ``time`` or ``time_s``; a tuple (time, is_finished); or one number (or label) per row.
    """
    if isinstance(y, tuple) and len(y) == 2 and np.ndim(y[0]) == 1:
        return Ends(*checked_ends(*y))
    if isinstance(y, pd.DataFrame) and len(y.columns) > 1:
        times = [name for name in ("time", "time_s") if name in y.columns]
        if len(times) != 1 or "is_finished" not in y.columns:
            raise ArgumentError(
                f"y has the columns {list(y.columns)}; give is_finished (False where cut) and one of time and time_s"
            )
        return Ends(*checked_ends(y[times[0]], y["is_finished"]))
    if isinstance(y, np.ndarray) and y.dtype.names:
        flags = [name for name in y.dtype.names if y.dtype[name] == np.bool_]
        times = [name for name in y.dtype.names if y.dtype[name].kind in "fiu"]
        if len(y.dtype.names) != 2 or len(flags) != 1 or len(times) != 1:
            raise ArgumentError(
                f"y has the fields {y.dtype}; give one boolean (True where the end was seen) and one of times"
            )
        return Ends(*checked_ends(y[times[0]], y[flags[0]]))
    return None


def target_values(time: Rows, target: str | Callable[[Rows], Any]) -> Rows:
    """Y(T)."""
    if callable(target):
        values = checked_floats(target(time), "target(time)")
        if values.shape != time.shape:
            raise ArgumentError(f"target(time) has {len(values)} rows for {len(time)} times; return one number a time")
    elif target == "identity":
        values = time
    elif target == "log":
        values = np.log(np.where(time > 0, time, np.nan))
    else:
        raise ArgumentError(f"target is {target!r}; give 'identity', 'log' or a function of the times")
    wrong = ~np.isfinite(values)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ArgumentError(
            f"y, row {row}: the target of {time[row]} is {values[row]}; give a target that is finite there, or "
            "fix the row"
        )
    return values


def row_weights(
    ends: Ends | None,
    rows: np.ndarray,
    counts: Rows,
    censoring: str | CensoringModel,
    tau: float | int | None,
    truncate_at: float | int | None,
) -> tuple[Rows, CensoringModel | None]:
    """Weight of each row, and the censoring model of the weights.

    Parameters
    ----------
    ends
        Times and whether they were observed; None if nothing can be cut.
    rows
        Covariates, for models that use them, shape (n, F), or sets.
    counts
        Number of rows that each row represents. Ĝ is fitted to rows of positive weight, each counted once.
    censoring
        Name of a model, a model to fit again, or ``"none"``: equal weights for observed rows.
    tau
        τ [s], if times are restricted.
    truncate_at
        Largest 1/Ĝ allowed, if any.
    """
    if ends is None:
        return counts, None
    time, is_seen = ends
    if tau is not None:
        time, is_seen = np.minimum(time, tau), is_seen | (time >= tau - clock_tolerance_s(time))
    counted = counts > 0
    if not is_seen[counted].any():
        raise PositivityError(
            f"all {len(rows)} trajectories were cut before their target was seen; record until some finish, or give a "
            "tau that some outlived"
        )
    if isinstance(censoring, str) and censoring == "none":
        return counts * is_seen, None
    model = named_model(censoring)
    covariates = rows if uses_covariates(model) else None
    if covariates is not None and covariates.dtype == object:
        raise ArgumentError("censoring uses covariates, and X holds sets; choose 'kaplan-meier'")
    model.fit(ends.time[counted], ends.is_finished[counted], None if covariates is None else covariates[counted])
    weights = censoring_weights(time, is_seen & counted, model, covariates=covariates, truncate_at=truncate_at)
    return counts * weights, model


Fold = tuple[Int[np.ndarray, " _"], Int[np.ndarray, " _"]]
"""Training rows, held-out rows."""

TOLERANCE = 1e-4
LEAST_OBJECTIVE = 1e-2
"""Relative duality gap of fits for comparison only, and the smallest objective for it, as a share of that of f = 0."""

TELLING = 30
HOPELESS = 1.2
"""Fewest held-out rows to judge a fold by, and the ratio to its smallest loss at which it stops."""


def folds_of_seen(cv: Any, seen: RowIds, num_rows: int, random_state: Any, classes: Rows | None = None) -> list[Fold]:
    """Training rows and held-out rows, as positions among the observed rows.

    Parameters
    ----------
    cv
        Number of folds of the observed rows; or a splitter or splits of all rows.
    seen
        Rows of positive weight.
    num_rows
        n.
    random_state
        Seed of the folds.
    classes
        Class ±1 of each observed row, to stratify the folds.
    """
    from sklearn.model_selection import KFold, StratifiedKFold, check_cv

    if not isinstance(cv, (int, np.integer)):
        splitter: Any = check_cv(cv)
        labels = None if classes is None else np.zeros(num_rows)
        if labels is not None:
            # A cut row belongs to neither class.
            labels[seen] = classes
        splits = [
            [np.flatnonzero(np.isin(seen, part)) for part in split]
            for split in splitter.split(np.zeros(num_rows), labels)
        ]
        for place, (fitted, _) in enumerate(splits):
            if len(fitted) == 0:
                raise ArgumentError(
                    f"cv: split {place} trains on no observed row; give each split rows that were not cut"
                )
        telling = [(fitted, held) for fitted, held in splits if len(held)]
        if not telling:
            raise ArgumentError("cv: no split holds out an observed row; hold out rows that were not cut")
        return telling
    if cv < 2:
        raise ArgumentError(f"cv is {cv}; cross-validation needs at least 2 folds")
    if len(seen) < 2:
        raise ArgumentError(
            f"cross-validation holds out rows, but {len(seen)} sample was observed (n_samples = {len(seen)}); "
            "give numbers for reg and gamma, or more rows"
        )
    seed = int(np.random.default_rng(random_state).integers(2**31))
    rarest = 0 if classes is None else int(np.unique(classes, return_counts=True)[1].min())
    deal, most = (StratifiedKFold, rarest) if rarest >= 2 else (KFold, len(seen))
    return list(deal(min(int(cv), most), shuffle=True, random_state=seed).split(seen, classes))


def hold_out(
    problem: Problem, regs: Float[np.ndarray, " L"], folds: list[Fold], bar: Any = None
) -> tuple[Float[np.ndarray, "L n"], Float[np.ndarray, " L"]]:
    """Fit without the rows of each fold, each λ warm-started from the one before.

    A fold of at least 30 rows stops when its loss is a fifth above its smallest so far: smaller λ fit ever closer, cost
    most, and are not chosen.

    Parameters
    ----------
    problem
        The problem on all observed rows; its λ is ignored.
    regs
        λ, largest first.
    folds
        Training rows and held-out rows.
    bar
        Progress bar, updated after every fold.

    Returns
    -------
    tuple
        Held-out values f of each row, NaN if no fold held it out; and their weighted mean loss, ∞ where a fold had
        stopped.
    """
    values, losses = np.full((len(regs), len(problem.y)), np.nan), np.zeros(len(regs))
    for fitted, held in folds:
        part, across = problem.part(fitted), problem.space.between(held, fitted)
        found, of_fold = None, np.full(len(regs), np.inf)
        for k, reg in enumerate(regs):
            found = solve(replace(part, reg=float(reg)), TOLERANCE, found, LEAST_OBJECTIVE)
            values[k, held] = across @ found.coefficients + found.offset
            of_fold[k] = problem.mass[held] @ problem.loss.value(problem.y[held], values[k, held])
            if len(held) >= TELLING and of_fold[k] > HOPELESS * of_fold.min():
                break
        losses += of_fold
        if bar is not None:
            bar.update()
    return values, losses / sum(problem.mass[held].sum() for _, held in folds)


@dataclass(frozen=True)
class Sigmoid:
    """P(second class | f) = 1 / (1 + exp(−(slope · f + offset)))."""

    slope: float
    offset: float

    def probability(self, f: Rows) -> Rows:
        """P(second class) at values of f."""
        return expit(self.slope * f + self.offset)


def fit_sigmoid(f: Rows, y: Rows, weight: Rows) -> Sigmoid:
    """Fit by weighted maximum likelihood with Platt's smoothed targets, y = ±1.

    Values f must be held out; NaN rows are ignored.
    """
    held = ~np.isnan(f)
    f, y, weight = f[held], y[held], weight[held] / weight[held].sum()
    spread = float(np.sqrt(weight @ np.square(f))) or 1.0
    # By the rule of succession, a row of class ±1 counts partly as the other class.
    sample_size, proportion_second = 1.0 / np.square(weight).sum(), weight[y > 0].sum()
    num_of = sample_size * np.where(y > 0, proportion_second, 1.0 - proportion_second)
    sure = (num_of + 1.0) / (num_of + 2.0)
    twice = Features(np.concatenate([f, f])[:, None] / spread)
    mass = np.concatenate([weight * sure, weight * (1.0 - sure)])
    found = solve(Problem(twice, np.concatenate([y, -y]), mass, named_loss("logistic"), 1e-6, True))
    slope = float(found.coefficients[0]) / spread
    # Held-out values that predict the wrong class carry no information but the class frequencies.
    return Sigmoid(slope, found.offset) if slope > 0.0 else Sigmoid(0.0, float(logit(proportion_second)))
