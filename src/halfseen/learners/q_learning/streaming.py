"""Eq. 3 in passes over a log that need not fit in memory: Gram matrices of its parts add up.

Each backward step reads the log once, part by part, and keeps sums only, so what is learned is what the whole log in
memory would give, but for the rounding of the sums. The log itself is read and checked twice; after that its arrays are
read from disk, where they were kept (`kept_parts`).
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from halfseen.censoring.cut_model import fit_path_cuts
from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.fitting import in_float64
from halfseen.learners.q_learning.kept_parts import Parts, kept
from halfseen.learners.q_learning.least_squares import Fit, factorise, gram_of, solve
from halfseen.learners.q_learning.named_actions import NamedActions
from halfseen.learners.q_learning.q_model import QModel, refuse_all_cut, refuse_too_few
from halfseen.learners.q_learning.q_space import CrossValidation
from halfseen.learners.q_learning.recursion import Regression
from halfseen.learners.q_learning.targets import Unweighted, Weighted
from halfseen.learners.q_learning.task import Task
from halfseen.learners.q_learning.transitions import (
    QFunctions,
    StageMode,
    Transitions,
    goes_on,
    of_paths,
    of_successor,
    q_values,
    stage_of,
    state_values,
    target_of,
)
from halfseen.logs import Logs, LogStream
from halfseen.logs.columns import FINISHED
from halfseen.progress import Progress


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


def fit_stream(model: QModel, stream: LogStream) -> tuple[QModel, Float[np.ndarray, "n T"], QFunctions]:
    """Learn in passes over a log; the first pass gathers what Ĝ and the kernel need.

    Parameters
    ----------
    model
        How Q is fitted.
    stream
        The log.

    Returns
    -------
    tuple
        The model with what was fitted before Q, the weight of every stage in eq. 3, and Q.

    Raises
    ------
    ArgumentError
        A part of the model needs the whole log at once, or cannot be fitted.
    PositivityError
        All paths were cut, or a weight is not identified.
    """
    _refuse_whole(model)
    model, names, first = _first_pass(model, stream)
    finished = (stream.paths["ending"] == FINISHED).to_numpy(dtype=bool)
    if isinstance(model.targets, Weighted):
        ends = stream.paths["end_s"].to_numpy(), finished
        model = replace(
            model, cut_model=fit_path_cuts(*ends, first, names, model.targets.model, model.targets.truncate_at)
        )
    fold, weights = model.folds(stream.num_paths), []

    def parts() -> Iterator[Transitions]:
        start, weights[:] = 0, []
        for part in stream:
            paths = model.lay_out(part)
            weight, _ = model.weights_and_imputation(paths)
            weights.append(weight)
            yield model.weighted(paths, weight, None, fold[start : start + paths.num_paths])
            start += paths.num_paths

    with kept(parts, -(-stream.num_paths // stream.paths_at_once)) as read:
        q_functions = fit_parts(read, stream.num_paths, model)
    weight = np.concatenate(weights)
    if isinstance(model.reg, CrossValidation):
        refuse_too_few(weight)
    return model, weight, q_functions


def _refuse_whole(model: QModel) -> None:
    by = getattr(model.targets, "by", "path")
    needs = [
        model.task.needs_whole_log,
        None if isinstance(model.targets, Weighted | Unweighted) else f"censoring={type(model.targets).__name__}(…)",
        None if by == "path" else f"a model of the cuts by {by}",
        f"pessimism={model.pessimism:g}" if model.pessimism else None,
    ]
    for need in filter(None, needs):
        raise ArgumentError(
            f"{need} needs the whole log in memory, and a stream was given; learn from read_logs(folder), or choose "
            "weights on the clock of paths and a task that needs nothing of the whole log"
        )


def _first_pass(model: QModel, stream: LogStream) -> tuple[QModel, tuple[str, ...], Float[np.ndarray, "n P"]]:
    """Fit the task and the kernel, and gather the covariates with which paths begin."""
    refuse_all_cut((stream.paths["ending"] == FINISHED).to_numpy(dtype=bool))
    first, names, support = [], (), None
    for number, part in enumerate(stream):
        model.check_horizon(part)
        if number == 0:
            model = replace(model, task=_fitted_task(model, stream, part))
        paths = model.lay_out(part)
        model = model.with_kernel(paths) if number == 0 else model
        here = model.support_in(paths)
        support = here if support is None else support.plus(here)
        first.append(paths.clocks.covariates[:, 0])
        names = paths.clocks.covariate_names
    return replace(model, support=support), names, np.concatenate(first)


def _fitted_task(model: QModel, stream: LogStream, first: Logs) -> Task:
    """Learn what the features need from the first part; but what categories text has, from all of them."""
    if isinstance(model.task, NamedActions):
        return model.task.fitted_to_parts(stream)
    return model.task.fitted(first, model.horizon)


def fit_parts(parts: Parts, num_paths: int, model: QModel) -> QFunctions:
    """Run eq. 3 in float64 on a log that comes in parts: a pass for each backward step.

    Parameters
    ----------
    parts
        The log, each part laid out as the whole would be.
    num_paths
        n, of all parts together.
    model
        How Q is fitted. For pooled stages with an action that ends a path there is one more pass than stages.
    """
    options = model.options(num_paths)
    setting = _Setting(options.stages, options.num_blocks, options.num_folds, options.end_action)
    num_passes = model.horizon + (options.end_action is not None)
    with in_float64(), Progress(num_passes, "learn", "passes") as bar:

        def run(step: _Step | None, stage: int, **changed: Any) -> Fit:
            used = setting._replace(**changed)
            gram = cross = None
            for part in parts():
                here, at = (part, stage) if options.stages == "pooled" else _around(part, stage)
                log = jax.tree.map(jnp.asarray, here)
                blocks = jnp.asarray(model.task.block_of_action(part.is_possible.shape[-1]))
                if step is None:
                    step = _first(log, options.num_blocks)
                sums = _sums(log, blocks, step._replace(stage=jnp.asarray(at)), used)
                gram, cross = sums if gram is None else (gram + sums[0], cross + sums[1])
            bar.update()
            assert gram is not None
            assert cross is not None
            assert step is not None
            fit = _solved(gram, cross, jnp.asarray(model.regs), num_paths, options.is_scaled)
            return Fit(fit.coefficients + step.centre, fit.reg)

        fits = _pooled(run, parts, model) if options.stages == "pooled" else _separate(run, model.horizon)
    return QFunctions(*(np.stack([np.asarray(leaf) for leaf in leaves]) for leaves in zip(*fits, strict=True)))


def _separate(run: Any, horizon: int) -> list[Fit]:
    fits, step = [], None
    for stage in reversed(range(horizon)):
        fit = run(step, stage)
        fits.insert(0, fit)
        step = _Step(jnp.asarray(stage), fit.coefficients, jnp.asarray(1.0), jnp.zeros_like(fit.coefficients))
    return fits


def _pooled(run: Any, parts: Parts, model: QModel) -> list[Fit]:
    step, end_action = None, model.task.end_action
    if end_action is not None:
        ended = run(None, 0).coefficients
        num_actions = next(parts()).is_possible.shape[-1]
        block = int(model.task.block_of_action(num_actions)[end_action])
        centre = jnp.broadcast_to(ended[block], ended.shape)
        step = _Step(jnp.asarray(0), ended, jnp.asarray(1.0), centre)
    fits = [run(step, 0, is_end_value=end_action is not None)]
    for _ in range(model.horizon - 1):
        before = fits[-1].coefficients
        fits.append(run(_Step(jnp.asarray(0), before, jnp.asarray(1.0), before), 0, only_going_on=True))
    return fits


def _around(log: Transitions, stage: int) -> tuple[Transitions, int]:
    """Keep a stage and the next one, which is all that a step looks at, and tell where in that the stage is."""
    first = max(min(stage, log.action.shape[1] - 2), 0)
    rows = of_paths(lambda leaf: leaf[:, first : first + 2], log._replace(fold=None))
    return rows._replace(fold=log.fold), stage - first


def _first(log: Transitions, num_blocks: int) -> _Step:
    zeros = jnp.zeros((num_blocks, log.features.shape[-1] + 1))
    return _Step(jnp.asarray(0), zeros, jnp.asarray(0.0), zeros)


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
