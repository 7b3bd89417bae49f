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
from halfseen.programs import kept_jit


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
    is_pessimistic: bool
    is_end_value: bool = False
    """Whether the value of a state is Q of the end action."""
    only_going_on: bool = False


class OutcomeGrams(NamedTuple):
    """Of imputed targets: the regression of X, and how Σ w x Y depends on its coefficients."""

    gram: Float[Array, "V K M M"]
    of_state: Float[Array, "V K F M1"]
    """Σ w x (1 − share) xᵀ, for the coefficients of the features."""
    of_time: Float[Array, "V K F G"]
    """Σ w x expectedᵀ, for those of the terms."""


class SeenGrams(NamedTuple):
    """Of the completed stages, for pessimism."""

    gram: Float[Array, "K F F"]
    weights: WeightSums


class Grams(NamedTuple):
    """Sums that no target changes."""

    main: Float[Array, "V K F F"]
    outcome: OutcomeGrams | None
    seen: SeenGrams | None


class SeenCrosses(NamedTuple):
    """Of the completed stages: Σ w x X and Σ w X²."""

    cross: Float[Array, "K F"]
    square: Float[Array, " K"]


class Crosses(NamedTuple):
    """Sums that depend on the targets X."""

    main: Float[Array, "V K F"]
    """Of X, or of its share in imputed targets, less what the centre says."""
    outcome: Float[Array, "V K M"] | None
    seen: SeenCrosses | None


class StepFit(NamedTuple):
    """Q of one step."""

    q: QFunctions
    coefficients: Float[Array, "K F"]
    """Those of control variates, which Q leaves out, come last."""


@partial(kept_jit, static_argnames="setting")
def grams_of(log: Transitions, block_of_action: Int[Array, " A"], stage: Int[Array, ""], setting: Setting) -> Grams:
    """Sum up what no target changes over the rows of one part.

    Parameters
    ----------
    log
        The part.
    block_of_action
        Block of each action.
    stage
        For separate stages, which one.
    setting
        The rest.
    """
    regression, rows = _regression(log, block_of_action, setting), _rows(log, stage, setting)
    design, outcome, seen = regression.design(rows, rows.weight), None, None
    if rows.imputation is not None:
        of_outcome, given = regression.outcome_design(rows, rows.weight), rows.imputation
        num_terms, rest = given.terms.shape[-1], (1.0 - jnp.asarray(given.share)).ravel()[:, None]
        outcome = OutcomeGrams(
            gram=gram_of(of_outcome),
            of_state=moment_of(design, rest * of_outcome.features[:, :-num_terms]),
            of_time=moment_of(design, jnp.asarray(given.expected).reshape(-1, num_terms)),
        )
    if setting.is_pessimistic:
        of_seen = design.weighing(seen_weight(rows, rows.weight).ravel())
        seen = SeenGrams(gram_of(of_seen).sum(axis=0), weight_sums(of_seen))
    return Grams(gram_of(design), outcome, seen)


@partial(kept_jit, static_argnames="setting")
def crosses_of(
    log: Transitions,
    block_of_action: Int[Array, " A"],
    step: Step,
    pessimism: Float[Array, ""],
    setting: Setting,
) -> Crosses:
    """Sum up what depends on the targets over the rows of one part.

    Parameters
    ----------
    log
        The part.
    block_of_action
        Block of each action.
    step
        The step.
    pessimism
        Standard errors by which Q is lowered wherever the largest is sought, if it is.
    setting
        The rest.
    """
    regression = _regression(log, block_of_action, setting, pessimism)
    successor = of_successor(_value(log, regression, step, setting)) * step.has_after
    rows = _rows(log, step.stage, setting)
    if setting.options.stages == "separate":
        successor = jax.lax.dynamic_slice_in_dim(successor, step.stage, 1, axis=1)
    design, target = regression.design(rows, rows.weight), target_of(rows, successor)
    share, outcome, seen = target, None, None
    if rows.imputation is not None:
        share = jnp.asarray(rows.imputation.share) * target
        outcome = cross_of(regression.outcome_design(rows, rows.weight), target.ravel())
    if setting.is_pessimistic:
        of_seen, x = design.weighing(seen_weight(rows, rows.weight).ravel()), target.ravel()
        seen = SeenCrosses(cross_of(of_seen, x).sum(axis=0), by_block(of_seen.weight * x**2, of_seen))
    return Crosses(regression.cross(design, rows, share.ravel(), step.centre), outcome, seen)


def _regression(
    log: Transitions, block_of_action: Int[Array, " A"], setting: Setting, pessimism: Float[Array, ""] | None = None
) -> Regression:
    num_blocks, _, num_folds, _, is_scaled = setting.options
    margin = pessimism if setting.is_pessimistic else None
    return Regression(block_of_action, jnp.zeros(1), num_blocks, num_folds, log.action.shape[0], is_scaled, margin)


def _rows(log: Transitions, stage: Int[Array, ""], setting: Setting) -> Transitions:
    if setting.only_going_on:
        log = log._replace(weight=jnp.where(goes_on(log, setting.options.end_action), log.weight, 0.0))
    return stage_of(log, stage) if setting.options.stages == "separate" else log


def _value(log: Transitions, regression: Regression, step: Step, setting: Setting) -> Float[Array, "n T"]:
    end_action = setting.options.end_action
    if setting.is_end_value and end_action is not None:
        return end_values(step.after, log, end_action, regression.block_of_action[end_action])
    return regression.values(step.after, log)


@partial(kept_jit, static_argnames=("num_paths", "is_scaled", "num_features"))
def solved(
    grams: Grams,
    crosses: Crosses,
    centre: Float[Array, "K F"],
    regs: Float[Array, " L"],
    num_paths: int,
    is_scaled: bool,
    num_features: int,
) -> StepFit:
    """Fit Q to the sums of all parts.

    Parameters
    ----------
    grams, crosses
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
    factor, cross, outcome = factorise(grams.main, is_scaled), crosses.main, None
    last = factor.eigenvalues
    if grams.outcome is not None and crosses.outcome is not None:
        num_terms = grams.outcome.of_time.shape[-1]
        of_outcome = factorise(waiting_for(last, with_prior(grams.outcome.gram, num_terms)), is_scaled)
        outcome, last = solve(of_outcome, crosses.outcome, regs, num_paths).coefficients, of_outcome.eigenvalues
        cross = cross + jnp.einsum("vkfm,km->vkf", grams.outcome.of_state, outcome[:, :-num_terms])
        cross = cross + jnp.einsum("vkfg,kg->vkf", grams.outcome.of_time, outcome[:, -num_terms:])
    fit = solve(factor, cross, regs, num_paths)
    coefficients = fit.coefficients + centre
    found = QFunctions(coefficients[:, :num_features], fit.reg, outcome)
    if grams.seen is None or crosses.seen is None:
        return StepFit(found, coefficients)
    gram = waiting_for(last, grams.seen.gram[None, :, :num_features, :num_features])
    squares = _squared_residuals(grams.seen, crosses.seen, coefficients)
    root = roots(Spread(factorise(gram, is_scaled), grams.seen.weights), fit.reg, num_paths, squares)
    return StepFit(found._replace(root=root), coefficients)


def _squared_residuals(grams: SeenGrams, crosses: SeenCrosses, coefficients: Float[Array, "K F"]) -> Float[Array, " K"]:
    """Σ w (X − βᵀx)² of the completed stages."""
    explained = 2.0 * jnp.sum(coefficients * crosses.cross, axis=-1)
    quadratic = jnp.einsum("kf,kfg,kg->k", coefficients, grams.gram, coefficients)
    return jnp.maximum(crosses.square - explained + quadratic, 0.0)
