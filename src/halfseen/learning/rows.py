"""From a log to the rows of eq. 3: dense arrays of paths → transitions → packed rows, which a backward step sums over.

`PathArrays` hold a log as it is, one row a path, padded to T stages. `Transitions` add what each stage weighs and what
its target is. `Rows` pack these in groups that lie one after another, as plain arrays that a disk can keep.

A group is the rows of one *slice*, fold and block, completed or cut. So a sum over a group is a product of two narrow
matrices without masks, and what a backward step looks at are whole slices. Slices of separate stages are the stages.
Those of pooled stages are told apart by whether a row speaks of more than one step to go, and whether it follows
another one, so that V̂ is sought in its state: `LATER` and `LATER_ENDED` do, `FIRST` and `FIRST_ENDED` do not.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import library_of
from halfseen.censoring import StageClocks
from halfseen.lazy import Frame
from halfseen.learning.task import Encoded

if TYPE_CHECKING:
    from halfseen.learning.recursion import Regression
    from halfseen.logs import Logs
else:
    Logs = Any  # What a policy needs of this module loads no log.


class PathArrays(NamedTuple):
    """Paths and their stages; what a path has no stage for holds 0, False or NaN."""

    clocks: StageClocks
    """When each stage began and ended, who was cut, and what cuts may depend on."""
    encoded: Encoded
    has_action: Bool[np.ndarray, "n T"]
    """Stages whose action is known; that of the stage in which a path was cut need not be."""
    probability: Float[np.ndarray, "n T"]
    """Of the logged action under the logging policy; NaN where it was not logged."""
    reward: Float[np.ndarray, "n T"]
    """0 where not completed."""

    @property
    def num_paths(self) -> int:
        """Number n of paths."""
        return self.clocks.num_paths

    @property
    def path_ids(self) -> np.ndarray:
        """Names of the paths."""
        return self.clocks.path_ids

    @property
    def features(self) -> Float[np.ndarray, "n T A F"]:
        """φ(S_t, a)."""
        return self.encoded.features

    @property
    def is_possible(self) -> Bool[np.ndarray, "n T A"]:
        """Which actions each state allows."""
        return self.encoded.is_possible

    @property
    def action(self) -> Int[np.ndarray, "n T"]:
        """A_t."""
        return self.encoded.action

    @property
    def is_begun(self) -> Bool[np.ndarray, "n T"]:
        """Stages whose S_t was seen."""
        return self.clocks.is_begun

    @property
    def is_completed(self) -> Bool[np.ndarray, "n T"]:
        """δ_t."""
        return self.clocks.is_completed

    @property
    def is_last(self) -> Bool[np.ndarray, "n T"]:
        """Completed stages after which a path had come to its own end."""
        return self.clocks.is_last

    def take(self, rows: Int[np.ndarray, " k"] | slice) -> "PathArrays":
        """Keep these paths, which may repeat, in this order; a slice of them copies nothing."""
        leaves: list[Any] = [None if leaf is None else leaf[rows] for leaf in self.encoded]
        encoded = Encoded(*leaves)
        return PathArrays(self.clocks.take(rows), encoded, *(leaf[rows] for leaf in self[2:]))


def path_arrays(logs: Logs, encoded: Encoded, covariates: Frame | None) -> PathArrays:
    """Lay out a log.

    Parameters
    ----------
    logs
        The log.
    encoded
        Its features and actions, padded to T.
    covariates
        What cuts may depend on, a row for each stage of the log; None for nothing.
    """
    horizon = encoded.action.shape[1]
    at = stage_places(logs)

    def spread(values: np.ndarray, empty: float | bool) -> np.ndarray:
        filled = np.full((logs.num_paths, horizon, *values.shape[1:]), empty, dtype=values.dtype)
        filled[at] = values
        return filled

    def numbers(column: str) -> Float[np.ndarray, " rows"]:
        if column not in logs.stages.columns:
            return np.full(logs.num_stages, np.nan)
        return logs.stages[column].to_numpy(dtype=np.float64, na_value=np.nan)

    known = np.zeros((logs.num_stages, 0)) if covariates is None else covariates.to_numpy(dtype=np.float64)
    clocks = StageClocks(
        path_ids=logs.path_ids,
        elapsed_s=spread(numbers("elapsed_s"), np.nan),
        end_s=logs.end_s,
        is_finished=logs.is_finished,
        is_begun=spread(np.ones(logs.num_stages, dtype=bool), False),
        covariates=spread(known, 0.0),
        covariate_names=() if covariates is None else tuple(map(str, covariates.columns)),
    )
    return PathArrays(
        clocks=clocks,
        encoded=encoded,
        has_action=spread(logs.stages["action"].notna().to_numpy(), False),
        probability=spread(numbers("probability"), np.nan),
        reward=np.nan_to_num(spread(numbers("reward"), 0.0)),
    )


def stage_places(logs: Logs) -> tuple[Int[np.ndarray, " rows"], Int[np.ndarray, " rows"]]:
    """Row of each stage's path in dense arrays, and its column."""
    import pandas as pd

    return pd.Index(logs.path_ids).get_indexer(logs.stages["path"]), logs.stages["stage"].to_numpy() - 1


class Imputation(NamedTuple):
    """How a begun stage gets a target Y whether or not its end was seen (see the module `imputation`).

    With X = R_t + V̂(S_{t+1}) and its regression α + βᵀφ + γᵀg on the completed stages, g terms of the duration,

        Y = share·X + (1 − share)·(α + βᵀφ) + γᵀexpected.
    """

    share: Float[np.ndarray, "n T"]
    """Of X; 0 where the stage was not completed."""
    terms: Float[np.ndarray, "n T G"]
    """g of each completed stage."""
    expected: Float[np.ndarray, "n T G"]
    """What stands for g·(1 − share)."""
    outcome_weight: Float[np.ndarray, "n T"]
    """Weight of each stage in the regression of X: 0 where cut; where completed δ/K̂, truncated, or 1 without K̂."""
    is_used: Float[np.ndarray, " F"]
    """1 for each feature that this regression looks at, 0 for the others."""


class Transitions(NamedTuple):
    """One log as dense arrays, padded to T stages."""

    features: Float[np.ndarray, "n T E F"]
    """φ(S_t, a) of every action, without the constant; zeros where S_t was not seen. E is A, or 1 where all actions
    have the same features."""
    is_possible: Bool[np.ndarray, "n T A"]
    action: Int[np.ndarray, "n T"]
    reward: Float[np.ndarray, "n T"]
    """0 where not completed."""
    weight: Float[np.ndarray, "n T"]
    """δ_t / Ĝ(U_t⁻): 0 where the stage was not completed. Where targets are imputed, that of a begun stage."""
    is_last: Bool[np.ndarray, "n T"]
    """Completed stages after which the path had come to its own end."""
    fold: Int[np.ndarray, " n"]
    """Fold of each path for cross-validation, from 0, below the number of folds."""
    control_variates: Float[np.ndarray, "n T Z"] | None = None
    """Of mean 0 given (S_t, A_t), if any are known; what they hold at a path's end does not count."""
    policy: Float[np.ndarray, "n T A"] | None = None
    """π(a | S_t), where Q of a given policy is wanted and not that of the best one."""
    imputation: Imputation | None = None

    def counted(self, counts: Float[np.ndarray, " n"]) -> "Transitions":
        """Let each path count so often."""
        imputed = self.imputation
        if imputed is not None:
            imputed = imputed._replace(outcome_weight=imputed.outcome_weight * counts[:, None])
        return self._replace(weight=self.weight * counts[:, None], imputation=imputed)


class QFunctions(NamedTuple):
    """Q of every stage (separate) or of every number of steps to go (pooled); index 0 is stage 1, or one step to go."""

    coefficients: Float[np.ndarray, "*B T K F"]
    """The offset first."""
    reg: Float[np.ndarray, "*B T K"]
    """The λ that was used."""
    outcome: Float[np.ndarray, "*B T K M"] | None = None
    """Where targets are imputed, the regression of X on the features that it uses and the terms, the offset first."""
    root: Float[np.ndarray, "*B T K F F"] | None = None
    """With pessimism, R of `regression`: the standard error of Q is ‖Rᵀ (1, φ)‖."""


def stack_q(each: list[QFunctions]) -> QFunctions:
    """Stack Q-functions along a new first axis."""
    columns: list[Any] = list(zip(*each, strict=True))
    stacked: list[Any] = [None if leaves[0] is None else np.stack(leaves) for leaves in columns]
    return QFunctions(*stacked)


def q_values(
    coefficients: Float[Any, "*#S K F"], features: Float[Any, "*S E F1"], block_of_action: Int[np.ndarray, " A"]
) -> Float[Any, "*S A"]:
    """Q of every action: the offset of its block plus βᵀφ, of features of its own or of those that all share."""
    each = coefficients[..., block_of_action, :]
    if features.shape[-2] == 1:
        # A product of matrices, where there are many rows.
        xp = library_of(features, coefficients)
        return each[..., 0] + (features @ xp.swapaxes(each[..., 1:], -1, -2))[..., 0, :]
    return each[..., 0] + library_of(features, coefficients).sum(features * each[..., 1:], axis=-1)


def target_of(log: Transitions, successor: Float[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
    """X_t = R_t + V̂(S_{t+1}); after a path's own end V̂ is 0."""
    return log.reward + np.where(log.is_last, 0.0, successor)


def imputed_target(
    log: Transitions,
    outcome: Float[np.ndarray, "T K M"],
    target: Float[np.ndarray, "n T"],
    block_of_action: Int[np.ndarray, " A"],
) -> Float[np.ndarray, "n T"]:
    """Y_t of every begun stage (see `Imputation`): X is `target`, and `outcome` its regression in each stage."""
    given = log.imputation
    assert given is not None
    num_terms = given.terms.shape[-1]
    each = outcome[np.arange(log.action.shape[1]), block_of_action[log.action]]
    at_state = each[..., 0] + np.sum(taken_of(log) * given.is_used * each[..., 1:-num_terms], axis=-1)
    of_time = np.sum(given.expected * each[..., -num_terms:], axis=-1)
    return given.share * target + (1.0 - given.share) * at_state + of_time


def taken_of(log: Transitions) -> Float[np.ndarray, "n T F"]:
    """Features of the action that was taken."""
    if log.features.shape[2] == 1:
        return log.features[:, :, 0]
    return np.take_along_axis(log.features, log.action[..., None, None], axis=2)[:, :, 0]


def values_of(q: Float[np.ndarray, "n T A"], log: Transitions) -> Float[np.ndarray, "n T"]:
    """V̂ of every state: max_a Q over the possible actions, or Σ_a π(a) Q of the policy that is given.

    Where no action is possible it is 0: such a row is padding, and must stay finite.
    """
    if log.policy is not None:
        return np.sum(np.where(log.policy > 0, log.policy * q, 0.0), axis=-1)
    largest = np.max(np.where(log.is_possible, q, -np.inf), axis=-1)
    return np.where(np.isneginf(largest), 0.0, largest)


def of_successor(value: Float[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
    """V̂(S_{t+1}) of each stage, 0 for the last."""
    return np.concatenate([value[:, 1:], np.zeros_like(value[:, :1])], axis=1)


LATER, LATER_ENDED, FIRST, FIRST_ENDED = range(4)
GOING_ON, ENDED = (LATER, FIRST), (LATER_ENDED, FIRST_ENDED)
FOLLOWING = (LATER, LATER_ENDED)


class StateChoices(NamedTuple):
    """What is possible in the states, where each action has features of its own, sorted by block."""

    matrix: Float[np.ndarray, "C F"]
    """1, φ(S, a)."""
    begin: Int[np.ndarray, " K1"]
    """Where the choices of each block begin, and where the last ones end."""
    row: Int[np.ndarray, " C"]
    """That of S."""
    action: Int[np.ndarray, " C"]
    policy: Float[np.ndarray, " C"] | None
    """π(a | S), where Q of a given policy is wanted."""


class Rows(NamedTuple):
    """Rows of whole paths of a log."""

    matrix: Float[np.ndarray, "R M"]
    """1 and φ(S_t, A_t), control variates, and of imputed targets terms and what is expected of these."""
    reward: Float[np.ndarray, " R"]
    weight: Float[np.ndarray, " R"]
    """0 of a state that only follows another one."""
    after: Int[np.ndarray, " R"]
    """Row of S_{t+1}; R where nothing follows."""
    groups: Int[np.ndarray, "N 5"]
    """Slice, fold and block of each group, where it begins and where it ends."""
    widths: Int[np.ndarray, " 4"]
    """Columns of `matrix` of each kind."""
    share: Float[np.ndarray, " R"] | None
    outcome_weight: Float[np.ndarray, " R"] | None
    is_used: Float[np.ndarray, " F1"] | None
    """As in `Imputation`."""
    is_possible: Bool[np.ndarray, "R A"] | None
    """Where all actions share their features; None where all are possible everywhere."""
    block_of_action: Int[np.ndarray, " A"]
    choices: StateChoices | None
    """Where they do not."""
    policy: Float[np.ndarray, "R A"] | None = None
    """Where they do, π(a | S_t), if Q of a given policy is wanted."""

    @property
    def features(self) -> Float[np.ndarray, "R F"]:
        """1 and φ(S_t, A_t)."""
        return self.matrix[:, : self.widths[0]]

    @property
    def design(self) -> Float[np.ndarray, "R F"]:
        """Features and control variates."""
        return self.matrix[:, : self.widths[:2].sum()]

    def span(self, slices: tuple[int, ...]) -> slice:
        """Rows of slices that lie one after another."""
        of_slices = self.groups[np.isin(self.groups[:, 0], slices)]
        return slice(of_slices[0, 3], of_slices[-1, 4]) if len(of_slices) else slice(0, 0)


def rows_of(log: Transitions, regression: "Regression") -> Rows:
    """Pack a log, or a part of it that is laid out as the whole would be."""
    weight, given, blocks = log.weight, log.imputation, regression.block_of_action
    horizon = weight.shape[1]
    goes_on = (weight > 0) & ~log.is_last & (np.arange(horizon) < horizon - 1)
    if given is not None:
        # Of a stage that was cut no successor was seen.
        goes_on &= given.share != 0
    is_state = np.zeros_like(goes_on)
    is_state[:, 1:] = goes_on[:, :-1]
    path, stage = np.nonzero((weight > 0) | is_state)
    action = log.action[path, stage]
    slices = stage
    if regression.stages == "pooled":
        slices = _slices_of_pooled(stage, action, horizon, regression.end_action)
    is_cut = np.zeros(len(path), dtype=np.int64) if given is None else given.outcome_weight[path, stage] == 0
    block = blocks[action]
    order = np.lexsort((is_cut, block, log.fold[path], slices))
    at = path[order], stage[order]
    keys = np.stack([slices[order], log.fold[at[0]], block[order], is_cut[order]], axis=1)
    row_of = np.full(weight.shape, len(order))
    row_of[at] = np.arange(len(order))
    after = np.full(weight.shape, len(order))
    after[:, :-1] = np.where(goes_on[:, :-1], row_of[:, 1:], len(order))
    is_shared = log.features.shape[2] == 1
    possible = log.is_possible[at]
    return Rows(
        **_columns(log, at),
        reward=log.reward[at],
        weight=weight[at],
        after=after[at].astype(np.int32),
        groups=_groups(keys),
        is_possible=possible if is_shared and not possible.all() else None,
        block_of_action=blocks,
        choices=None if is_shared else _choices(log, at, is_state[at], blocks, regression.num_blocks),
        policy=log.policy[at] if is_shared and log.policy is not None else None,
    )


def _slices_of_pooled(
    stage: Int[np.ndarray, " R"], action: Int[np.ndarray, " R"], horizon: int, end_action: int | None
) -> Int[np.ndarray, " R"]:
    is_ended = (stage == horizon - 1) & (end_action is None or action != end_action)
    return np.where(stage > 0, np.where(is_ended, LATER_ENDED, LATER), np.where(is_ended, FIRST_ENDED, FIRST))


def _groups(keys: Int[np.ndarray, "R 4"]) -> Int[np.ndarray, "N 5"]:
    begin = np.flatnonzero(np.any(np.diff(keys, axis=0, prepend=-1), axis=1))
    return np.column_stack([keys[begin, :3], begin, np.append(begin[1:], len(keys))])


def _columns(log: Transitions, at: tuple[np.ndarray, np.ndarray]) -> dict[str, Any]:
    """The matrix, how wide each kind of columns is, and what else belongs to imputed targets."""
    taken = 0 if log.features.shape[2] == 1 else log.action[at]
    kinds = [np.column_stack([np.ones(len(at[0])), log.features[(*at, taken)]])]
    given, none = log.imputation, np.zeros((len(at[0]), 0))
    if log.control_variates is None:
        kinds.append(none)
    else:
        # What is not known of a path's end does not count; imputed targets hold a share of each.
        seen = np.where(log.is_last[at][:, None], 0.0, log.control_variates[at])
        kinds.append(seen if given is None else seen * given.share[at][:, None])
    kinds += [none, none] if given is None else [given.terms[at], given.expected[at]]
    return {
        "matrix": np.column_stack(kinds),
        "widths": np.array([kind.shape[1] for kind in kinds]),
        "share": None if given is None else given.share[at],
        "outcome_weight": None if given is None else given.outcome_weight[at],
        "is_used": None if given is None else np.concatenate([[1.0], given.is_used]),
    }


def _choices(
    log: Transitions,
    at: tuple[np.ndarray, np.ndarray],
    is_state: Bool[np.ndarray, " R"],
    blocks: Int[np.ndarray, " A"],
    num_blocks: int,
) -> StateChoices:
    is_choice = log.is_possible[at] if log.policy is None else log.policy[at] > 0
    row, action = np.nonzero(is_choice & is_state[:, None])
    by_block = np.argsort(blocks[action], kind="stable")
    row, action = row[by_block], action[by_block]
    features = log.features[at[0][row], at[1][row], action]
    return StateChoices(
        matrix=np.column_stack([np.ones(len(row), features.dtype), features]),
        begin=np.searchsorted(blocks[action], np.arange(num_blocks + 1)),
        row=row.astype(np.int32),
        action=action.astype(np.int32),
        policy=None if log.policy is None else log.policy[at[0][row], at[1][row], action],
    )
