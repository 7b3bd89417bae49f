"""Eq. 3 in passes over a log that need not fit in memory: the sums of its parts add up.

Each backward step reads the log once, part by part, and keeps sums only, so what is learned is what the whole log in
memory would give, but for the rounding of the sums. What is no sum is fitted to the same sample of paths as in memory
(`sample`). The log itself is read and checked a few times; after that its arrays are read from disk, where they were
kept (`kept_parts`).
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from halfseen.censoring.stage_clocks import stacked
from halfseen.learners.q_learning.fitting import in_float64
from halfseen.learners.q_learning.kept_parts import Parts, kept
from halfseen.learners.q_learning.part_rows import ENDED, FOLLOWING, GOING_ON, part_rows
from halfseen.learners.q_learning.path_arrays import PathArrays
from halfseen.learners.q_learning.q_model import QModel, refuse_all_cut, refuse_too_few
from halfseen.learners.q_learning.q_space import CrossValidation
from halfseen.learners.q_learning.row_sums import Bound, Grams, Shape, Step, Successor, crosses_of, grams_of
from halfseen.learners.q_learning.sample import sampled
from halfseen.learners.q_learning.stage_choice import with_stages
from halfseen.learners.q_learning.state_values import Norms, values_of
from halfseen.learners.q_learning.step_fit import StepFit, solved
from halfseen.learners.q_learning.task import RewardedStages
from halfseen.learners.q_learning.transitions import QFunctions, Transitions
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
            log = model.weighted(paths, weight, imputed, fold[start : start + paths.num_paths])
            yield part_rows(log, model.blocks(log.is_possible.shape[-1]), model.options(stream.num_paths))
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
        The log, each part packed as the whole would be.
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
        self._shape = Shape(self._options.num_folds, self._options.num_blocks, model.pessimism > 0)
        self._grams: dict[tuple[int, ...], Grams] = {}
        self._norms: dict[int, Norms | None] = {}

    def fit(self, step: Step) -> StepFit:
        """Fit one step."""
        wanted = [some for some in _summed_alone(step.slices) if some not in self._grams]
        crosses, found = None, dict[tuple[int, ...], Grams]()
        for number, rows in enumerate(self.parts()):
            values, self._norms[number] = values_of(rows, step.successor, self._norms.get(number))
            crosses = _plus(crosses, crosses_of(rows, step, values, self._shape))
            for some in wanted:
                found[some] = _plus(found.get(some), grams_of(rows, some, self._shape))
            num_features = int(rows.widths[0])
        self._on_pass()
        self._grams |= found
        grams = reduce(_plus, (self._grams[some] for some in _summed_alone(step.slices)))
        centre = np.zeros(grams.main.shape[1:3]) if step.centre is None else step.centre
        regs, is_scaled = jnp.asarray(self.model.regs), self._options.is_scaled
        fit = solved(grams, crosses, centre, regs, self.num_paths, is_scaled, num_features)
        return jax.tree.map(np.asarray, fit)

    def bound(self, fit: StepFit) -> Bound | None:
        """How far Q is lowered by its standard errors, if it is."""
        if fit.unit_root is None:
            return None
        return Bound(np.asarray(fit.unit_root), self.model.pessimism * np.asarray(fit.deviation))


def _summed_alone(slices: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """Pooled stages differ in what the horizon ended, which is asked of some steps alone."""
    return (GOING_ON, ENDED) if set(slices) == {*GOING_ON, *ENDED} else (slices,)


def _plus(sums: Any, more: Any) -> Any:
    return more if sums is None else jax.tree.map(np.add, sums, more)


def _separate(passes: _Passes) -> list[StepFit]:
    fits, successor = [], None
    for stage in reversed(range(passes.model.horizon)):
        fit = passes.fit(Step((stage,), successor, None))
        fits.insert(0, fit)
        successor = Successor((stage,), np.asarray(fit.q.coefficients), passes.bound(fit))
    return fits


def _pooled(passes: _Passes) -> list[StepFit]:
    every, end_action = (*GOING_ON, *ENDED), passes.model.task.end_action
    step = Step(every, None, None)
    if end_action is not None:
        ended = passes.fit(step)
        num_actions = len(next(passes.parts()).block_of_action)
        block = int(passes.model.blocks(num_actions)[end_action])
        centre = np.broadcast_to(ended.coefficients[block], ended.coefficients.shape)
        step = Step(every, Successor(FOLLOWING, ended.q.coefficients, None, end_action), centre)
    fits = [passes.fit(step)]
    for _ in range(passes.model.horizon - 1):
        before = fits[-1]
        successor = Successor(FOLLOWING, before.q.coefficients, passes.bound(before))
        fits.append(passes.fit(Step(GOING_ON, successor, before.coefficients)))
    return fits
