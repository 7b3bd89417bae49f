"""Eq. 3 in passes over a log that need not fit in memory: the sums of its parts add up.

Each backward step reads the log once, part by part, and keeps sums only, so what is learned is what the whole log in
memory would give, but for the rounding of the sums. What is no sum is fitted to the same sample of paths as in memory
(`sample`). The log itself is read and checked a few times; after that its arrays are read from disk, where they were
kept (`kept_parts`).
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from halfseen.censoring.stage_clocks import stacked
from halfseen.learners.q_learning.fitting import in_float64
from halfseen.learners.q_learning.kept_parts import Parts, kept
from halfseen.learners.q_learning.path_arrays import PathArrays
from halfseen.learners.q_learning.q_model import QModel, refuse_all_cut, refuse_too_few
from halfseen.learners.q_learning.q_space import CrossValidation
from halfseen.learners.q_learning.sample import sampled
from halfseen.learners.q_learning.stage_choice import with_stages
from halfseen.learners.q_learning.step_sums import Grams, Setting, Step, StepFit, crosses_of, grams_of, solved
from halfseen.learners.q_learning.task import RewardedStages
from halfseen.learners.q_learning.transitions import QFunctions, Transitions, of_paths
from halfseen.logs import Logs, LogStream
from halfseen.logs.joining import joined
from halfseen.progress import Progress


def fit_stream(
    model: QModel, stream: LogStream, has_choice: bool = False
) -> tuple[QModel, Float[np.ndarray, "n T"], QFunctions, tuple[str, ...]]:
    """Learn in passes over a log; the first pass gathers what Ĝ needs, and a sample of the paths.

    Parameters
    ----------
    model
        How Q is fitted.
    stream
        The log.
    has_choice
        Whether stages are to be pooled is for the log to say (see `stage_choice`).

    Returns
    -------
    tuple
        The model with what was fitted before Q, the weight of every stage in eq. 3, Q, and what was chosen by itself.

    Raises
    ------
    ArgumentError
        A part of the model cannot be fitted.
    PositivityError
        All paths were cut, or a weight is not identified.
    """
    model, sample = _first_pass(model, stream)
    model, chosen = with_stages(model, sample) if has_choice else (model, model.chosen)
    model = replace(model, task=model.task.fitted_to_rewards(_rewarded(model, stream)))
    fold, weights = model.folds(stream.num_paths), []

    def parts() -> Iterator[Transitions]:
        start, weights[:] = 0, []
        for part in stream:
            paths = model.lay_out(part)
            weight, imputed = model.weights_and_imputation(paths)
            weights.append(weight)
            yield model.weighted(paths, weight, imputed, fold[start : start + paths.num_paths])
            start += paths.num_paths

    with kept(parts, -(-stream.num_paths // stream.paths_at_once)) as read:
        q_functions = fit_parts(read, stream.num_paths, model)
    weight = np.concatenate(weights)
    if isinstance(model.reg, CrossValidation):
        refuse_too_few(weight)
    return model, weight, q_functions, chosen


def _first_pass(model: QModel, stream: LogStream) -> tuple[QModel, PathArrays]:
    """Fit what comes before Q: what is a sum to all paths, the rest to a sample, which is returned."""
    refuse_all_cut(stream.is_finished)
    sample = sample_of(stream, model.random_state)
    model = model.with_task(stream, sample)
    support, clocks, by_path = None, [], getattr(model.targets, "by", "path") == "path"
    for part in stream:
        model.check_horizon(part)
        paths = model.lay_out(part)
        here = model.support_in(paths)
        support = here if support is None else support.plus(here)
        # On the clock of paths, Ĝ looks at how each began alone.
        clocks.append(paths.clocks.begun() if by_path else paths.clocks)
    model = replace(model, support=support, cut_model=model.targets.fit_cuts(stacked(clocks)))
    looked_at = model.lay_out(sample)
    return model.with_kernel(looked_at).with_behaviour(looked_at).with_durations(looked_at), looked_at


def _rewarded(model: QModel, stream: LogStream) -> Iterator[RewardedStages]:
    """What the stages of a log paid; nothing is read unless it is asked for."""
    for part in stream:
        paths = model.lay_out(part)
        yield model.rewarded(paths, model.targets.weights(paths, model.cut_model))


def sample_of(stream: LogStream, seed: int, most: int | None = None) -> Logs:
    """Read some of the paths; by default those that `QModel.sample_of` takes of a log in memory."""
    rows, start, found = sampled(stream.num_paths, seed, most), 0, []
    for part in stream:
        here = rows[(rows >= start) & (rows < start + part.num_paths)] - start
        if len(here):
            found.append(part.select(part.path_ids[here]))
        start += part.num_paths
    return joined(found)


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
    is_pooled = model.stages == "pooled"
    num_passes = model.horizon + (is_pooled and model.task.end_action is not None)
    with in_float64(), Progress(num_passes, "learn", "passes") as bar:
        passes = _Passes(parts, num_paths, model, bar.update)
        fits = _pooled(passes) if is_pooled else _separate(passes)
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *(fit.q for fit in fits))


class _Passes:
    """One backward step after the other, each by a pass over the parts."""

    def __init__(self, parts: Parts, num_paths: int, model: QModel, on_pass: Callable[[], object]) -> None:
        self.parts, self.num_paths, self.model, self._on_pass = parts, num_paths, model, on_pass
        self._options = model.options(num_paths)
        self._grams: dict[bool, Grams] = {}

    def fit(self, step: Step | None, stage: int = 0, **changed: bool) -> StepFit:
        """Fit one step; None is the first, which nothing follows."""
        setting, is_pooled = Setting(self._options, self.model.pessimism > 0, **changed), self.model.stages == "pooled"
        # The rows of pooled stages are the same at each step, but for those that the horizon ended.
        known = self._grams.get(setting.only_going_on) if is_pooled else None
        grams, crosses, num_features = known, None, 0
        for part in self.parts():
            rows, at = (part, 0) if is_pooled else _around(part, stage)
            log = jax.tree.map(jnp.asarray, rows)
            blocks = jnp.asarray(self.model.blocks(part.is_possible.shape[-1]))
            step, num_features = step or _first(log, self._options.num_blocks), log.features.shape[-1] + 1
            here = step._replace(stage=jnp.asarray(at))
            crosses = _plus(crosses, crosses_of(log, blocks, here, jnp.asarray(self.model.pessimism), setting))
            if known is None:
                grams = _plus(grams, grams_of(log, blocks, here.stage, setting))
        self._on_pass()
        assert step is not None
        assert grams is not None
        self._grams[setting.only_going_on] = grams
        regs, is_scaled = jnp.asarray(self.model.regs), self._options.is_scaled
        return solved(grams, crosses, step.centre, regs, self.num_paths, is_scaled, num_features)


def _plus(sums: Any, more: Any) -> Any:
    return more if sums is None else jax.tree.map(jnp.add, sums, more)


def _separate(passes: _Passes) -> list[StepFit]:
    fits, step = [], None
    for stage in reversed(range(passes.model.horizon)):
        fit = passes.fit(step, stage)
        fits.insert(0, fit)
        step = Step(jnp.asarray(stage), fit.q, jnp.asarray(1.0), jnp.zeros_like(fit.coefficients))
    return fits


def _pooled(passes: _Passes) -> list[StepFit]:
    step, end_action = None, passes.model.task.end_action
    if end_action is not None:
        ended = passes.fit(None)
        num_actions = next(passes.parts()).is_possible.shape[-1]
        block = int(passes.model.blocks(num_actions)[end_action])
        centre = jnp.broadcast_to(ended.coefficients[block], ended.coefficients.shape)
        step = Step(jnp.asarray(0), ended.q, jnp.asarray(1.0), centre)
    fits = [passes.fit(step, is_end_value=end_action is not None)]
    for _ in range(passes.model.horizon - 1):
        before = fits[-1]
        step = Step(jnp.asarray(0), before.q, jnp.asarray(1.0), before.coefficients)
        fits.append(passes.fit(step, only_going_on=True))
    return fits


def _around(log: Transitions, stage: int) -> tuple[Transitions, int]:
    """Keep a stage and the next one, which is all that a step looks at, and tell where in that the stage is."""
    first = max(min(stage, log.action.shape[1] - 2), 0)
    rows = of_paths(lambda leaf: leaf[:, first : first + 2], log._replace(fold=None))
    return rows._replace(fold=log.fold), stage - first


def _first(log: Transitions, num_blocks: int) -> Step:
    """Nothing follows the last stage."""
    zeros = jnp.zeros((num_blocks, log.features.shape[-1] + 1))
    num_variates = 0 if log.control_variates is None else log.control_variates.shape[-1]
    centre = jnp.zeros((num_blocks, zeros.shape[1] + num_variates))
    return Step(jnp.asarray(0), QFunctions(zeros, zeros[:, 0]), jnp.asarray(0.0), centre)
