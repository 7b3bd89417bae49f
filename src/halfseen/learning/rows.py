"""Rows of eq. 3 as sums need them: packed, in groups that lie one after another, as plain arrays that a disk can keep.

A group is the rows of one *slice*, fold and block, completed or cut. So a sum over a group is a product of two narrow
matrices without masks, and what a backward step looks at are whole slices. Slices of separate stages are the stages.
Those of pooled stages are told apart by whether a row speaks of more than one step to go, and whether it follows
another one, so that V̂ is sought in its state: `LATER` and `LATER_ENDED` do, `FIRST` and `FIRST_ENDED` do not.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.learning.transitions import Transitions

if TYPE_CHECKING:
    from halfseen.learning.recursion import Regression

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
    """As in `transitions.Imputation`."""
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
