"""One backward step of eq. 3 as sums over rows, which those of the parts of a log add up to, and Q by these alone.

An imputed target Y is linear in the coefficients of the regression of X (see `transitions.Imputation`), which are known
only once all parts were read. So Σ w x Y is kept as what it is of the share of X, and what it is for each coefficient.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.learners.q_learning.fitting import BackwardOptions
from halfseen.learners.q_learning.least_squares import (
    Design,
    cross_of,
    factorise,
    gram_of,
    moment_of,
    solve,
    waiting_for,
    with_prior,
)
from halfseen.learners.q_learning.recursion import Regression, end_values, seen_weight
from halfseen.learners.q_learning.spread import Spread, WeightSums, by_block, roots, weight_sums
from halfseen.learners.q_learning.transitions import (
    QFunctions,
    Transitions,
    goes_on,
    of_successor,
    stage_of,
    target_of,
)


class Step(NamedTuple):
    """One backward step: which rows, which successor, which centre."""

    stage: Int[Array, ""]
    """For separate stages, the one that is fitted."""
    after: QFunctions
    """Of the successor."""
    has_after: Float[Array, ""]
    """0 in the first step, where nothing follows."""
    centre: Float[Array, "K F"]
    """What coefficients are shrunk towards, those of control variates among them."""


class Setting(NamedTuple):
    """What the compiled sums depend on."""

    options: BackwardOptions
    is_end_value: bool = False
    """Whether the value of a state is Q of the end action."""
    only_going_on: bool = False


class OutcomeSums(NamedTuple):
    """Of imputed targets: the regression of X, and how Σ w x Y depends on its coefficients."""

    gram: Float[Array, "V K M M"]
    cross: Float[Array, "V K M"]
    of_state: Float[Array, "V K F M1"]
    """Σ w x (1 − share) xᵀ, for the coefficients of the features."""
    of_time: Float[Array, "V K F G"]
    """Σ w x expectedᵀ, for those of the terms."""


class SeenSums(NamedTuple):
    """Of the completed stages, for pessimism."""

    gram: Float[Array, "K F F"]
    cross: Float[Array, "K F"]
    square: Float[Array, " K"]
    """Σ w X²."""
    weights: WeightSums


class StepSums(NamedTuple):
    """All that a step needs of the rows."""

    gram: Float[Array, "V K F F"]
    cross: Float[Array, "V K F"]
    """Of the targets, or of the share of X in them, less what the centre says."""
    outcome: OutcomeSums | None
    seen: SeenSums | None


class StepFit(NamedTuple):
    """Q of one step."""

    q: QFunctions
    coefficients: Float[Array, "K F"]
    """Those of control variates, which Q leaves out, come last."""


@partial(jax.jit, static_argnames="setting")
def step_sums(
    log: Transitions,
    block_of_action: Int[Array, " A"],
    step: Step,
    pessimism: Float[Array, ""] | None,
    setting: Setting,
) -> StepSums:
    """Sum up the rows of one part.

    Parameters
    ----------
    log
        The part.
    block_of_action
        Block of each action.
    step
        The step.
    pessimism
        Standard errors by which Q is lowered wherever the largest is sought; None for eq. 3 as it is.
    setting
        The rest.
    """
    options = setting.options
    regs = jnp.zeros(1)
    regression = Regression(
        block_of_action, regs, options.num_blocks, options.num_folds, log.action.shape[0], options.is_scaled, pessimism
    )
    successor = of_successor(_value(log, regression, step, setting)) * step.has_after
    rows = log
    if setting.only_going_on:
        rows = log._replace(weight=jnp.where(goes_on(log, options.end_action), log.weight, 0.0))
    if options.stages == "separate":
        rows, successor = stage_of(log, step.stage), jax.lax.dynamic_slice_in_dim(successor, step.stage, 1, axis=1)
    design, target = regression.design(rows, rows.weight), target_of(rows, successor)
    share = target if rows.imputation is None else jnp.asarray(rows.imputation.share) * target
    return StepSums(
        gram=gram_of(design),
        cross=regression.cross(design, rows, share.ravel(), step.centre),
        outcome=None if rows.imputation is None else _outcome_sums(rows, regression, design, target),
        seen=None if pessimism is None else _seen_sums(rows, design, target),
    )


def _value(log: Transitions, regression: Regression, step: Step, setting: Setting) -> Float[Array, "n T"]:
    end_action = setting.options.end_action
    if setting.is_end_value and end_action is not None:
        return end_values(step.after, log, end_action, regression.block_of_action[end_action])
    return regression.values(step.after, log)


def _outcome_sums(
    rows: Transitions, regression: Regression, design: Design, target: Float[Array, "n T"]
) -> OutcomeSums:
    assert rows.imputation is not None
    outcome = regression.outcome_design(rows, rows.weight)
    num_terms = rows.imputation.terms.shape[-1]
    rest = (1.0 - jnp.asarray(rows.imputation.share)).ravel()[:, None]
    return OutcomeSums(
        gram=gram_of(outcome),
        cross=cross_of(outcome, target.ravel()),
        of_state=moment_of(design, rest * outcome.features[:, :-num_terms]),
        of_time=moment_of(design, jnp.asarray(rows.imputation.expected).reshape(-1, num_terms)),
    )


def _seen_sums(rows: Transitions, design: Design, target: Float[Array, "n T"]) -> SeenSums:
    seen, each = design.weighing(seen_weight(rows, rows.weight).ravel()), target.ravel()
    return SeenSums(
        gram=gram_of(seen).sum(axis=0),
        cross=cross_of(seen, each).sum(axis=0),
        square=by_block(seen.weight * each**2, seen),
        weights=weight_sums(seen),
    )


@partial(jax.jit, static_argnames=("num_paths", "is_scaled", "num_features"))
def solved(
    sums: StepSums,
    centre: Float[Array, "K F"],
    regs: Float[Array, " L"],
    num_paths: int,
    is_scaled: bool,
    num_features: int,
) -> StepFit:
    """Fit Q to the sums of all parts.

    Parameters
    ----------
    sums
        Of all parts.
    centre
        That of the step.
    regs
        The λ to choose from.
    num_paths
        n, of all parts together.
    is_scaled
        Whether λ weighs features as if each had unit variance.
    num_features
        Of Q, the offset among them; what comes after it are control variates.
    """
    factor, cross, outcome = factorise(sums.gram, is_scaled), sums.cross, None
    last = factor.eigenvalues
    if sums.outcome is not None:
        num_terms = sums.outcome.of_time.shape[-1]
        of_outcome = factorise(waiting_for(last, with_prior(sums.outcome.gram, num_terms)), is_scaled)
        outcome, last = solve(of_outcome, sums.outcome.cross, regs, num_paths).coefficients, of_outcome.eigenvalues
        cross = cross + jnp.einsum("vkfm,km->vkf", sums.outcome.of_state, outcome[:, :-num_terms])
        cross = cross + jnp.einsum("vkfg,kg->vkf", sums.outcome.of_time, outcome[:, -num_terms:])
    fit = solve(factor, cross, regs, num_paths)
    coefficients = fit.coefficients + centre
    found = QFunctions(coefficients[:, :num_features], fit.reg, outcome)
    if sums.seen is None:
        return StepFit(found, coefficients)
    gram = waiting_for(last, sums.seen.gram[None, :, :num_features, :num_features])
    spread = Spread(factorise(gram, is_scaled), sums.seen.weights)
    root = roots(spread, fit.reg, num_paths, _squared_residuals(sums.seen, coefficients))
    return StepFit(found._replace(root=root), coefficients)


def _squared_residuals(seen: SeenSums, coefficients: Float[Array, "K F"]) -> Float[Array, " K"]:
    """Σ w (X − βᵀx)²."""
    explained = 2.0 * jnp.sum(coefficients * seen.cross, axis=-1)
    quadratic = jnp.einsum("kf,kfg,kg->k", coefficients, seen.gram, coefficients)
    return jnp.maximum(seen.square - explained + quadratic, 0.0)
