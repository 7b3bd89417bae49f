"""The rows of eq. 3: a log as dense arrays, what Q says of each of them, and the targets that Q is fitted to."""

from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import library_of

StageMode = Literal["separate", "pooled"]


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
    """With pessimism, R of `spread`: the standard error of Q is ‖Rᵀ (1, φ)‖."""


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
