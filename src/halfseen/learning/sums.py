"""The rows of eq. 3, packed, and what a backward step sums over them; the sums of the parts of a log add up.

A group is the rows of one *slice*, fold and block, completed or cut; groups are contiguous. So a sum over a group is a
product of two narrow matrices without masks. For separate stages the slices are the stages. For pooled stages they are
the rows that inform more than one step to go (`GOING_ON`) and the rows that the horizon ended (`ENDED`).

An imputed target Y (`rows.Imputation`) is linear in the coefficients of the regression of X, which are known only once
all parts have been read. So Σ w x Y is stored as one sum for the share of X and one for each coefficient. A target that
is not imputed is the case share = 1, without terms.

V̂ of the states that a backward step uses is the largest Q, or the largest lower confidence bound of Q.

Standard errors of Q take longest to compute, and their root R usually changes only by a factor from one backward step
to the next. So ‖Rᵀ (1, φ)‖ is kept as `Norms` with its R, and computed again only if R has changed otherwise.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from halfseen.learning.q_space import StageMode
from halfseen.learning.ridge import Errors
from halfseen.learning.rows import Transitions
from halfseen.shapes import Bool, Float, Int

GOING_ON, ENDED = 0, 1
WHOLE, SHARE, OUTCOME, SEEN = range(4)
"""Weights of rows: w; w·share; in the regression of X; and of completed stages, for standard errors."""


class Regression(NamedTuple):
    """How each step of eq. 3 is fitted."""

    block_of_action: Int[np.ndarray, " A"]
    """Block of coefficients of each action."""
    num_blocks: int
    """K."""
    regs: Float[np.ndarray, " L"]
    """The λ to choose from, increasing."""
    num_folds: int
    """V, folds of the cross-validation."""
    stages: StageMode
    end_action: int | None = None
    """For pooled stages: the action that the horizon forces, so that Q_0(S) = Q(S, end_action); every Q is shrunk
    towards it. It must end a trajectory wherever it is taken, and each feature must mean the same in all blocks or be 0
    for it. None if reaching the horizon costs nothing, Q_0 ≡ 0."""
    is_scaled: bool = True
    """Whether λ penalises features as if each had unit variance; False for features of a kernel."""
    pessimism: float = 0.0
    """Standard errors (`ridge`) by which Q is lowered wherever a maximum is taken; 0 for eq. 3 unchanged."""
    is_partially_pooled: bool = False
    """Whether the Q of each block is shrunk, with its intercept, towards a fit common to all blocks."""


class Columns(NamedTuple):
    """Columns of the matrix of rows: 1 and φ(S_t, A_t), control variates, terms, and expected terms."""

    num_features: int
    """Of Q, including the intercept."""
    num_variates: int
    num_terms: int
    is_used: Float[np.ndarray, " F"] | None
    """1 for each feature that the regression of X uses; None if targets are not imputed."""

    @property
    def num_design(self) -> int:
        """Features and control variates."""
        return self.num_features + self.num_variates


class StateChoices(NamedTuple):
    """Possible actions of the states, sorted by block, if each action has its own features."""

    matrix: Float[np.ndarray, "C F"]
    """1, φ(S, a)."""
    begin: Int[np.ndarray, " K1"]
    """Start of the choices of each block, and the end of the last."""
    row: Int[np.ndarray, " C"]
    """That of S."""
    action: Int[np.ndarray, " C"]
    policy: Float[np.ndarray, " C"] | None
    """π(a | S), if Q of a given policy is estimated."""


class Rows(NamedTuple):
    """Rows of whole trajectories of a log."""

    matrix: Float[np.ndarray, "R M"]
    columns: Columns
    reward: Float[np.ndarray, " R"]
    weights: Float[np.ndarray, "4 R"]
    """0 for a state that is only a successor."""
    after: Int[np.ndarray, " R"]
    """Row of S_{t+1}; R if there is none."""
    groups: Int[np.ndarray, "N 5"]
    """Slice, fold, block, start and end of each group."""
    is_possible: Bool[np.ndarray, "R A"]
    block_of_action: Int[np.ndarray, " A"]
    choices: StateChoices | None
    """None if all actions of a state have the same features."""
    policy: Float[np.ndarray, "R A"] | None
    """π(a | S_t), if Q of a given policy is estimated."""

    def groups_of(self, slices: tuple[int, ...]) -> Int[np.ndarray, "N1 5"]:
        """Groups of contiguous slices."""
        first, last = np.searchsorted(self.groups[:, 0], [slices[0], slices[-1] + 1])
        return self.groups[first:last]

    def span(self, slices: tuple[int, ...]) -> slice:
        """Rows of contiguous slices."""
        groups = self.groups_of(slices)
        return slice(int(groups[0, 3]), int(groups[-1, 4])) if len(groups) else slice(0, 0)


def packed(log: Transitions, regression: Regression) -> Rows:
    """Pack a log, or a part of it in the same layout."""
    blocks, end_action = regression.block_of_action, regression.end_action
    weight, given, num_stages = log.weight, log.imputation, log.weight.shape[1]
    goes_on = (weight > 0) & ~log.is_last & (np.arange(num_stages) < num_stages - 1)
    if given is not None:
        # A cut stage has no observed successor.
        goes_on &= given.share != 0
    is_state = np.zeros_like(goes_on)
    is_state[:, 1:] = goes_on[:, :-1]
    trajectory, stage = np.nonzero((weight > 0) | is_state)
    action, slices = log.action[trajectory, stage], stage
    if regression.stages == "pooled":
        is_ended = (stage == num_stages - 1) & (end_action is None or action != end_action)
        slices = np.where(is_ended, ENDED, GOING_ON)
    is_cut = (
        np.zeros(len(trajectory), dtype=np.int64) if given is None else given.outcome_weight[trajectory, stage] == 0
    )
    keys = np.stack([slices, log.fold[trajectory], blocks[action], is_cut])
    order = np.lexsort(keys[::-1])
    at = trajectory[order], stage[order]
    row_of = np.full(weight.shape, len(order))
    row_of[at] = np.arange(len(order))
    after = np.full(weight.shape, len(order))
    after[:, :-1] = np.where(goes_on[:, :-1], row_of[:, 1:], len(order))
    matrix, columns = _matrix(log, at)
    is_shared = log.features.shape[2] == 1
    return Rows(
        matrix=matrix,
        columns=columns,
        reward=log.reward[at],
        weights=_weights(log, at),
        after=after[at].astype(np.int32),
        groups=_groups(keys[:, order].T),
        is_possible=log.is_possible[at],
        block_of_action=blocks,
        choices=None if is_shared else _choices(log, at, is_state[at], regression),
        policy=None if log.policy is None else log.policy[at],
    )


def _groups(keys: Int[np.ndarray, "R 4"]) -> Int[np.ndarray, "N 5"]:
    begin = np.flatnonzero(np.any(np.diff(keys, axis=0, prepend=-1), axis=1))
    return np.column_stack([keys[begin, :3], begin, np.append(begin[1:], len(keys))])


def _weights(log: Transitions, at: tuple[np.ndarray, np.ndarray]) -> Float[np.ndarray, "4 R"]:
    weight, given = log.weight[at], log.imputation
    if given is None:
        return np.stack([weight, weight, np.zeros_like(weight), weight])
    of_outcome = given.outcome_weight[at]
    return np.stack([weight, weight * given.share[at], np.where(weight > 0, of_outcome, 0.0), weight * of_outcome])


def _matrix(log: Transitions, at: tuple[np.ndarray, np.ndarray]) -> tuple[Float[np.ndarray, "R M"], Columns]:
    taken = 0 if log.features.shape[2] == 1 else log.action[at]
    given, num_rows = log.imputation, len(at[0])
    variates = terms = expected = np.zeros((num_rows, 0))
    if log.control_variates is not None:
        # Values at the end of a trajectory are unknown and ignored; imputed targets use a share of each.
        variates = np.where(log.is_last[at][:, None], 0.0, log.control_variates[at])
        variates = variates if given is None else variates * given.share[at][:, None]
    if given is not None:
        terms, expected = given.terms[at], given.expected[at]
    features = log.features[(*at, taken)]
    is_used = None if given is None else np.append(1.0, given.is_used)
    columns = Columns(1 + features.shape[1], variates.shape[1], terms.shape[1], is_used)
    return np.column_stack([np.ones(num_rows), features, variates, terms, expected]), columns


def _choices(
    log: Transitions, at: tuple[np.ndarray, np.ndarray], is_state: Bool[np.ndarray, " R"], regression: Regression
) -> StateChoices:
    blocks = regression.block_of_action
    is_choice = log.is_possible[at] if log.policy is None else log.policy[at] > 0
    row, action = np.nonzero(is_choice & is_state[:, None])
    by_block = np.argsort(blocks[action], kind="stable")
    row, action = row[by_block], action[by_block]
    number = np.ravel_multi_index((at[0][row], at[1][row], action), log.is_possible.shape)
    matrix = np.ones((len(row), 1 + log.features.shape[-1]))
    matrix[:, 1:] = log.features.reshape(-1, log.features.shape[-1])[number]
    begin = np.searchsorted(blocks[action], np.arange(regression.num_blocks + 1))
    policy = None if log.policy is None else log.policy.ravel()[number]
    return StateChoices(matrix, begin, row.astype(np.int32), action.astype(np.int32), policy)


class Moments(NamedTuple):
    """Sums over a slice that do not depend on the targets."""

    of_matrix: Float[np.ndarray, "4 V K M M"]
    """Σ w z zᵀ of the rows z of the matrix, for each of their weights."""
    counts: Float[np.ndarray, "3 K"]
    """Of completed stages: Σw; Σw²; and the number with positive weight."""


class Crosses(NamedTuple):
    """Sums over the rows of a step that depend on the targets X."""

    of_matrix: Float[np.ndarray, "3 V K M"]
    """Σ w z X for the weights `SHARE`, `OUTCOME` and `SEEN`."""
    squares: Float[np.ndarray, " K"]
    """Σ w X² of completed stages."""


def moments_of(rows: Rows, which: int, regression: Regression) -> Moments:
    """Sum the rows of a slice, for sums that do not depend on the targets."""
    width, num_folds, num_blocks = rows.matrix.shape[1], regression.num_folds, regression.num_blocks
    found = Moments(np.zeros((4, num_folds, num_blocks, width, width)), np.zeros((3, num_blocks)))
    for _, fold, block, begin, end in rows.groups_of((which,)).tolist():
        weights = rows.weights[:, begin:end]
        _add_moments(found.of_matrix[:, fold, block], rows.matrix[begin:end], weights)
        seen = weights[SEEN]
        found.counts[:, block] += seen.sum(), seen @ seen, np.count_nonzero(seen)
    return found


def _add_moments(
    sums: Float[np.ndarray, "4 M M"], matrix: Float[np.ndarray, "r M"], weights: Float[np.ndarray, "4 r"]
) -> None:
    """Sum equal weights once, and skip zero weights."""
    left = [number for number, weight in enumerate(weights) if weight.any()]
    while left:
        weight = weights[left[0]]
        same = [number for number in left if (weights[number] == weight).all()]
        sums[same] += matrix.T @ (matrix if (weight == 1.0).all() else matrix * weight[:, None])
        left = [number for number in left if number not in same]


def crosses_of(
    rows: Rows, slices: tuple[int, ...], values: Float[np.ndarray, " R1"], regression: Regression
) -> Crosses:
    """Sum the rows of some slices with their targets; `values` holds V̂ of the state of each row, and a last 0."""
    span = rows.span(slices)
    target = rows.reward[span] + values[rows.after[span]]
    weighted = (rows.weights[SHARE:, span] * target).T.copy()
    sums = np.zeros((regression.num_folds, regression.num_blocks, rows.matrix.shape[1], 3))
    squares = np.zeros(regression.num_blocks)
    for _, fold, block, begin, end in rows.groups_of(slices).tolist():
        here = slice(begin - span.start, end - span.start)
        sums[fold, block] += rows.matrix[begin:end].T @ weighted[here]
        squares[block] += weighted[here, -1] @ target[here]
    return Crosses(np.moveaxis(sums, -1, 0), squares)


ROWS_AT_ONCE = 2_048
"""Rows whose products fit in the cache of a core."""


class Successor(NamedTuple):
    """The components of V̂(S_{t+1})."""

    slices: tuple[int, ...]
    """The slices that hold S_{t+1}."""
    coefficients: Float[np.ndarray, "K F"]
    errors: Errors | None
    """Errors by which pessimism lowers Q."""
    forced: int | None = None
    """The action that the horizon forces on a trajectory, whatever Q is."""


class Norms(NamedTuple):
    """‖Rᵀ (1, φ)‖ of all possible actions, by block."""

    root: Float[np.ndarray, "K F F"]
    of_block: tuple[Float[np.ndarray, " _"], ...]


def values_of(
    rows: Rows, successor: Successor | None, known: Norms | None
) -> tuple[Float[np.ndarray, " R1"], Norms | None]:
    """V̂ of the state of every row that a step uses, with a last 0; and the norms, for the next step."""
    values = np.zeros(len(rows.reward) + 1)
    if successor is None:
        return values, known
    choices, states, forced = rows.choices, rows.span(successor.slices), successor.forced
    num_features = successor.coefficients.shape[1]
    matrices = [rows.matrix[states, :num_features]] * len(successor.coefficients)
    if choices is not None:
        matrices = [choices.matrix[first:end] for first, end in pairwise(choices.begin)]
    q = [matrix @ of_block for matrix, of_block in zip(matrices, successor.coefficients, strict=True)]
    if successor.errors is not None and rows.policy is None:
        known = _norms(matrices, successor.errors.root, known)
        q = [each - by * norm for each, by, norm in zip(q, successor.errors.deviation, known.of_block, strict=True)]
    if choices is None:
        values[states] = _best_of_shared(rows, states, np.stack(q, axis=1), forced)
    else:
        values[:-1] = _best_of_choices(choices, len(values) - 1, np.concatenate(q), forced)
    return values, known


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


def _best_of_shared(
    rows: Rows, states: slice, q: Float[np.ndarray, "S K"], forced: int | None
) -> Float[np.ndarray, " S"]:
    of_action, possible = q[:, rows.block_of_action], rows.is_possible[states]
    if forced is not None:
        return np.where(possible[:, forced], of_action[:, forced], 0.0)
    if rows.policy is not None:
        policy = rows.policy[states]
        return np.sum(np.where(policy > 0, policy * of_action, 0.0), axis=1)
    return or_nothing(np.where(possible, of_action, -np.inf).max(axis=1))


def _best_of_choices(
    choices: StateChoices, num_rows: int, q: Float[np.ndarray, " C"], forced: int | None
) -> Float[np.ndarray, " R"]:
    if choices.policy is not None and forced is None:
        return np.bincount(choices.row, choices.policy * q, num_rows)
    largest = np.full(num_rows, -np.inf)
    is_asked = slice(None) if forced is None else choices.action == forced
    np.maximum.at(largest, choices.row[is_asked], q[is_asked])
    return or_nothing(largest)


def or_nothing(largest: Float[np.ndarray, "*S"]) -> Float[np.ndarray, "*S"]:
    """0 where no action is possible."""
    return np.where(np.isneginf(largest), 0.0, largest)
