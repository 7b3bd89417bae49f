"""Eq. 3 in passes over a log that need not fit in memory: the sums of its parts add up.

Each backward step asks every shard of the log for sums, and adds them in the order of the shards; so what is learned is
what the whole log in memory would give, but for the rounding of the sums, and the same bytes whoever sums. What is no
sum is fitted to the same sample of paths as in memory (`q_model`). The log itself is read and checked once; after that
its arrays are read from disk, where they were kept (`kept_parts`). Whoever has not got a part lays it out anew, to the
same bytes; so it does not matter which worker sums a shard, nor how often one is lost.
"""

import ctypes
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain
from tempfile import TemporaryFile
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from halfseen.censoring import StageClocks, WeightDiagnostics
from halfseen.censoring.diagnostics import WeightTally
from halfseen.censoring.stage_clocks import stacked
from halfseen.learning.judging import with_stages
from halfseen.learning.kept_parts import KeptParts, kept_parts
from halfseen.learning.q_model import QModel, Support, refuse_all_cut, refuse_too_few, sampled
from halfseen.learning.q_space import CrossValidation
from halfseen.learning.recursion import Found, backward, values_of
from halfseen.learning.regression import Crosses, Grams, Shape, Step, crosses_of, grams_of, plus
from halfseen.learning.rows import PathArrays, QFunctions, Rows, rows_of
from halfseen.learning.task import RewardedStages
from halfseen.logs import Logs, LogStream
from halfseen.logs.shards import Folder, Part, Shard, ShardReader, Tables, logs_of
from halfseen.progress import Progress
from halfseen.workers import Pool, Workers
from halfseen.workers.threads import one_thread


def give_back() -> None:
    """Hand what was freed back to the system: what Arrow has read, and what the allocator keeps."""
    arrow = sys.modules.get("pyarrow")
    if arrow is not None:
        arrow.default_memory_pool().release_unused()
    if sys.platform == "linux":
        # Other libraries of C do so by themselves, or cannot be told to.
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


@dataclass(frozen=True)
class ShardWork:
    """What all workers are told once a pass.

    Parameters
    ----------
    folder
        The log.
    model
        As far as it is fitted.
    num_paths
        n, of the whole log.
    kept
        Where what was laid out is kept.
    """

    folder: Folder
    model: QModel
    num_paths: int
    kept: KeptParts

    def paths_of(self, shard: Shard) -> Iterator[PathArrays]:
        """Lay out the parts of a shard as arrays."""
        reader = self._reader()
        for part in shard.parts:
            yield self.kept.found("paths", part.number, partial(self._laid_out, reader, part))

    def rows_of(
        self, shard: Shard, fold: Int[np.ndarray, " n"], is_first: bool
    ) -> Iterator[tuple[Part, Rows, Float[np.ndarray, "n T"] | None]]:
        """Pack the parts of a shard; for the first time with the weight of every stage."""
        reader, begin = self._reader(), shard.paths.start
        for part in shard.parts:
            rows, weight = None if is_first else self.kept.read("rows", part.number), None
            if rows is None:
                rows, weight = self._packed(reader, part, fold[part.paths[0] - begin : part.paths[1] - begin])
                self.kept.forget("paths", part.number)
                self.kept.keep("rows", part.number, rows)
            yield part, rows, weight if is_first else None

    @property
    def shape(self) -> Shape:
        """Of the sums."""
        return Shape(self.model.reg.folds_of(self.num_paths), self.model.num_blocks, self.model.pessimism > 0)

    def _reader(self) -> Callable[[], ShardReader]:
        """The log, opened where a part of it is to be read."""
        return cache(partial(ShardReader, self.folder))

    def _laid_out(self, reader: Callable[[], ShardReader], part: Part) -> PathArrays:
        logs = reader().read(part)
        self.model.check_horizon(logs)
        return self.model.lay_out(logs)

    def _packed(
        self, reader: Callable[[], ShardReader], part: Part, fold: Int[np.ndarray, " n"]
    ) -> tuple[Rows, Float[np.ndarray, "n T"]]:
        paths = self.kept.read("paths", part.number) or self._laid_out(reader, part)
        weight, imputed = self.model.weights_and_imputation(paths)
        log = self.model.weighted(paths, weight, imputed, fold)
        return rows_of(log, self.model.regression(self.num_paths, log.is_possible.shape[-1])), weight


class Wanted(NamedTuple):
    """Some paths of a shard."""

    shard: Shard
    paths: Int[np.ndarray, " k"]
    """Rows of the table of paths."""


def sampled_of(folder: Folder, wanted: Wanted) -> list[Tables]:
    """Read some paths, and check nothing."""
    reader, found = ShardReader(folder), []
    for part in wanted.shard.parts:
        here = wanted.paths[(wanted.paths >= part.paths[0]) & (wanted.paths < part.paths[1])] - part.paths[0]
        if len(here):
            found.append(reader.tables(part, here))
    return found


class Look(NamedTuple):
    """What a first look at a shard finds."""

    support: Support
    num_actions: int
    clocks: StageClocks | None
    """What Ĝ is fitted to, beyond the ends of the paths; None if nothing."""


def look_at(work: ShardWork, shard: Shard) -> Look:
    """Read, check and lay out a shard for the first time."""
    support, clocks, num_actions = None, [], 0
    for paths in work.paths_of(shard):
        here = work.model.support_in(paths)
        support, num_actions = here if support is None else support.plus(here), paths.is_possible.shape[-1]
        found = work.model.targets.looks_at(paths.clocks)
        clocks += [] if found is None else [found]
    assert support is not None
    # This process may wait for long now, for others that read.
    give_back()
    return Look(support, num_actions, stacked(clocks) if clocks else None)


class Dealt(NamedTuple):
    """A shard, and the folds of its paths."""

    shard: Shard
    fold: Int[np.ndarray, " n"]


class Sums(NamedTuple):
    """What a pass finds in a shard."""

    grams: tuple[Grams, ...]
    crosses: Crosses
    num_features: int
    weight: Float[np.ndarray, "n T"] | None
    """Of every stage, in the first pass."""


class Ask(NamedTuple):
    """What a pass asks for."""

    step: Step
    grams: tuple[tuple[int, ...], ...]
    """Slices whose Gram matrices are wanted."""
    is_first: bool
    """Whether nobody has packed the log so far."""
    keeps_norms: bool
    """Whether the next step looks at the same states."""


def sums_of(work: ShardWork, ask: Ask, dealt: Dealt) -> Sums:
    """Sum a shard up for one backward step."""
    total, weights, rows = None, [], None
    for part, rows, weight in work.rows_of(*dealt, ask.is_first):
        weights.append(weight)
        known = work.kept.read("norms", part.number) if ask.keeps_norms else None
        values, norms = values_of(rows, ask.step.successor, known)
        if ask.keeps_norms and norms is not known:
            work.kept.keep("norms", part.number, norms)
        grams = tuple(grams_of(rows, some, work.shape) for some in ask.grams)
        total = plus(total, (grams, crosses_of(rows, ask.step, values, work.shape)))
    assert total is not None
    assert rows is not None
    weight = np.concatenate(weights) if ask.is_first else None
    grams, crosses = total
    return Sums(grams, crosses, int(rows.widths[0]), weight)


class Streamed(NamedTuple):
    """What was learned in passes."""

    model: QModel
    """With what was fitted before Q."""
    q_functions: QFunctions
    chosen: tuple[str, ...]
    """What was chosen by itself."""
    weights: Float[np.ndarray, "n T"]
    """Of every stage in eq. 3, on disk."""
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
        Whether stages are to be pooled is for the log to say (`judging`).
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
            for paths in self._work(model).paths_of(shard):
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
            TemporaryFile(prefix="halfseen-") as weights,
            Progress(num_passes, "learn", "passes") as bar,
        ):
            is_first = True

            def ask(step: Step, wanted: tuple[tuple[int, ...], ...]) -> Found:
                nonlocal is_first
                total, num_features = None, 0
                asked = Ask(step, wanted, is_first, keeps_norms=is_pooled)
                for sums in self._pool.in_order(partial(sums_of, work, asked), dealt):
                    if sums.weight is not None:
                        weights.write(np.ascontiguousarray(sums.weight).tobytes())
                        tally.add(sums.weight)
                    total, num_features = plus(total, (sums.grams, sums.crosses)), sums.num_features
                assert total is not None
                is_first = False
                bar.update()
                return Found(*total, num_features=num_features)

            q = backward(ask, (num_paths, model.horizon), model.regression(num_paths, self.num_actions))
            if isinstance(model.reg, CrossValidation):
                refuse_too_few(tally.num_rows_seen, num_paths)
            weights.flush()
            # The file has no name; it is gone with the last array that shows it.
            shown = np.memmap(weights, dtype=np.float64, mode="r", shape=(num_paths, model.horizon))
            return Streamed(model, q, chosen, shown, tally.told())

    def _work(self, model: QModel) -> ShardWork:
        return ShardWork(self._stream.as_folder, model, self._stream.num_paths, self._kept)
