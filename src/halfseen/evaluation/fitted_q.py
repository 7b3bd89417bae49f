"""Fitted Q evaluation under censoring [Le2019]_: eq. 3 with the policy's own action in place of the best one.

One compiled function fits Q to many weightings of the same log: to all paths, and to all but each fold in turn. So no
path is judged by a Q that it shaped (*cross-fitting*), and how much the value changes from fold to fold tells its
standard error (the delete-a-group jackknife [Kott2001]_). Ĝ, and the distribution of durations behind imputed targets,
are those of the whole log: they have few parameters.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from halfseen.learners.q_learning.encoding import Encoding
from halfseen.learners.q_learning.least_squares import Rows, cross_of, design_of, factorise, gram_of, solve, waiting_for
from halfseen.learners.q_learning.q_learner import CensoredQLearner
from halfseen.learners.q_learning.recursion import Transitions, backward, q_values


class Judged(NamedTuple):
    """What a Q says of every stage of a log, for one weighting or for each of B."""

    value: Float[Any, "*B n T"]
    """V̂_t(S_t) = Σ_a π(a | S_t) Q̂_t(S_t, a)."""
    taken: Float[Any, "*B n T"]
    """Q̂_t(S_t, A_t)."""
    target: Float[Any, "*B n T"]
    """X_t = R_t + V̂_{t+1}(S_{t+1}), or Y_t where targets are imputed; 0 where there is none."""


@dataclass(frozen=True)
class Fitting:
    """How Q is fitted; what does not change between weightings.

    Parameters
    ----------
    options
        Of `backward`.
    regs
        The λ to choose from.
    blocks
        Block of coefficients of each action.
    """

    options: tuple[tuple[str, Any], ...]
    regs: Float[np.ndarray, " L"]
    blocks: Int[np.ndarray, " A"]

    def judge(
        self, log: Transitions, reward: Float[np.ndarray, "n T"], multiplicity: Float[np.ndarray, "B n"]
    ) -> Judged:
        """Fit Q to each weighting, and let it judge every path.

        Parameters
        ----------
        log
            The log, with the policy.
        reward
            As logged; those of `log` may have had noise taken out of them.
        multiplicity
            How often each path counts.
        """
        with jax.enable_x64(True):
            arrays = jax.tree.map(jnp.asarray, (log, reward, self.blocks, self.regs))
            # One after the other, each to its end: many small eigenproblems in flight have been seen to block for ever.
            each = [
                jax.block_until_ready(_judge(*arrays, jnp.asarray(one), options=self.options)) for one in multiplicity
            ]
            return Judged(*(np.stack([np.asarray(leaf) for leaf in leaves]) for leaves in zip(*each, strict=True)))


def fitting_of(model: CensoredQLearner, num_paths: int, num_actions: int) -> Fitting:
    """Read from a learner how it fits Q to a log of so many paths."""
    encoding: Encoding = model.encoding
    options = {
        "num_blocks": encoding.num_blocks,
        "stages": model.stages,
        "num_folds": model.num_folds_for(num_paths),
        "end_action": encoding.end_action if model.stages == "pooled" else None,
        "is_scaled": model.q_function == "linear",
    }
    return Fitting(tuple(options.items()), model.regs, encoding.block_of_action(num_actions))


@partial(jax.jit, static_argnames="options")
def _judge(
    log: Transitions,
    reward: Float[Array, "n T"],
    blocks: Int[Array, " A"],
    regs: Float[Array, " L"],
    counts: Float[Array, " n"],
    *,
    options: tuple[tuple[str, Any], ...],
) -> Judged:
    settings = dict(options)

    weighted = _counted(log, counts)
    by_stage = _by_stage(weighted, blocks, regs, settings)
    q = _q_of_stages(by_stage, log, blocks)
    value = _mean_over_actions(log, q)
    taken = jnp.take_along_axis(q, log.action[..., None], axis=2)[..., 0]
    after = _successor(value)
    target = _goes_on_with(log, reward, after)
    if log.imputation is not None:
        regress = _regressions_pooled if settings["stages"] == "pooled" else _regressions_by_stage
        fits = regress(weighted, by_stage, after, blocks, regs, settings)
        target = _imputed(log, fits, target, blocks)
    return Judged(value, taken, target)


def _counted(log: Transitions, counts: Float[Array, " n"]) -> Transitions:
    imputed = log.imputation
    if imputed is not None:
        imputed = imputed._replace(is_told=imputed.is_told * counts[:, None])
    return log._replace(weight=log.weight * counts[:, None], imputation=imputed)


def _by_stage(
    log: Transitions, blocks: Int[Array, " A"], regs: Float[Array, " L"], settings: dict[str, Any]
) -> Float[Array, "T K F"]:
    fitted = jnp.asarray(backward(log, blocks, regs, **settings).coefficients)
    return fitted if settings["stages"] == "separate" else fitted[::-1]


def _q_of_stages(by_stage: Float[Array, "T K F"], log: Transitions, blocks: Int[Array, " A"]) -> Float[Array, "n T A"]:
    return jax.vmap(q_values, in_axes=(0, 1, None), out_axes=1)(by_stage, jnp.asarray(log.features), blocks)


def _mean_over_actions(log: Transitions, q: Float[Array, "n T A"]) -> Float[Array, "n T"]:
    assert log.policy is not None
    return jnp.sum(log.policy * q, axis=-1)


def _successor(value: Float[Array, "n T"]) -> Float[Array, "n T"]:
    return jnp.concatenate([value[:, 1:], jnp.zeros_like(value[:, :1])], axis=1)


def _goes_on_with(log: Transitions, reward: Any, after: Float[Array, "n T"]) -> Float[Array, "n T"]:
    return jnp.asarray(reward) + jnp.where(log.is_last, 0.0, after)


def _regressions_by_stage(
    log: Transitions,
    by_stage: Float[Array, "T K F"],
    after: Float[Array, "n T"],
    blocks: Int[Array, " A"],
    regs: Float[Array, " L"],
    settings: dict[str, Any],
) -> Float[Array, "T K M"]:
    """M of each stage, from its own rows (see `learners.q_learning.imputation`)."""
    assert log.imputation is not None
    is_told = jnp.asarray(log.imputation.is_told)
    x, columns = _goes_on_with(log, log.reward, after), _columns(log)

    def of_stage(t: Int[Array, ""]) -> Float[Array, "K M"]:
        rows = Rows(columns[:, t], blocks[log.action[:, t]], is_told[:, t], jnp.asarray(log.fold))
        design = design_of(rows, settings["num_blocks"], settings["num_folds"])
        factor = factorise(gram_of(design), settings["is_scaled"])
        return solve(factor, cross_of(design, x[:, t]), regs, len(log.action)).coefficients

    return jax.lax.map(of_stage, jnp.arange(log.action.shape[1]))


def _regressions_pooled(
    log: Transitions,
    by_stage: Float[Array, "T K F"],
    after: Float[Array, "n T"],
    blocks: Int[Array, " A"],
    regs: Float[Array, " L"],
    settings: dict[str, Any],
) -> Float[Array, "T K M"]:
    """M for each number of steps to go, from the rows that the horizon did not end."""
    assert log.imputation is not None
    num_paths, horizon = log.action.shape
    end_action = settings["end_action"]
    goes_on = jnp.broadcast_to((jnp.arange(horizon) < horizon - 1) | (horizon == 1), log.action.shape)
    if end_action is not None:
        goes_on = goes_on | (log.action == end_action)
    rows = Rows(
        features=_columns(log).reshape(num_paths * horizon, -1),
        block=blocks[log.action].ravel(),
        weight=jnp.where(goes_on, log.imputation.is_told, 0.0).ravel(),
        fold=jnp.repeat(jnp.asarray(log.fold), horizon),
    )
    design = design_of(rows, settings["num_blocks"], settings["num_folds"])
    factor = factorise(waiting_for(by_stage, gram_of(design)), settings["is_scaled"])

    def of_stage(t: Int[Array, ""]) -> Float[Array, "K M"]:
        # With no step to go, what is left to come is what the forced end costs: Q_1 of the action that ends a path.
        q = q_values(by_stage[jnp.minimum(t + 1, horizon - 1)], jnp.asarray(log.features), blocks)
        forced = jnp.zeros_like(q[..., 0]) if end_action is None else q[..., end_action]
        value = jnp.where(t == horizon - 1, forced, _mean_over_actions(log, q))
        x = _goes_on_with(log, log.reward, _successor(value)).ravel()
        return solve(factor, cross_of(design, x), regs, num_paths).coefficients

    return jax.lax.map(of_stage, jnp.arange(horizon))


def _columns(log: Transitions) -> Float[Array, "n T P"]:
    """What m looks at: features of the action that was taken, and terms of the duration."""
    assert log.imputation is not None
    taken = jnp.take_along_axis(log.features, log.action[..., None, None], axis=2)[:, :, 0]
    return jnp.concatenate([taken * log.imputation.is_used, log.imputation.terms], axis=-1)


def _imputed(
    log: Transitions, fits: Float[Array, "T K M"], target: Float[Array, "n T"], blocks: Int[Array, " A"]
) -> Float[Array, "n T"]:
    """Y_t of every begun stage."""
    given = log.imputation
    assert given is not None
    num_terms = given.terms.shape[-1]
    each = fits[jnp.arange(log.action.shape[1]), blocks[log.action]]
    at_state = each[..., 0] + jnp.sum(each[..., 1:-num_terms] * _columns(log)[..., :-num_terms], axis=-1)
    of_time = jnp.sum(each[..., -num_terms:] * given.expected, axis=-1)
    return jnp.asarray(given.share * target + (1.0 - given.share) * at_state + of_time)


def jackknifed(value: Float[np.ndarray, "B n"], fold: Int[np.ndarray, " n"]) -> tuple[float, float]:
    """Value of the policy by Q̂ alone, and its standard error.

    Parameters
    ----------
    value
        V̂_1(S_1) of every path: by the Qs that were fitted without each fold, and last by that of all paths.
    fold
        Of each path.
    """
    num_folds = len(value) - 1
    without = np.array([value[k, fold != k].mean() for k in range(num_folds)])
    error = np.sqrt((num_folds - 1.0) / num_folds * np.sum((without - without.mean()) ** 2))
    return float(value[-1].mean()), float(error)
