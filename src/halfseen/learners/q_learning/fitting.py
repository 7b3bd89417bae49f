"""Eq. 3 run on one log or on a batch, in float64, whatever the precision elsewhere."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from halfseen.arrays import on_device
from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.judging import Judged, judged
from halfseen.learners.q_learning.packing import num_rows, packed
from halfseen.learners.q_learning.recursion import backward
from halfseen.learners.q_learning.room import padded, with_room
from halfseen.learners.q_learning.transitions import AnyArray, QFunctions, StageMode, Transitions
from halfseen.workers.threads import one_thread


@contextmanager
def in_float64() -> Iterator[None]:
    """Compute in double precision, whatever it is elsewhere, and with one thread of LAPACK."""
    with jax.enable_x64(True), one_thread():
        yield


class BackwardOptions(NamedTuple):
    """What `backward` is compiled for."""

    num_blocks: int
    stages: StageMode
    num_folds: int
    end_action: int | None
    is_scaled: bool


def fit_q_functions(
    log: Transitions,
    blocks: Int[np.ndarray, " A"],
    regs: Float[np.ndarray, " L"],
    options: BackwardOptions,
    pessimism: float = 0.0,
    fewest_rows: int = 0,
) -> QFunctions:
    """Run the recursion on one log, or on a batch of logs if the arrays have a leading axis for it.

    Parameters
    ----------
    log
        The log, or the batch.
    blocks
        Block of coefficients of each action.
    regs
        The λ to choose from.
    options
        The rest.
    pessimism
        Standard errors by which Q is lowered wherever the largest is sought; 0 for eq. 3 as it is.
    fewest_rows
        There is room for so many, where the rows of all stages are pooled (`packing.packed`).

    Raises
    ------
    ArgumentError
        A path is in a fold that does not exist, and would count for nothing.
    """
    largest = int(np.asarray(log.fold).max())
    if largest >= options.num_folds:
        raise ArgumentError(
            f"fold {largest} of {options.num_folds}: folds are 0 to {options.num_folds - 1}; deal the paths anew"
        )
    more: dict[str, Any] = options._asdict()
    if log.action.ndim == 3:
        fit, ready = backward_batch, log
    elif options.stages == "pooled":
        fit, ready = backward, packed(log, options.end_action, blocks, fewest_rows)
        more["horizon"] = log.action.shape[1]
    else:
        fit, ready = backward, with_room(log)
    with in_float64():
        if pessimism:
            more["pessimism"] = jnp.asarray(pessimism)
        return jax.tree.map(np.asarray, fit(ready, blocks, regs, **more))


@partial(jax.jit, static_argnames=BackwardOptions._fields)
def backward_batch(log: Transitions, blocks: jax.Array, regs: jax.Array, **options) -> QFunctions:
    """Fit a batch of logs in one compiled call; logs of the same states may share features, which have no axis then."""
    is_shared = log.features.ndim == log.is_possible.ndim
    axes = jax.tree.map(lambda _: 0, log)._replace(features=None if is_shared else 0)
    return jax.vmap(lambda one: backward(one, blocks, regs, **options), in_axes=(axes,))(log)


def fit_and_judge(
    log: Transitions,
    reward: Float[np.ndarray, "n T"],
    multiplicity: Float[np.ndarray, "B n"],
    blocks: Int[np.ndarray, " A"],
    regs: Float[np.ndarray, " L"],
    options: BackwardOptions,
) -> Judged:
    """Fit Q to each of B weightings of a log, and let it judge every path.

    Parameters
    ----------
    log
        The log.
    reward
        As logged; those of `log` may have had noise taken out of them.
    multiplicity
        How often each path counts.
    blocks, regs, options
        As for `fit_q_functions`.
    """
    num_paths = len(log.action)
    room = num_rows(log)
    fits = [fit_q_functions(counted(log, counts), blocks, regs, options, fewest_rows=room) for counts in multiplicity]
    with in_float64():
        arrays = on_device((with_room(log), padded(reward, num_paths), blocks))
        each = [jax.tree.map(np.asarray, _judged(fit, *arrays, stages=options.stages)) for fit in fits]
    return Judged(*(np.stack([leaf[:num_paths] for leaf in leaves]) for leaves in zip(*each, strict=True)))


@partial(jax.jit, static_argnames="stages")
def _judged(fits: QFunctions, log: Transitions, reward: jax.Array, blocks: jax.Array, stages: StageMode) -> Judged:
    return judged(fits, log, blocks, stages, reward)


def counted(log: Transitions, counts: Float[AnyArray, " n"]) -> Transitions:
    """Let each path of a log count so often."""
    imputed = log.imputation
    if imputed is not None:
        imputed = imputed._replace(outcome_weight=imputed.outcome_weight * counts[:, None])
    return log._replace(weight=log.weight * counts[:, None], imputation=imputed)
