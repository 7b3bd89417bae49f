"""Censored Q-learning, backwards over the stages (paper, eq. 3), for linear 𝒬.

    Q̂_{T+1} ≡ 0;  Q̂_t = argmin E_n[ (R_t + max_a' Q̂_{t+1}(S_{t+1}, a') − Q_t(S_t, A_t))² · δ_t / Ĝ(U_t⁻) ]

A linear Q is α_k + β_kᵀ φ(S, a) with k the block of the action, and each step adds the ridge of `least_squares`.

*Separate* stages: each stage has its own Q_t, fitted on its own rows and shrunk towards 0.

*Pooled* stages, for worlds whose dynamics do not depend on t: Q_h is indexed by the steps to go, h = 1..T, and fitted
on the rows of all stages; a row that the horizon ended says nothing of a longer future, so it serves Q_1 alone. One
more step to go changes little, so Q_h is shrunk towards Q_{h−1}. With λ = 0 nothing is shrunk, and eq. 3 is exact.

*Control variates* [Glasserman2003]_ are numbers that S_{t+1} tells and whose mean given (S_t, A_t) is 0.
Each regression runs on them too, and Q leaves them out: what they explain of the target is noise that Q is spared.

Where a policy is *given*, the maximum gives way to Σ_a π(a | S_{t+1}) Q̂_{t+1}(S_{t+1}, a): Q̂ is then that of the
policy (fitted Q evaluation), and nothing is chosen.

Where targets are *imputed*, the stage in which a path was right-censored has one, too; see `imputation`.
"""

from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.learners.q_learning.least_squares import (
    Design,
    Factor,
    Rows,
    cross_of,
    design_of,
    factorise,
    gram_of,
    solve,
    waiting_for,
)

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
    is_observed: Float[AnyArray, "*B n T"]
    """Weight of each stage in the regression of X: 1 where completed."""
    is_used: Float[AnyArray, "*B F"]
    """1 for each feature that this regression looks at, 0 for the others."""


class Transitions(NamedTuple):
    """One log as dense arrays, padded to T stages; `jax.vmap` adds an axis of logs."""

    features: Float[AnyArray, "*B n T A F"]
    """φ(S_t, a) of every action, without the constant; zeros where S_t was not seen."""
    is_possible: Bool[AnyArray, "*B n T A"]
    action: Int[AnyArray, "*B n T"]
    reward: Float[AnyArray, "*B n T"]
    """0 where not completed."""
    weight: Float[AnyArray, "*B n T"]
    """δ_t / Ĝ(U_t⁻): 0 where the stage was not completed. Where targets are imputed, that of a begun stage."""
    is_last: Bool[AnyArray, "*B n T"]
    """Completed stages after which the path had come to its own end."""
    fold: Int[AnyArray, "*B n"]
    """Fold of each path for cross-validation, from 0; below the number of folds."""
    control_variates: Float[AnyArray, "*B n T Z"] | None = None
    """Of mean 0 given (S_t, A_t), if any are known; what they hold at a path's end does not count."""
    policy: Float[AnyArray, "*B n T A"] | None = None
    """π(a | S_t), where Q of a given policy is wanted and not that of the best one."""
    imputation: Imputation | None = None


class QFunctions(NamedTuple):
    """Q of every stage (separate) or of every number of steps to go (pooled); index 0 is stage 1, or one step to go."""

    coefficients: Float[AnyArray, "*B T K F"]
    """The offset first."""
    reg: Float[AnyArray, "*B T K"]
    """The λ that was used."""
    outcome: Float[AnyArray, "*B T K M"] | None = None
    """Where targets are imputed, the regression of X on the features that it uses and the terms, the offset first."""


def q_values(
    coefficients: Float[AnyArray, "K F"],
    features: Float[AnyArray, "*S A F1"],
    block_of_action: Int[AnyArray, " A"],
) -> Float[Array, "*S A"]:
    """Q of every action: the offset of its block plus βᵀφ."""
    per_action = coefficients[block_of_action]
    # One pass over the features; a batched matrix product would take seven times as long.
    return per_action[:, 0] + jnp.sum(features * per_action[:, 1:], axis=-1)


@partial(jax.jit, static_argnames=("num_blocks", "stages", "num_folds", "end_action", "is_scaled"))
def backward(
    log: Transitions,
    block_of_action: Int[Array, " A"],
    regs: Float[Array, " L"],
    *,
    num_blocks: int,
    stages: StageMode,
    num_folds: int,
    end_action: int | None = None,
    is_scaled: bool = True,
) -> QFunctions:
    """Fit all Q-functions of one log.

    Parameters
    ----------
    log
        The log.
    block_of_action
        Which block of coefficients each action uses.
    regs
        The λ to choose from.
    num_blocks
        K.
    stages
        ``"separate"`` or ``"pooled"``.
    num_folds
        V, folds of the cross-validation.
    end_action
        For pooled stages: the action that the horizon forces upon a path, so that Q_0(S) = Q(S, end_action); every Q
        is shrunk towards it. It must end a path wherever it is taken, and a feature must mean the same in all blocks
        or be 0 for it. None if reaching the horizon costs nothing, Q_0 ≡ 0.
    is_scaled
        Whether λ weighs features as if each had unit variance; False for features of a kernel.
    """
    regression = Regression(block_of_action, regs, num_blocks, num_folds, log.action.shape[0], is_scaled)
    if stages == "separate":
        return _backward_separate(log, regression)
    return _backward_pooled(log, regression, end_action)


class Regression(NamedTuple):
    """What all regressions of one log share."""

    block_of_action: Int[Array, " A"]
    regs: Float[Array, " L"]
    num_blocks: int
    num_folds: int
    num_paths: int
    is_scaled: bool

    def prepare(self, log: Transitions, weight: Any, after: "_Prepared | None" = None) -> "_Prepared":
        """Sum and factorise what no target changes, and not before `after`; rows of `weight` 0 do not count."""
        design, taken = self.design(log, weight), _taken(log)
        gram = gram_of(design)
        if after is not None:
            gram = waiting_for((after.outcome or after.main).factor.eigenvalues, gram)
        main = _Sums(design, factorise(gram, self.is_scaled))
        if log.imputation is None:
            return _Prepared(main, None)
        given, used = log.imputation, taken * log.imputation.is_used
        outcome = self._design(log, jnp.where(weight > 0, given.is_observed, 0.0), used, given.terms)
        gram = waiting_for(main.factor.eigenvalues, gram_of(outcome))
        return _Prepared(main, _Sums(outcome, factorise(gram, self.is_scaled)))

    def fit(
        self, prepared: "_Prepared", log: Transitions, successor: Float[Array, "n T"], centre: Float[Array, "K F"]
    ) -> QFunctions:
        """Regress R_t + V̂(S_{t+1}), or what is imputed for it, shrunk towards `centre`; control variates come last."""
        target, outcome = target_of(log, successor).ravel(), None
        if prepared.outcome is not None and log.imputation is not None:
            cross = cross_of(prepared.outcome.design, target)
            outcome = solve(prepared.outcome.factor, cross, self.regs, self.num_paths).coefficients
            target = imputed_target(log, outcome, target.reshape(log.action.shape), self.block_of_action).ravel()
        cross = self.cross(prepared.main.design, log, target, centre)
        fit = solve(prepared.main.factor, cross, self.regs, self.num_paths)
        return QFunctions(fit.coefficients + centre, fit.reg, outcome)

    def design(self, log: Transitions, weight: Any) -> Design:
        """Rows of eq. 3, with the control variates of its targets."""
        return self._design(log, weight, _taken(log), _seen_control_variates(log))

    def cross(
        self, design: Design, log: Transitions, target: Float[Array, " R"], centre: Float[Array, "K F"]
    ) -> Float[Array, "V K F"]:
        """Σ w x y of a target, less what `centre` says of it."""
        expected = jnp.sum(design.features * centre[self.blocks(log)], axis=-1)
        return cross_of(design, target - expected)

    def blocks(self, log: Transitions) -> Int[Array, " R"]:
        """Block of the action of every row."""
        return self.block_of_action[log.action].ravel()

    def _design(self, log: Transitions, weight: Any, taken: Any, more: Any) -> Design:
        features = taken if more is None else jnp.concatenate([taken, more], axis=-1)
        rows = Rows(
            features=features.reshape(log.action.size, features.shape[-1]),
            block=self.blocks(log),
            weight=weight.ravel(),
            fold=jnp.repeat(log.fold, log.action.shape[1]),
        )
        return design_of(rows, self.num_blocks, self.num_folds)


class _Sums(NamedTuple):
    design: Design
    factor: Factor


class _Prepared(NamedTuple):
    main: _Sums
    outcome: _Sums | None


def _backward_separate(log: Transitions, regression: Regression) -> QFunctions:
    """Each stage on its own rows, the last one first."""
    width = log.features.shape[-1] + 1

    def step(after: Float[Array, " n"], stage: Int[Array, ""]):
        rows = stage_of(log, stage)
        prepared = regression.prepare(rows, rows.weight)
        centre = jnp.zeros((regression.num_blocks, prepared.main.design.features.shape[-1]), log.reward.dtype)
        fit = regression.fit(prepared, rows, after[:, None], centre)
        of_q = fit.coefficients[:, :width]
        return state_values(jnp.asarray(of_q), rows, regression.block_of_action)[:, 0], fit._replace(coefficients=of_q)

    return jax.lax.scan(step, jnp.zeros_like(log.reward[:, 0]), jnp.arange(log.action.shape[1]), reverse=True)[1]


def stage_of(log: Transitions, stage: Int[Array, ""]) -> Transitions:
    """Keep the rows of one stage."""
    is_used = None if log.imputation is None else log.imputation.is_used
    by_stage = log._replace(fold=None, imputation=log.imputation and log.imputation._replace(is_used=None))
    rows = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, stage, 1, axis=1), by_stage)
    return rows._replace(fold=log.fold, imputation=rows.imputation and rows.imputation._replace(is_used=is_used))


def _backward_pooled(log: Transitions, regression: Regression, end_action: int | None) -> QFunctions:
    """All stages' rows at each number of steps to go, one step first."""
    everything = regression.prepare(log, log.weight)
    num_coefficients = log.features.shape[-1] + 1

    def step(prepared: _Prepared, value: Float[Array, "n T"], centre: Float[Array, "K F"]):
        fit = regression.fit(prepared, log, of_successor(value), centre)
        of_q = fit.coefficients[:, :num_coefficients]
        value = state_values(jnp.asarray(of_q), log, regression.block_of_action)
        return value, jnp.asarray(fit.coefficients), fit._replace(coefficients=of_q)

    value = jnp.zeros_like(log.reward)
    centre = jnp.zeros((regression.num_blocks, everything.main.design.features.shape[-1]), log.reward.dtype)
    if end_action is not None:
        ended = jnp.asarray(regression.fit(everything, log, value, centre).coefficients)
        value = q_values(ended[:, :num_coefficients], log.features, regression.block_of_action)[..., end_action]
        centre = jnp.broadcast_to(ended[regression.block_of_action[end_action]], centre.shape)
    value, centre, first = step(everything, value, centre)
    later = regression.prepare(log, jnp.where(goes_on(log, end_action), log.weight, 0.0), after=everything)

    def advance(carry: tuple[Float[Array, "n T"], Float[Array, "K F"]], _: None):
        value, centre, fit = step(later, *carry)
        return (value, centre), fit

    _, rest = jax.lax.scan(advance, (value, centre), length=log.action.shape[1] - 1)
    return jax.tree.map(lambda one, others: jnp.concatenate([one[None], others]), first, rest)


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
    at_state = each[..., 0] + jnp.sum(_taken(log) * given.is_used * each[..., 1:-num_terms], axis=-1)
    of_time = jnp.sum(given.expected * each[..., -num_terms:], axis=-1)
    return jnp.asarray(given.share * target + (1.0 - given.share) * at_state + of_time)


def _taken(log: Transitions) -> Float[Array, "n T F"]:
    return jnp.take_along_axis(jnp.asarray(log.features), log.action[..., None, None], axis=2)[:, :, 0]


def goes_on(log: Transitions, end_action: int | None) -> Bool[Array, "n T"]:
    """Tell which rows speak of more than one step to go: the horizon did not end them."""
    before_last = jnp.broadcast_to(jnp.arange(log.action.shape[1]) < log.action.shape[1] - 1, log.action.shape)
    return before_last if end_action is None else before_last | (log.action == end_action)


def state_values(
    coefficients: Float[Array, "K F"], log: Transitions, block_of_action: Int[Array, " A"]
) -> Float[Array, "n T"]:
    """V̂ of every state by one Q."""
    return values_of(q_values(coefficients, log.features, block_of_action), log)


def values_of(q: Float[Array, "n T A"], log: Transitions) -> Float[Array, "n T"]:
    """V̂ of every state: max_a Q over the possible actions, or Σ_a π(a) Q of the policy that is given.

    Where no action is possible it is 0: such a row is padding, and must stay finite.
    """
    if log.policy is not None:
        return jnp.sum(jnp.where(log.policy > 0, log.policy * q, 0.0), axis=-1)
    largest = jnp.max(jnp.where(log.is_possible, q, -jnp.inf), axis=-1)
    return jnp.where(jnp.any(log.is_possible, axis=-1), largest, 0.0)


def _seen_control_variates(log: Transitions) -> Any:
    """Control variates of completed stages that went on; imputed targets hold only a share of each."""
    if log.control_variates is None:
        return None
    seen = jnp.where(log.is_last[..., None], 0.0, log.control_variates)
    return seen if log.imputation is None else seen * log.imputation.share[..., None]


def of_successor(value: Float[Array, "n T"]) -> Float[Array, "n T"]:
    """V̂(S_{t+1}) of each stage, 0 for the last."""
    return jnp.concatenate([value[:, 1:], jnp.zeros_like(value[:, :1])], axis=1)
