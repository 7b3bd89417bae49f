"""Eq. 3 in passes over a log that need not fit in memory: the sums of its parts add up.

Each backward step asks every shard of the log for sums, and adds them in the order of the shards; so what is learned is
what the whole log in memory would give, but for the rounding of the sums, and the same bytes whoever sums
(`shard_passes`). What is no sum is fitted to the same sample of paths as in memory (`sample`). The log itself is read
and checked once; after that its arrays are read from disk, where they were kept (`kept_parts`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np
from jaxtyping import Float, Int

from halfseen.censoring import StageClocks, WeightDiagnostics
from halfseen.censoring.diagnostics import WeightTally
from halfseen.censoring.stage_clocks import stacked
from halfseen.learning.kept_parts import KeptParts, kept_parts
from halfseen.learning.memory import give_back
from halfseen.learning.q_model import QModel, refuse_all_cut, refuse_too_few
from halfseen.learning.q_space import CrossValidation
from halfseen.learning.recursion import Found, backward
from halfseen.learning.sample import sampled
from halfseen.learning.shards import (
    Ask,
    Dealt,
    ShardWork,
    Wanted,
    look_at,
    sampled_of,
    sums_of,
)
from halfseen.learning.stage_choice import with_stages
from halfseen.learning.stored_rows import StoredRows
from halfseen.learning.sums import Step, plus
from halfseen.learning.task import RewardedStages
from halfseen.learning.transitions import QFunctions
from halfseen.logs import Logs, LogStream
from halfseen.logs.shards import Shard, logs_of
from halfseen.progress import Progress
from halfseen.workers import Pool, Workers
from halfseen.workers.threads import one_thread


@dataclass(frozen=True)
class Streamed:
    """What was learned in passes.

    Parameters
    ----------
    model
        With what was fitted before Q.
    q_functions
        Q.
    chosen
        What was chosen by itself.
    weights
        Of every stage in eq. 3, on disk.
    diagnostics
        Of these.
    """

    model: QModel
    q_functions: QFunctions
    chosen: tuple[str, ...]
    weights: Float[np.ndarray, "n T"]
    diagnostics: WeightDiagnostics


def fit_stream(model: QModel, stream: LogStream, has_choice: bool = False, workers: Workers | None = None) -> Streamed:
    """Learn in passes over a log; the first pass gathers what Ĝ needs, and a sample of the paths.

    Parameters
    ----------
    model
        How Q is fitted.
    stream
        The log.
    has_choice
        Whether stages are to be pooled is for the log to say (see `stage_choice`).
    workers
        Who sums; None for this process alone.

    Raises
    ------
    ArgumentError
        A part of the model cannot be fitted.
    PositivityError
        All paths were cut, or a weight is not identified.
    WorkerError
        Workers were lost again and again.
    """
    refuse_all_cut(stream.is_finished)
    shards = stream.shards()
    if workers is None or len(shards) == 1:
        workers = Workers(1)
    with workers.ready() as pool, kept_parts(shards[-1].parts[-1].number + 1, pool.is_here) as kept:
        passes = _Log(stream, shards, pool, kept)
        sample = passes.sample(model.random_state)
        model = model.with_task(stream, sample)
        model = passes.looked_at(model)
        paths = model.lay_out(sample)
        give_back()
        model = model.with_kernel(paths).with_behaviour(paths).with_durations(paths)
        model, chosen = with_stages(model, paths) if has_choice else (model, model.chosen)
        give_back()
        model = replace(model, task=model.task.fitted_to_rewards(passes.rewarded(model)))
        return passes.fit(model, chosen)


def sample_of(stream: LogStream, seed: int, most: int | None = None) -> Logs:
    """Read some of the paths; by default those that `QModel.sample_of` takes of a log in memory."""
    rows = sampled(stream.num_paths, seed, most)
    found = (sampled_of(stream.as_folder, wanted) for wanted in _wanted(stream.shards(), rows))
    return logs_of(stream.as_folder, list(chain.from_iterable(found)))


def _wanted(shards: list[Shard], rows: Int[np.ndarray, " k"]) -> Iterator[Wanted]:
    for shard in shards:
        yield Wanted(shard, rows[(rows >= shard.paths.start) & (rows < shard.paths.stop)])


class _Log:
    """A log in shards, and who reads them."""

    def __init__(self, stream: LogStream, shards: list[Shard], pool: Pool, kept: KeptParts) -> None:
        self._stream, self._shards, self._pool, self._kept = stream, shards, pool, kept
        self.num_actions = 0

    def sample(self, seed: int) -> Logs:
        """Read the paths that decide on what is no sum."""
        rows = sampled(self._stream.num_paths, seed)
        found = self._pool.in_order(partial(sampled_of, self._stream.as_folder), _wanted(self._shards, rows))
        return logs_of(self._stream.as_folder, list(chain.from_iterable(found)))

    def looked_at(self, model: QModel) -> QModel:
        """Look at all shards for the first time; fit Ĝ, and see what was completed."""
        support, clocks = None, []
        for look in self._pool.in_order(partial(look_at, self._work(model)), self._shards):
            support = look.support if support is None else support.plus(look.support)
            self.num_actions = look.num_actions
            clocks += [] if look.clocks is None else [look.clocks]
        of_ends = StageClocks.of_ends(self._stream.end_s, self._stream.is_finished)
        found = stacked(clocks) if clocks else of_ends
        return replace(model, support=support, cut_model=model.targets.fit_cuts(found))

    def rewarded(self, model: QModel) -> Iterator[RewardedStages]:
        """What the stages of a log paid; nothing is read unless it is asked for."""
        for shard in self._shards:
            for _, paths in self._work(model).paths_of(shard):
                yield model.rewarded(paths, model.targets.weights(paths, model.cut_model))

    def fit(self, model: QModel, chosen: tuple[str, ...]) -> Streamed:
        """Run eq. 3 in float64, a pass for each backward step."""
        num_paths, is_pooled = self._stream.num_paths, model.stages == "pooled"
        num_passes = model.horizon + (is_pooled and model.task.end_action is not None)
        fold = model.folds(num_paths).astype(np.min_scalar_type(-model.reg.folds_of(num_paths)))
        dealt = [Dealt(shard, fold[shard.paths]) for shard in self._shards]
        work, bound = self._work(model), None if model.cut_model is None else model.cut_model.truncate_at
        tally = WeightTally(bound)
        with (
            one_thread(),
            StoredRows((num_paths, model.horizon)) as weights,
            Progress(num_passes, "learn", "passes") as bar,
        ):
            is_first = True

            def ask(step: Step, wanted: tuple[tuple[int, ...], ...]) -> Found:
                nonlocal is_first
                total, num_features = None, 0
                asked = Ask(step, wanted, is_first, keeps_norms=is_pooled)
                for sums in self._pool.in_order(partial(sums_of, work, asked), dealt):
                    if sums.weight is not None:
                        weights.add(sums.weight)
                        tally.add(sums.weight)
                    total, num_features = plus(total, (sums.grams, sums.crosses)), sums.num_features
                assert total is not None
                is_first = False
                bar.update()
                return Found(*total, num_features=num_features)

            q = backward(ask, (num_paths, model.horizon), model.regression(num_paths, self.num_actions))
            if isinstance(model.reg, CrossValidation):
                refuse_too_few(tally.num_rows_seen, num_paths)
            return Streamed(model, q, chosen, weights.read(), tally.told())

    def _work(self, model: QModel) -> ShardWork:
        return ShardWork(self._stream.as_folder, model, self._stream.num_paths, self._kept)
