"""Q for states given by name: a table of states by actions, with partially pooled cells.

A covariate of some hundred categories, such as the cluster of a patient or the cell of a map, is all that is known of a
state, and the similarity of states is not known. So each step of eq. 3 is a mean for each state s and action a,

    X = R + V̂(S′),   m_sa = Σ w X / Σ w   over the n_sa completed stages,

and most of these means have few stages, so their maximum is biased upwards. They are pooled as in a random-effects
model [GelmanHill2007]_ whose parameters are estimated by moments [DerSimonianLaird1986]_:

    Q(s, a) = μ_s + γ·(log n_sa − mean) + u_sa,   u_sa ~ N(0, σ_s²/κ),   m_sa | Q ~ N(Q(s, a), σ_s²/n_sa).

- *κ* is the weight of the mean of a state in stages: a cell of n stages keeps n/(n + κ) of its deviation. The variance
  of u is taken to be at least one standard error of its estimate. So a log that is too small to show whether actions
  differ still ranks them.
- *γ* ≥ 0 is the gain from following the log, whose policy may have had more information; otherwise it is 0.
- *μ_s* is shrunk towards the mean of all states, because a state may have been visited once.

An action that was never completed in a state is valued below all that were, so it is never taken there.

A stage has weight 1/K̂, with K̂ the probability that it is not cut while it lasts: in one state all trajectories have
the same future, so earlier cuts do not matter. Stages are pooled; a row that the horizon ended is used for Q_1 only
(`recursion`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.learning.covariates import MOST_CATEGORIES, is_numeric, kind_of
from halfseen.learning.named_task import NamedActions
from halfseen.learning.recursion import QFunctions
from halfseen.learning.rows import Transitions, stage_places
from halfseen.learning.task import Encoded
from halfseen.logs import Logs, LogStream
from halfseen.logs.missing import Filling
from halfseen.shapes import Float, Int

TRAJECTORIES_OF_STATE = 1.25
"""Fewest trajectories per state, on average."""
ROUNDING = 1e-9
STAGES_OF_VARIANCE = 20.0
"""Weight, in stages, of the variance of all states when pooled with that of one state."""


@dataclass(frozen=True)
class StateActions(NamedActions):
    """Named actions in a state given by one column (a `Task` of `TabularQ`)."""

    @property
    def num_states(self) -> int:
        """S."""
        return len(self.categories[self.covariates[0]])

    def fitted_to_parts(self, parts: Iterable[Logs], filling: Filling | None) -> "StateActions":
        """Learn the names of all states."""
        (column,) = self.covariates
        if column in self.categories:
            return replace(self, filling=filling)
        known = {name for part in parts for name in part.stages[column].dropna().map(str).unique()}
        return replace(self, categories={**self.categories, column: tuple(sorted(known))}, filling=filling)

    def encode(self, logs: Logs, horizon: int) -> Encoded:
        """Encode a state as its number, from 1; 0 where no stage began."""
        (column,), shape = self.covariates, (logs.num_trajectories, horizon)
        number, action = np.zeros(shape), np.zeros(shape, dtype=np.int64)
        at = stage_places(logs)
        is_possible = np.broadcast_to(self._possible_by_stage(horizon), (*shape, len(self.names)))
        number[at] = 1 + self.looks_at.codes(logs.stages, column)
        action[at] = self._codes(logs, is_possible)
        return Encoded(np.broadcast_to(number[..., None, None], (*is_possible.shape, 1)), is_possible, action)


def with_states(task: Any, logs: Any, targets: Any) -> StateActions:
    """Make a tabular task from a task of named actions."""
    if not isinstance(task, NamedActions) or len(task.covariates) != 1:
        raise ArgumentError(
            "q_function is 'tabular', which needs named actions and one covariate, the name of the state"
        )
    if isinstance(logs, LogStream):
        raise ArgumentError("q_function is 'tabular', which is learned in memory; leave --streaming out")
    if targets.is_imputed:
        raise ArgumentError(
            f"q_function is 'tabular', but censoring {targets.name!r} imputes; choose 'kaplan-meier', 'cox' or 'none'"
        )
    (column,) = task.covariates
    kind = kind_of(logs.stages, column) if isinstance(logs, Logs) and column in logs.stages.columns else None
    if kind is not None:
        raise ArgumentError(f"q_function is 'tabular', but {column} holds {kind}; give names or numbers")
    return StateActions(task.actions, task.covariates, task.categories, task.filling)


def is_state(logs: Any, covariates: Sequence[str]) -> bool:
    """Whether the only covariate of a log in memory is text of too many categories for indicators.

    Trajectories must share the categories, or the column identifies the trajectory.
    """
    if not isinstance(logs, Logs) or len(covariates) != 1 or covariates[0] not in logs.stages.columns:
        return False
    (column,) = covariates
    if is_numeric(logs.stages, column) or kind_of(logs.stages, column) is not None:
        return False
    num_names = logs.stages[column].nunique()
    come_to: Any = logs.stages[["trajectory", column]].drop_duplicates()
    return num_names > MOST_CATEGORIES and len(come_to) >= TRAJECTORIES_OF_STATE * num_names


def fit_table(log: Transitions, num_states: int, reg: float | None = None) -> QFunctions:
    """Run eq. 3 on a table.

    Parameters
    ----------
    log
        Log with one feature, the number of the state, from 1.
    num_states
        S.
    reg
        κ; with 0 every cell is its own mean. None to estimate κ and γ from the log, and to shrink the means of states.

    Returns
    -------
    QFunctions
        By steps to go, one first; coefficients are Q of the first state and the differences of the others from it.
    """
    rows, horizon = _rows_of(log), log.action.shape[1]
    if not len(rows.cell):
        raise ArgumentError("no stage was completed whose next state is known; record more trajectories")
    shape = (num_states, log.is_possible.shape[-1])
    every, going = _Cells(rows, shape), _Cells(rows.at(~rows.is_at_horizon), shape)
    value, each = np.zeros(num_states), []
    for to_go in range(horizon):
        each.append((going if to_go and len(going.id) else every).table(value, reg))
        value = each[-1][0].max(axis=1)
    tables, kappas = zip(*each, strict=True)
    q = np.stack(tables).swapaxes(-1, -2)
    q[..., 1:] -= q[..., :1]
    return QFunctions(q, np.repeat(np.array(kappas)[:, None], shape[1], axis=1))


class _Rows(NamedTuple):
    """Completed stages whose successor is known."""

    cell: Int[np.ndarray, " m"]
    """s·A + a."""
    successor: Int[np.ndarray, " m"]
    """Next state, from 1; 0 after the trajectory finished."""
    reward: Float[np.ndarray, " m"]
    weight: Float[np.ndarray, " m"]
    is_at_horizon: np.ndarray

    def at(self, rows: np.ndarray) -> "_Rows":
        return _Rows(*(column[rows] for column in self))


def _rows_of(log: Transitions) -> _Rows:
    number = log.features[:, :, 0, 0].astype(np.int64)
    successor = np.where(log.is_last, 0, np.pad(number[:, 1:], ((0, 0), (0, 1))))
    before = np.pad(log.weight[:, :-1], ((0, 0), (1, 0)), constant_values=1.0)
    done = (log.weight > 0) & (number > 0) & (log.is_last | (successor > 0))
    own = log.weight / np.where(before > 0, before, 1.0)
    stage = np.broadcast_to(np.arange(number.shape[1]), number.shape)
    cell = (number - 1) * log.is_possible.shape[-1] + log.action
    return _Rows(cell[done], successor[done], log.reward[done], own[done], stage[done] == number.shape[1] - 1)


class _Cells:
    """Rows by cell, and quantities that do not change between steps."""

    def __init__(self, rows: _Rows, shape: tuple[int, int]) -> None:
        self.id, self.of_row = np.unique(rows.cell, return_inverse=True)
        self.rows, self.shape, self.state = rows, shape, self.id // shape[1]
        self.weight = self._sum(rows.weight)
        self.n = self.weight**2 / self._sum(rows.weight**2)
        self.n_of_state = np.bincount(self.state, self.n, shape[0])
        self.is_seen = self.n_of_state > 0
        # Share of a cell's own variance that remains after subtracting the mean of its state.
        self.rest = 1.0 - self.n / self.n_of_state[self.state]
        self.freedom = np.bincount(self.state, self.n - 1.0, shape[0])

    def table(self, value: Float[np.ndarray, " S"], reg: float | None) -> tuple[Float[np.ndarray, "S A"], float]:
        """Q of each state and action, given V̂ of the successors; and κ."""
        target = self.rows.reward + np.append(0.0, value)[self.rows.successor]
        mean = self._sum(self.rows.weight * target) / self.weight
        squares = self._sum(self.rows.weight * (target - mean[self.of_row]) ** 2) / self.weight * self.n
        of_state = self._within_states(mean, self.n)
        if reg is not None:
            apart = mean - of_state[self.state]
            return self._filled(of_state[self.state] + apart * self.n / (self.n + reg), 0.0, of_state), reg
        # Without variance within cells, even the smallest difference is certain.
        variance = np.maximum(self._variance(squares), ROUNDING**2 * (target**2).mean() or 1.0)
        noise = variance[self.state]
        liking = self._liking(mean - of_state[self.state], self.n / noise)
        apart = mean - of_state[self.state] - liking
        kappa = self._kappa(apart**2 * self.n / noise)
        of_state = self._shrunk(of_state, variance)
        q = of_state[self.state] + liking + apart * self.n / (self.n + kappa)
        return self._filled(q, float(np.sqrt(noise.mean() / max(kappa, 1.0))), of_state), kappa

    def _variance(self, squares: Float[np.ndarray, " c"]) -> Float[np.ndarray, " S"]:
        """σ_s² of X within the cells of each state, shrunk towards that of all states."""
        pooled = squares.sum() / max(self.freedom.sum(), 1.0)
        own = np.bincount(self.state, squares, self.shape[0])
        return (own + STAGES_OF_VARIANCE * pooled) / (self.freedom + STAGES_OF_VARIANCE)

    def _liking(self, apart: Float[np.ndarray, " c"], weight: Float[np.ndarray, " c"]) -> Float[np.ndarray, " c"]:
        """γ·(log n − mean), by weighted least squares within states."""
        log_n = np.log(self.n)
        log_n = log_n - self._within_states(log_n, self.n)[self.state]
        spread = float((weight * log_n**2).sum())
        return log_n * max(float((weight * log_n * apart).sum()) / spread, 0.0) if spread > 0 else 0.0 * log_n

    def _kappa(self, squares: Float[np.ndarray, " c"]) -> float:
        """κ by moments: Σ n (m − μ)²/σ² has the expectation Σ rest + Σ n·rest/κ."""
        by_chance = float(self.rest.sum())
        excess = max(float(squares.sum()) - by_chance, float(np.sqrt(2.0 * by_chance)))
        return float((self.n * self.rest).sum()) / excess if excess > 0 else 0.0

    def _shrunk(self, mean: Float[np.ndarray, " S"], variance: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
        """Means of states, shrunk towards the mean of all if they have few stages; unseen states have that mean."""
        among, noise = mean[self.is_seen], variance[self.is_seen] / self.n_of_state[self.is_seen]
        spread = max(float(among.var() - noise.mean()), 0.0)
        shrunk = np.full(len(mean), among.mean())
        shrunk[self.is_seen] += (among - among.mean()) * spread / (spread + noise)
        return shrunk

    def _filled(
        self, q: Float[np.ndarray, " c"], below: float, of_state: Float[np.ndarray, " S"]
    ) -> Float[np.ndarray, "S A"]:
        """Arrange cells as a table; unseen cells lie below the smallest of their state."""
        least = np.where(self.is_seen, np.inf, of_state)
        np.minimum.at(least, self.state, q)
        other = np.where(self.is_seen, least - below - ROUNDING * (1.0 + np.abs(least)), of_state)
        table = np.repeat(other, self.shape[1])
        table[self.id] = q
        return table.reshape(self.shape)

    def _sum(self, of_row: Float[np.ndarray, " m"]) -> Float[np.ndarray, " c"]:
        # Without rows it would be of whole numbers.
        return np.bincount(self.of_row, of_row, len(self.id)).astype(np.float64)

    def _within_states(self, each: Float[np.ndarray, " c"], weight: Float[np.ndarray, " c"]) -> Float[np.ndarray, " S"]:
        """Weighted mean over the cells of each state; the mean of all for an unseen state."""
        total = np.bincount(self.state, weight * each, self.shape[0])
        return np.where(self.is_seen, total / np.where(self.is_seen, self.n_of_state, 1.0), float(np.average(each)))
