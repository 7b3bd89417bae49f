"""Eq. 3 in passes over a log that need not fit in memory: Gram matrices of its parts add up.

Each backward step reads the log once, part by part, and keeps sums only, so what is learned is what the whole log in
memory would give, but for the rounding of the sums.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from tqdm import tqdm

from halfseen.learners.q_learning.encoding import Encoding
from halfseen.learners.q_learning.least_squares import Fit, factorise, gram_of, solve
from halfseen.learners.q_learning.recursion import (
    QFunctions,
    Regression,
    StageMode,
    Transitions,
    goes_on,
    of_successor,
    q_values,
    stage_of,
    state_values,
    target_of,
)

Parts = Callable[[], Iterator[Transitions]]
"""Reads the log once more, from its beginning."""


class _Step(NamedTuple):
    """One backward step: which rows, which successor, which centre."""

    stage: Int[Array, ""]
    """For separate stages, the one that is fitted."""
    after: Float[Array, "K F"]
    """Coefficients of the successor's Q."""
    has_after: Float[Array, ""]
    """0 in the first step, where nothing follows."""
    centre: Float[Array, "K F"]


class _Setting(NamedTuple):
    """What the compiled sums depend on."""

    stages: StageMode
    num_blocks: int
    num_folds: int
    end_action: int | None
    is_end_value: bool = False
    """Whether the value of a state is Q of the end action."""
    only_going_on: bool = False


def fit_stream(
    parts: Parts,
    num_paths: int,
    encoding: Encoding,
    regs: Float[np.ndarray, " L"],
    stages: StageMode,
    num_folds: int,
    horizon: int,
    is_scaled: bool = True,
) -> QFunctions:
    """Run eq. 3 in float64 on a log that comes in parts.

    Parameters
    ----------
    parts
        The log, each part laid out as the whole would be.
    num_paths
        n, of all parts together.
    encoding, regs, stages, num_folds, is_scaled
        As for `fit_q_functions`.
    horizon
        T: a backward step, and a pass, for each; one more for pooled stages with an action that ends a path.
    """
    end_action = encoding.end_action if stages == "pooled" else None
    setting = _Setting(stages, encoding.num_blocks, num_folds, end_action)
    num_passes = horizon + (end_action is not None)
    with jax.enable_x64(True), tqdm(total=num_passes, desc="learn", disable=None, leave=False) as progress:

        def run(step: _Step | None, stage: int, **changed: Any) -> Fit:
            used = setting._replace(**changed)
            gram = cross = None
            for part in parts():
                log = jax.tree.map(jnp.asarray, part)
                blocks = jnp.asarray(encoding.block_of_action(part.is_possible.shape[-1]))
                if step is None:
                    step = _first(log, encoding.num_blocks, stage)
                sums = _sums(log, blocks, step._replace(stage=jnp.asarray(stage)), used)
                gram, cross = sums if gram is None else (gram + sums[0], cross + sums[1])
            progress.update()
            assert gram is not None
            assert cross is not None
            assert step is not None
            fit = _solved(gram, cross, jnp.asarray(regs), num_paths, is_scaled)
            return Fit(fit.coefficients + step.centre, fit.reg)

        fit_all = _pooled if stages == "pooled" else _separate
        fits = fit_all(run, horizon, end_action, encoding)
    return QFunctions(*(np.stack([np.asarray(leaf) for leaf in leaves]) for leaves in zip(*fits, strict=True)))


def _separate(run: Any, horizon: int, end_action: int | None, encoding: Encoding) -> list[Fit]:
    fits, step = [], None
    for stage in reversed(range(horizon)):
        fit = run(step, stage)
        fits.insert(0, fit)
        step = _Step(jnp.asarray(stage), fit.coefficients, jnp.asarray(1.0), jnp.zeros_like(fit.coefficients))
    return fits


def _pooled(run: Any, horizon: int, end_action: int | None, encoding: Encoding) -> list[Fit]:
    step = None
    if end_action is not None:
        ended = run(None, 0).coefficients
        # Any number of actions of a table has the same blocks; FINISH is the first.
        block = int(encoding.block_of_action(1 + 2)[end_action])
        centre = jnp.broadcast_to(ended[block], ended.shape)
        step = _Step(jnp.asarray(0), ended, jnp.asarray(1.0), centre)
    fits = [run(step, 0, is_end_value=end_action is not None)]
    for _ in range(horizon - 1):
        before = fits[-1].coefficients
        fits.append(run(_Step(jnp.asarray(0), before, jnp.asarray(1.0), before), 0, only_going_on=True))
    return fits


def _first(log: Transitions, num_blocks: int, stage: int) -> _Step:
    zeros = jnp.zeros((num_blocks, log.features.shape[-1] + 1))
    return _Step(jnp.asarray(stage), zeros, jnp.asarray(0.0), zeros)


@partial(jax.jit, static_argnames="setting")
def _sums(
    log: Transitions, block_of_action: Int[Array, " A"], step: _Step, setting: _Setting
) -> tuple[Float[Array, "V K F F"], Float[Array, "V K F"]]:
    """Σ w x xᵀ and Σ w x y of one part."""
    regs = jnp.zeros(1)
    regression = Regression(block_of_action, regs, setting.num_blocks, setting.num_folds, log.action.shape[0], True)
    if setting.is_end_value and setting.end_action is not None:
        value = q_values(step.after, log.features, block_of_action)[..., setting.end_action]
    else:
        value = state_values(step.after, log, block_of_action)
    successor = of_successor(value) * step.has_after
    rows = log._replace(weight=jnp.where(goes_on(log, setting.end_action), log.weight, 0.0))
    rows = rows if setting.only_going_on else log
    if setting.stages == "separate":
        rows, successor = stage_of(log, step.stage), jax.lax.dynamic_slice_in_dim(successor, step.stage, 1, axis=1)
    design = regression.design(rows, rows.weight)
    return gram_of(design), regression.cross(design, rows, target_of(rows, successor).ravel(), step.centre)


@partial(jax.jit, static_argnames=("num_paths", "is_scaled"))
def _solved(
    gram: Float[Array, "V K F F"],
    cross: Float[Array, "V K F"],
    regs: Float[Array, " L"],
    num_paths: int,
    is_scaled: bool,
) -> Fit:
    return solve(factorise(gram, is_scaled), cross, regs, num_paths)
