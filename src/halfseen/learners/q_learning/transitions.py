"""The rows of eq. 3: a log as dense arrays, what Q says of each of them, and the targets that Q is fitted to."""

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

StageMode = Literal["separate", "pooled"]
AnyArray = Array | np.ndarray


class Imputation(NamedTuple):
    """How a begun stage gets a target Y whether or not its end was seen (see the module `imputation`).

    With X = R_t + V̂(S_{t+1}) and its regression α + βᵀφ + γᵀg on the completed stages, g terms of the duration,

        Y = share·X + (1 − share)·(α + βᵀφ) + γᵀexpected.
    """

    share: Float[AnyArray, "*B n T"]
    """Of X; 0 where the stage was not completed."""
    terms: Float[AnyArray, "*B n T G"]
    """g of each completed stage."""
    expected: Float[AnyArray, "*B n T G"]
    """What stands for g·(1 − share)."""
    outcome_weight: Float[AnyArray, "*B n T"]
    """Weight of each stage in the regression of X: 0 where cut; where completed δ/K̂, truncated, or 1 without K̂."""
    is_used: Float[AnyArray, "*B F"]
    """1 for each feature that this regression looks at, 0 for the others."""


class Choices(NamedTuple):
    """What is possible in the states of packed rows, in chunks of one block each (see `packing`)."""

    features: Float[AnyArray, "C S F"]
    """φ(S_t, a)."""
    action: Int[AnyArray, "C S"]
    row: Int[AnyArray, "C S"]
    """That of S_t; beyond the last where a chunk has room to spare."""
    policy: Float[AnyArray, "C S"] | None
    """π(a | S_t), where Q of a given policy is wanted."""


class Transitions(NamedTuple):
    """One log as dense arrays, padded to T stages; `jax.vmap` adds an axis of logs."""

    features: Float[AnyArray, "*B n T E F"]
    """φ(S_t, a) of every action, without the constant; zeros where S_t was not seen. E is A, or 1 where all actions
    have the same features; where rows are packed, they are those of the action that was taken."""
    is_possible: Bool[AnyArray, "*B n T A"]
    action: Int[AnyArray, "*B n T"]
    reward: Float[AnyArray, "*B n T"]
    """0 where not completed."""
    weight: Float[AnyArray, "*B n T"]
    """δ_t / Ĝ(U_t⁻): 0 where the stage was not completed. Where targets are imputed, that of a begun stage."""
    is_last: Bool[AnyArray, "*B n T"]
    """Completed stages after which the path had come to its own end."""
    fold: Int[AnyArray, "*B n"] | Int[AnyArray, "*B n T"]
    """Fold of each path for cross-validation, from 0, below the number of folds; of each row, where packed."""
    control_variates: Float[AnyArray, "*B n T Z"] | None = None
    """Of mean 0 given (S_t, A_t), if any are known; what they hold at a path's end does not count."""
    policy: Float[AnyArray, "*B n T A"] | None = None
    """π(a | S_t), where Q of a given policy is wanted and not that of the best one."""
    imputation: Imputation | None = None
    num_paths: Float[AnyArray, "*B"] | None = None
    """n, where there are rows that are no path of the log (see `room`)."""
    is_longer: Bool[AnyArray, "*B n T"] | None = None
    """Whether a row speaks of more than one step to go, where rows are packed (see `packing`)."""
    choices: Choices | None = None
    """What was possible, where rows are packed."""


class QFunctions(NamedTuple):
    """Q of every stage (separate) or of every number of steps to go (pooled); index 0 is stage 1, or one step to go."""

    coefficients: Float[AnyArray, "*B T K F"]
    """The offset first."""
    reg: Float[AnyArray, "*B T K"]
    """The λ that was used."""
    outcome: Float[AnyArray, "*B T K M"] | None = None
    """Where targets are imputed, the regression of X on the features that it uses and the terms, the offset first."""
    root: Float[AnyArray, "*B T K F F"] | None = None
    """With pessimism, R of `spread`: the standard error of Q is ‖Rᵀ (1, φ)‖."""


def q_values(
    coefficients: Float[AnyArray, "K F"],
    features: Float[AnyArray, "*S E F1"],
    block_of_action: Int[AnyArray, " A"],
) -> Float[Array, "*S A"]:
    """Q of every action: the offset of its block plus βᵀφ, of features of its own or of those that all share."""
    *shape, num_features = features.shape
    if features.shape[-2] == 1 and len(coefficients) == len(block_of_action):
        # A sum over so few numbers of each row takes three times as long as a product.
        return coefficients[block_of_action, 0] + features[..., 0, :] @ coefficients[block_of_action, 1:].T
    if len(coefficients) == len(block_of_action):
        # Each action has a block of its own: a product for all blocks would be needed in one of so many places.
        return coefficients[block_of_action, 0] + jnp.sum(features * coefficients[block_of_action, 1:], axis=-1)
    # One product for all blocks: in a batch of logs that share features, those are read once.
    rows = features.reshape(math.prod(shape), num_features)
    of_block = (coefficients[:, 1:] @ rows.T).reshape(len(coefficients), *shape)
    slopes = of_block[0]
    for block in range(1, len(coefficients)):
        slopes = jnp.where(block_of_action == block, of_block[block], slopes)
    return jnp.asarray(coefficients[block_of_action, 0] + slopes)


def target_of(log: Transitions, successor: Float[Array, "n T"]) -> Float[Array, "n T"]:
    """X_t = R_t + V̂(S_{t+1}); after a path's own end V̂ is 0."""
    return jnp.asarray(log.reward + jnp.where(log.is_last, 0.0, successor))


def imputed_target(
    log: Transitions, outcome: Float[Array, "*T K M"], target: Float[Array, "n T"], block_of_action: Int[Array, " A"]
) -> Float[Array, "n T"]:
    """Y_t of every begun stage (see `Imputation`): X is `target`, and `outcome` its regression, one or one a stage."""
    given = log.imputation
    assert given is not None
    num_terms = given.terms.shape[-1]
    by_stage = jnp.broadcast_to(outcome, (log.action.shape[1], *outcome.shape[-2:]))
    each = by_stage[jnp.arange(log.action.shape[1]), block_of_action[log.action]]
    at_state = each[..., 0] + jnp.sum(taken_of(log) * given.is_used * each[..., 1:-num_terms], axis=-1)
    of_time = jnp.sum(given.expected * each[..., -num_terms:], axis=-1)
    return jnp.asarray(given.share * target + (1.0 - given.share) * at_state + of_time)


def taken_of(log: Transitions) -> Float[Array, "n T F"]:
    """Features of the action that was taken."""
    if log.features.shape[2] == 1:
        return jnp.asarray(log.features)[:, :, 0]
    return jnp.take_along_axis(jnp.asarray(log.features), log.action[..., None, None], axis=2)[:, :, 0]


def of_paths(change: Callable[[Any], Any], log: Transitions) -> Transitions:
    """Change each array that has a row for every path."""
    is_used = None if log.imputation is None else log.imputation.is_used
    kept = log._replace(
        num_paths=None, choices=None, imputation=log.imputation and log.imputation._replace(is_used=None)
    )
    changed = jax.tree.map(change, kept)
    imputed = changed.imputation and changed.imputation._replace(is_used=is_used)
    return changed._replace(num_paths=log.num_paths, choices=log.choices, imputation=imputed)


def stage_of(log: Transitions, stage: Int[Array, ""]) -> Transitions:
    """Keep the rows of one stage."""
    rows = of_paths(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, stage, 1, axis=1), log._replace(fold=None))
    return rows._replace(fold=log.fold)


def goes_on(log: Transitions, end_action: int | None) -> Bool[Array, "n T"]:
    """Tell which rows speak of more than one step to go: the horizon did not end them."""
    if log.is_longer is not None:
        return jnp.asarray(log.is_longer)
    before_last = jnp.broadcast_to(jnp.arange(log.action.shape[1]) < log.action.shape[1] - 1, log.action.shape)
    return before_last if end_action is None else before_last | (log.action == end_action)


def state_values(
    coefficients: Float[Array, "K F"], log: Transitions, block_of_action: Int[Array, " A"]
) -> Float[Array, "n T"]:
    """V̂ of every state by one Q."""
    return values_of(q_values(coefficients, log.features, block_of_action), log)


def q_of_choices(
    coefficients: Float[AnyArray, "K F"], choices: Choices, block_of_action: Int[Array, " A"]
) -> Float[Array, "C S"]:
    """Q of all that is possible."""
    of_chunk = jnp.asarray(coefficients)[block_of_action[choices.action[:, 0]]]
    return of_chunk[:, :1] + jnp.einsum("csf,cf->cs", choices.features, of_chunk[:, 1:])


def values_of(q: Float[Array, "n T A"] | Float[Array, "C S"], log: Transitions) -> Float[Array, "n T"]:
    """V̂ of every state: max_a Q over the possible actions, or Σ_a π(a) Q of the policy that is given.

    Where no action is possible it is 0: such a row is padding, and must stay finite.
    """
    if log.choices is not None:
        if log.choices.policy is None:
            return largest_of_choices(q, log)
        return _by_row(jax.ops.segment_sum, jnp.asarray(log.choices.policy * q), log)
    if log.policy is not None:
        return jnp.sum(jnp.where(log.policy > 0, log.policy * q, 0.0), axis=-1)
    largest = jnp.max(jnp.where(log.is_possible, q, -jnp.inf), axis=-1)
    return jnp.where(jnp.any(log.is_possible, axis=-1), largest, 0.0)


def largest_of_choices(q: Float[Array, "C S"], log: Transitions) -> Float[Array, "n T"]:
    """Largest of what is possible in each state; 0 where nothing is."""
    largest = _by_row(jax.ops.segment_max, q, log)
    return jnp.where(jnp.isneginf(largest), 0.0, largest)


def _by_row(reduce: Callable[..., Any], q: Float[Array, "C S"], log: Transitions) -> Float[Array, "n T"]:
    assert log.choices is not None
    shape = log.action.shape
    return reduce(q.ravel(), log.choices.row.ravel(), math.prod(shape)).reshape(shape)


def of_successor(value: Float[Array, "n T"]) -> Float[Array, "n T"]:
    """V̂(S_{t+1}) of each stage, 0 for the last."""
    return jnp.concatenate([value[:, 1:], jnp.zeros_like(value[:, :1])], axis=1)
