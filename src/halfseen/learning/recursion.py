"""Censored Q-learning, backwards over the stages (paper, eq. 3), for linear 𝒬.

    Q̂_{T+1} ≡ 0;  Q̂_t = argmin E_n[ (R_t + max_a' Q̂_{t+1}(S_{t+1}, a') − Q_t(S_t, A_t))² · δ_t / Ĝ(U_t⁻) ]

A linear Q is α_k + β_kᵀ φ(S, a) with k the block of the action, and each step adds the ridge of `regression`. It runs
on sums over rows, so a log in memory is one part, and one that does not fit there is many (`streaming`).

*Separate* stages: each stage has its own Q_t, fitted on its own rows and shrunk towards 0.

*Pooled* stages, for worlds whose dynamics do not depend on t: Q_h is indexed by the steps to go, h = 1..T, and fitted
on the rows of all stages; a row that the horizon ended says nothing of a longer future, so it serves Q_1 alone. One
more step to go changes little, so Q_h is shrunk towards Q_{h−1}. With λ = 0 nothing is shrunk, and eq. 3 is exact.

*Control variates* [Glasserman2003]_ are numbers that S_{t+1} tells and whose mean given (S_t, A_t) is 0.
Each regression runs on them too, and Q leaves them out: what they explain of the target is noise that Q is spared.

Where a policy is *given*, the maximum gives way to Σ_a π(a | S_{t+1}) Q̂_{t+1}(S_{t+1}, a): Q̂ is then that of the
policy (fitted Q evaluation), and nothing is chosen.

Where targets are *imputed*, the stage in which a path was right-censored has one, too; see `imputation`.

With pessimism V̂ is the largest lower confidence bound. Standard errors of Q take longest, and from one backward step to
the next their root R most often stays what it was, but for a factor. So ‖Rᵀ (1, φ)‖ is kept as `Norms` with the R that
it is of, and found anew where R is another.
"""

from collections.abc import Callable
from functools import reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from halfseen.errors import ArgumentError
from halfseen.learning.q_space import StageMode
from halfseen.learning.regression import (
    Bound,
    Crosses,
    Equations,
    Grams,
    Shape,
    Step,
    StepFit,
    Successor,
    crosses_of,
    fit_step,
    grams_of,
    plus,
)
from halfseen.learning.rows import (
    ENDED,
    FOLLOWING,
    GOING_ON,
    QFunctions,
    Rows,
    StateChoices,
    Transitions,
    rows_of,
    stack_q,
)


class Regression(NamedTuple):
    """How each step of eq. 3 is fitted."""

    block_of_action: Int[np.ndarray, " A"]
    """Which block of coefficients each action uses."""
    num_blocks: int
    """K."""
    regs: Float[np.ndarray, " L"]
    """The λ to choose from."""
    num_folds: int
    """V, folds of the cross-validation."""
    stages: StageMode
    end_action: int | None = None
    """For pooled stages: the action that the horizon forces upon a path, so that Q_0(S) = Q(S, end_action); every Q
    is shrunk towards it. It must end a path wherever it is taken, and a feature must mean the same in all blocks
    or be 0 for it. None if reaching the horizon costs nothing, Q_0 ≡ 0."""
    is_scaled: bool = True
    """Whether λ weighs features as if each had unit variance; False for features of a kernel."""
    pessimism: float = 0.0
    """Standard errors (`regression`) by which Q is lowered wherever the largest is sought; 0 for eq. 3 as it is."""

    @property
    def shape(self) -> Shape:
        """Of the sums."""
        return Shape(self.num_folds, self.num_blocks, self.pessimism > 0)


class Found(NamedTuple):
    """Sums of all parts for one step."""

    grams: tuple[Grams, ...]
    crosses: Crosses
    num_features: int
    """Of Q, the offset among them."""


Ask = Callable[[Step, tuple[tuple[int, ...], ...]], Found]
"""Sums what a step asks for, and what no target changes over the rows of some groups of slices."""


def fit_q(log: Transitions, regression: Regression) -> QFunctions:
    """Fit all Q-functions of a log in memory.

    Raises
    ------
    ArgumentError
        A path is in a fold that does not exist, and would count for nothing.
    """
    return backward(_InMemory(log, regression), log.action.shape, regression)


def fit_each_stage(log: Transitions, regression: Regression) -> QFunctions:
    """Fit Q of each stage to its rewards alone: nothing follows."""
    separate = regression._replace(stages="separate")
    steps = _Steps(_InMemory(log, separate), len(log.action), separate)
    return stack_q([steps.fit(Step((stage,), None, None)).q for stage in range(log.action.shape[1])])


def backward(ask: Ask, shape: tuple[int, int], regression: Regression) -> QFunctions:
    """Run eq. 3.

    Parameters
    ----------
    ask
        Sums.
    shape
        n and T.
    regression
        How each step is fitted.
    """
    num_paths, horizon = shape
    steps = _Steps(ask, num_paths, regression)
    fits = _separate(steps, horizon) if regression.stages == "separate" else _pooled(steps, horizon)
    return stack_q([fit.q for fit in fits])


class _InMemory:
    """A log in memory, whose sums are those of one part."""

    def __init__(self, log: Transitions, regression: Regression) -> None:
        largest = int(np.asarray(log.fold).max())
        if largest >= regression.num_folds:
            raise ArgumentError(
                f"fold {largest} of {regression.num_folds}: folds are 0 to {regression.num_folds - 1}; deal the paths "
                "anew"
            )
        self._rows = rows_of(log, regression)
        self._shape, self._is_pooled = regression.shape, regression.stages == "pooled"
        self._norms: Norms | None = None

    def __call__(self, step: Step, wanted: tuple[tuple[int, ...], ...]) -> Found:
        rows, shape = self._rows, self._shape
        # Pooled stages look at the same states in every step.
        values, self._norms = values_of(rows, step.successor, self._norms if self._is_pooled else None)
        grams = tuple(grams_of(rows, some, shape) for some in wanted)
        return Found(grams, crosses_of(rows, step, values, shape), int(rows.widths[0]))


class _Steps:
    """One backward step after the other."""

    def __init__(self, ask: Ask, num_paths: int, regression: Regression) -> None:
        self.regression, self._ask, self._num_paths = regression, ask, num_paths
        self._grams: dict[tuple[int, ...], Grams] = {}
        self._equations: dict[tuple[tuple[int, ...], ...], Equations] = {}

    def fit(self, step: Step) -> StepFit:
        """Fit one step."""
        parts = _summed_alone(step.slices)
        wanted = tuple(some for some in parts if some not in self._grams)
        found = self._ask(step, wanted)
        if self.regression.stages == "separate":
            self._grams, self._equations = {}, {}
        self._grams |= dict(zip(wanted, found.grams, strict=True))
        if parts not in self._equations:
            grams = reduce(plus, (self._grams[some] for some in parts))
            self._equations[parts] = Equations.of(grams, self.regression.is_scaled, found.num_features)
        return fit_step(self._equations[parts], found.crosses, step.centre, self.regression.regs, self._num_paths)

    def bound(self, fit: StepFit) -> Bound | None:
        """How far Q is lowered by its standard errors, if it is."""
        return None if fit.bound is None else fit.bound._replace(margin=self.regression.pessimism * fit.bound.margin)


def _summed_alone(slices: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """Pooled stages differ in what the horizon ended, which is asked of some steps alone."""
    return (GOING_ON, ENDED) if set(slices) == {*GOING_ON, *ENDED} else (slices,)


def _separate(steps: _Steps, horizon: int) -> list[StepFit]:
    """Each stage on its own rows, the last one first."""
    fits, successor = [], None
    for stage in reversed(range(horizon)):
        fit = steps.fit(Step((stage,), successor, None))
        fits.insert(0, fit)
        successor = Successor((stage,), fit.q.coefficients, steps.bound(fit))
    return fits


def _pooled(steps: _Steps, horizon: int) -> list[StepFit]:
    """All stages' rows at each number of steps to go: none, if the horizon forces an action upon a path, then one."""
    every, end_action = (*GOING_ON, *ENDED), steps.regression.end_action
    step = Step(every, None, None)
    if end_action is not None:
        ended = steps.fit(step)
        block = int(steps.regression.block_of_action[end_action])
        centre = np.broadcast_to(ended.coefficients[block], ended.coefficients.shape)
        step = Step(every, Successor(FOLLOWING, ended.q.coefficients, None, end_action), centre)
    fits = [steps.fit(step)]
    for _ in range(horizon - 1):
        before = fits[-1]
        successor = Successor(FOLLOWING, before.q.coefficients, steps.bound(before))
        fits.append(steps.fit(Step(GOING_ON, successor, before.coefficients)))
    return fits


ROWS_AT_ONCE = 2_048
"""Rows whose products stay in the cache of a core."""


class Norms(NamedTuple):
    """‖Rᵀ (1, φ)‖ of all that is possible, by block."""

    root: Float[np.ndarray, "K F F"]
    of_block: tuple[Float[np.ndarray, " _"], ...]


def values_of(
    rows: Rows, successor: Successor | None, known: Norms | None = None
) -> tuple[Float[np.ndarray, " R1"], Norms | None]:
    """V̂ of the state of every row that a step asks for, with a last one that is 0; and the norms, for the next step.

    Parameters
    ----------
    rows
        A part of the log.
    successor
        What V̂ is made of; None where it is 0.
    known
        Norms of an earlier step.
    """
    values = np.zeros(len(rows.weight) + 1)
    if successor is None:
        return values, known
    states = rows.span(successor.slices)
    matrices = _matrices(rows, states, len(successor.coefficients))
    q = [matrix @ of_block for matrix, of_block in zip(matrices, successor.coefficients, strict=True)]
    if successor.bound is not None and successor.forced is None and not _has_policy(rows):
        known = _norms(matrices, successor.bound.root, known)
        q = [each - by * norm for each, by, norm in zip(q, successor.bound.margin, known.of_block, strict=True)]
    if rows.choices is None:
        values[states] = _largest_of_shared(rows, states, np.stack(q, axis=1), successor.forced)
    else:
        values[:-1] = _largest_of_choices(rows.choices, len(values) - 1, np.concatenate(q), successor.forced)
    return values, known


def _has_policy(rows: Rows) -> bool:
    return rows.policy is not None or (rows.choices is not None and rows.choices.policy is not None)


def _matrices(rows: Rows, states: slice, num_blocks: int) -> list[Float[np.ndarray, "_ F"]]:
    """1 and φ of what is possible, for each block."""
    if rows.choices is None:
        return [rows.features[states]] * num_blocks
    begin = rows.choices.begin
    return [rows.choices.matrix[first:end] for first, end in pairwise(begin)]


def _norms(matrices: list[Float[np.ndarray, "_ F"]], root: Float[np.ndarray, "K F F"], known: Norms | None) -> Norms:
    found = []
    for block, (matrix, of_block) in enumerate(zip(matrices, root, strict=True)):
        if known is not None and np.array_equal(known.root[block], of_block):
            found.append(known.of_block[block])
            continue
        norm = np.empty(len(matrix))
        for first in range(0, len(matrix), ROWS_AT_ONCE):
            along = matrix[first : first + ROWS_AT_ONCE] @ of_block
            norm[first : first + ROWS_AT_ONCE] = np.sqrt(np.einsum("rf,rf->r", along, along))
        found.append(norm)
    return Norms(root, tuple(found))


def _largest_of_shared(
    rows: Rows, states: slice, q: Float[np.ndarray, "S K"], forced: int | None
) -> Float[np.ndarray, " S"]:
    of_action = q[:, rows.block_of_action] if forced is None else q[:, [rows.block_of_action[forced]]]
    if rows.policy is not None and forced is None:
        policy = rows.policy[states]
        return np.sum(np.where(policy > 0, policy * of_action, 0.0), axis=1)
    if rows.is_possible is None:
        return of_action.max(axis=1)
    possible = rows.is_possible[states] if forced is None else rows.is_possible[states, [forced]][:, None]
    return _or_nothing(np.where(possible, of_action, -np.inf).max(axis=1))


def _largest_of_choices(
    choices: StateChoices, num_rows: int, q: Float[np.ndarray, " C"], forced: int | None
) -> Float[np.ndarray, " R"]:
    if choices.policy is not None and forced is None:
        return np.bincount(choices.row, choices.policy * q, num_rows)
    largest = np.full(num_rows, -np.inf)
    is_asked = slice(None) if forced is None else choices.action == forced
    np.maximum.at(largest, choices.row[is_asked], q[is_asked])
    return _or_nothing(largest)


def _or_nothing(largest: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """0 where nothing is possible."""
    return np.where(np.isneginf(largest), 0.0, largest)
