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
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

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
    with_prior,
)
from halfseen.learners.q_learning.spread import (
    Spread,
    by_block,
    roots,
    spread_of_rows,
    standard_errors,
    standard_errors_of_choices,
)
from halfseen.learners.q_learning.transitions import (
    QFunctions,
    StageMode,
    Transitions,
    goes_on,
    imputed_target,
    largest_of_choices,
    of_successor,
    q_of_choices,
    q_values,
    stage_of,
    taken_of,
    target_of,
    values_of,
)


@partial(jax.jit, static_argnames=("num_blocks", "stages", "num_folds", "end_action", "is_scaled", "horizon"))
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
    pessimism: Float[Array, ""] | None = None,
    value: Float[Array, "n T"] | None = None,
    horizon: int | None = None,
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
    pessimism
        Standard errors (see `spread`) by which Q is lowered wherever the largest is sought; None for eq. 3 as it is.
    value
        For separate stages: V̂ of every state, if it is not to follow from the stages after it.
    horizon
        T, where stages are pooled and rows are packed (see `packing`).
    """
    num_paths = log.action.shape[0] if log.num_paths is None else jnp.asarray(log.num_paths)
    regression = Regression(block_of_action, regs, num_blocks, num_folds, num_paths, is_scaled, pessimism)
    if stages == "separate":
        return _backward_separate(log, regression, value)
    return _backward_pooled(log, regression, end_action, horizon or log.action.shape[1])


class Regression(NamedTuple):
    """What all regressions of one log share."""

    block_of_action: Int[Array, " A"]
    regs: Float[Array, " L"]
    num_blocks: int
    num_folds: int
    num_paths: int | Float[Array, ""]
    is_scaled: bool
    pessimism: Float[Array, ""] | None = None

    def prepare(self, log: Transitions, weight: Any) -> "_Prepared":
        """Sum and factorise what no target changes; rows of `weight` 0 do not count."""
        design = self.design(log, weight)
        main = _Sums(design, factorise(gram_of(design), self.is_scaled))
        if log.imputation is None:
            return self._with_spread(_Prepared(main, None), log, weight)
        outcome = self.outcome_design(log, weight)
        gram = waiting_for(main.factor.eigenvalues, self.outcome_gram(outcome, log))
        found = _Prepared(main, _Sums(outcome, factorise(gram, self.is_scaled)))
        return self._with_spread(found, log, weight)

    def _with_spread(self, prepared: "_Prepared", log: Transitions, weight: Any) -> "_Prepared":
        if self.pessimism is None:
            return prepared
        design = self._design(log, seen_weight(log, weight), taken_of(log), None)
        return prepared._replace(seen=_Seen(design, spread_of_rows(design, prepared.last_eigenvalues, self.is_scaled)))

    def fit(
        self,
        prepared: "_Prepared",
        log: Transitions,
        successor: Float[Array, "n T"],
        centre: Float[Array, "K F"] | None = None,
    ) -> QFunctions:
        """Regress R_t + V̂(S_{t+1}), or what is imputed for it, shrunk towards `centre`; control variates come last."""
        target, outcome = target_of(log, successor).ravel(), None
        if prepared.outcome is not None and log.imputation is not None:
            cross = cross_of(prepared.outcome.design, target)
            outcome = solve(prepared.outcome.factor, cross, self.regs, self.num_paths).coefficients
            target = imputed_target(log, outcome, target.reshape(log.action.shape), self.block_of_action).ravel()
        design = prepared.main.design
        cross = cross_of(design, target) if centre is None else self.cross(design, log, target, centre)
        fit = solve(prepared.main.factor, cross, self.regs, self.num_paths)
        found = QFunctions(fit.coefficients if centre is None else fit.coefficients + centre, fit.reg, outcome)
        if prepared.seen is None:
            return found
        q = jnp.sum(prepared.main.design.features * found.coefficients[self.blocks(log)], axis=-1)
        residual = target_of(log, successor).ravel() - q
        squares = by_block(prepared.seen.design.weight * residual**2, prepared.seen.design)
        return found._replace(root=roots(prepared.seen.spread, fit.reg, self.num_paths, squares))

    def values(self, fit: QFunctions, log: Transitions) -> Float[Array, "n T"]:
        """V̂ of every state by one fit; with pessimism, by lower confidence bounds of its Q."""
        return values_of(bounded(fit, log, self.block_of_action, self.pessimism), log)

    def design(self, log: Transitions, weight: Any) -> Design:
        """Rows of eq. 3, with the control variates of its targets."""
        return self._design(log, weight, taken_of(log), _seen_control_variates(log))

    def outcome_design(self, log: Transitions, weight: Any) -> Design:
        """Rows of the regression of X on the features that it uses and the terms of the duration."""
        assert log.imputation is not None
        used = taken_of(log) * log.imputation.is_used
        return self._design(log, jnp.where(weight > 0, log.imputation.outcome_weight, 0.0), used, log.imputation.terms)

    def outcome_gram(self, design: Design, log: Transitions) -> Float[Array, "V K F F"]:
        """Σ w x xᵀ of these rows, with the prior of the terms."""
        assert log.imputation is not None
        return with_prior(gram_of(design), log.imputation.terms.shape[-1])

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
            fold=_fold_of_rows(log),
        )
        return design_of(rows, self.num_blocks, self.num_folds)


def _fold_of_rows(log: Transitions) -> Int[Array, " R"]:
    of_path = log.fold if log.fold.ndim == log.action.ndim else log.fold[:, None]
    return jnp.broadcast_to(of_path, log.action.shape).ravel()


class _Sums(NamedTuple):
    design: Design
    factor: Factor


class _Seen(NamedTuple):
    design: Design
    spread: Spread


class _Prepared(NamedTuple):
    main: _Sums
    outcome: _Sums | None
    seen: _Seen | None = None
    """With pessimism, the completed stages."""

    @property
    def last_eigenvalues(self) -> Float[Array, "..."]:
        """Of the factorisation that came last."""
        return (self.outcome or self.main).factor.eigenvalues


def _backward_separate(
    log: Transitions, regression: Regression, value: Float[Array, "n T"] | None = None
) -> QFunctions:
    """Each stage on its own rows, the last one first; V̂ is what follows from it, or is given."""
    width = log.features.shape[-1] + 1
    given = None if value is None else of_successor(value)

    def step(after: Float[Array, " n"], stage: Int[Array, ""]):
        rows = stage_of(log, stage)
        prepared = regression.prepare(rows, rows.weight)
        successor = after[:, None] if given is None else jax.lax.dynamic_slice_in_dim(given, stage, 1, axis=1)
        fit = regression.fit(prepared, rows, successor)
        of_q = fit._replace(coefficients=fit.coefficients[:, :width])
        return regression.values(of_q, rows)[:, 0], of_q

    return jax.lax.scan(step, jnp.zeros_like(log.reward[:, 0]), jnp.arange(log.action.shape[1]), reverse=True)[1]


def _backward_pooled(log: Transitions, regression: Regression, end_action: int | None, horizon: int) -> QFunctions:
    """All stages' rows at each number of steps to go: none, if the horizon forces an action upon a path, then one."""
    of_longer = jnp.where(goes_on(log, end_action), log.weight, 0.0)
    # One after the other: both at once would take twice the memory.
    both = jax.lax.map(lambda weight: regression.prepare(log, weight), jnp.stack([log.weight, of_longer]))
    num_coefficients = log.features.shape[-1] + 1

    def advance(carry: tuple[Float[Array, "n T"], Float[Array, "K F"]], steps_to_go: Int[Array, ""]):
        value, centre = carry
        prepared = jax.tree.map(lambda each: each[jnp.where(steps_to_go > 1, 1, 0)], both)
        fit = regression.fit(prepared, log, of_successor(value), centre)
        found = fit._replace(coefficients=fit.coefficients[:, :num_coefficients])
        if end_action is None:
            return (regression.values(found, log), jnp.asarray(fit.coefficients)), found
        is_over, block = steps_to_go == 0, regression.block_of_action[end_action]
        of_end = partial(end_values, end_action=end_action, block=block)
        value = jax.lax.cond(is_over, of_end, regression.values, found, log)
        return (value, jnp.where(is_over, fit.coefficients[block], jnp.asarray(fit.coefficients))), found

    num_features = both.main.design.features.shape[-1]
    start = jnp.zeros_like(log.reward), jnp.zeros((regression.num_blocks, num_features), log.reward.dtype)
    first = 1 if end_action is None else 0
    _, fits = jax.lax.scan(advance, start, jnp.arange(first, horizon + 1))
    return jax.tree.map(lambda each: each[-horizon:], fits)


def end_values(fit: QFunctions, log: Transitions, end_action: int, block: Int[Array, ""]) -> Float[Array, "n T"]:
    """Q of the action that the horizon forces upon a path; 0 of what is no state."""
    of_block = jnp.asarray(fit.coefficients)[block]
    if log.choices is not None:
        forced = of_block[0] + log.choices.features @ of_block[1:]
        return largest_of_choices(jnp.where(log.choices.action == end_action, forced, -jnp.inf), log)
    forced = of_block[0] + jnp.asarray(log.features)[:, :, min(end_action, log.features.shape[2] - 1)] @ of_block[1:]
    return jnp.where(jnp.any(log.is_possible, axis=-1), forced, 0.0)


def bounded(
    fit: QFunctions, log: Transitions, block_of_action: Int[Array, " A"], pessimism: Float[Array, ""] | None
) -> Float[Array, "n T A"] | Float[Array, "C S"]:
    """Q of every action, or choice, by one fit; with pessimism, less so many standard errors, unless for a policy."""
    if log.choices is not None:
        q = q_of_choices(fit.coefficients, log.choices, block_of_action)
    else:
        q = q_values(jnp.asarray(fit.coefficients), log.features, block_of_action)
    if pessimism is None or fit.root is None or log.policy is not None:
        return q
    root = jnp.asarray(fit.root)
    if log.choices is not None:
        return q - pessimism * standard_errors_of_choices(root, log.choices, block_of_action)
    return q - pessimism * standard_errors(root, jnp.asarray(log.features), block_of_action)


def seen_weight(log: Transitions, weight: Any) -> Any:
    """Weight of the completed stages: what is imputed counts as nothing seen."""
    return weight if log.imputation is None else weight * log.imputation.outcome_weight


def _seen_control_variates(log: Transitions) -> Any:
    """Control variates of completed stages that went on; imputed targets hold only a share of each."""
    if log.control_variates is None:
        return None
    seen = jnp.where(log.is_last[..., None], 0.0, log.control_variates)
    return seen if log.imputation is None else seen * log.imputation.share[..., None]
