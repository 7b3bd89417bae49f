"""Eq. 3 in passes over a log that need not fit in memory: the sums of its parts add up.

Each backward step asks every shard of the log for sums and adds them in the order of the shards. So the result equals
that of the whole log in memory, up to the rounding of the sums, with the same bytes whichever worker sums. What is not
a sum is fitted to the same sample of trajectories as in memory (`sample`).

Reading and checking the log takes longest, so it is done once; then its arrays are kept on disk between passes. A
worker without a part lays it out again, to the same bytes, so a lost part or a different worker costs only time. The
folder is private to the user and deleted after the passes. Its arrays are memory-mapped, so a pass reads only what it
uses.
"""

import ctypes
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial, reduce
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any, NamedTuple
from uuid import uuid4

import numpy as np

from halfseen.arrays import mapped
from halfseen.censoring import StageClocks, WeightDiagnostics
from halfseen.censoring.clocks import stacked
from halfseen.censoring.weights import WeightTally, weight_diagnostics
from halfseen.learning.judging import with_half_life, with_stages
from halfseen.learning.preference import with_preference
from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import CrossValidation
from halfseen.learning.recursion import QFunctions, Step, StepSums, backward, sums_of_step
from halfseen.learning.rows import Support, TrajectoryArrays, refuse_all_cut, refuse_too_few
from halfseen.learning.sample import sampled
from halfseen.learning.sums import Rows, packed
from halfseen.learning.task import RewardedStages
from halfseen.logs import Logs, LogStream
from halfseen.logs.folder import Folder, LogPart, Shard
from halfseen.logs.stream import ShardReader, Tables, logs_of
from halfseen.progress import Progress
from halfseen.shapes import Float, Int
from halfseen.workers import ALONE, Pool, Workers, checked_workers
from halfseen.workers.threads import one_thread

MOST_SHARE = 0.5
"""Share of the free disk space for everything that is kept of a log."""


class Fit(NamedTuple):
    """The result of learning from a log."""

    model: QModel
    """With everything fitted before Q."""
    q_functions: QFunctions
    chosen: tuple[str, ...]
    """What was chosen automatically."""
    weights: Float[np.ndarray, "n T"]
    """Of every stage in eq. 3; on disk for a stream."""
    diagnostics: WeightDiagnostics


def learned_from(logs: Logs | LogStream, model: QModel, has_choice: bool, workers: Workers | None = None) -> Fit:
    """Learn from a log in memory, or in passes over a stream whose shards are summed by workers.

    With `has_choice`, the log decides whether stages are pooled (`judging`).
    """
    workers = checked_workers(ALONE if workers is None else workers)
    if isinstance(logs, LogStream):
        return _streaming(logs, model, has_choice, workers)
    model, trajectories = model.fitted(logs)
    model, chosen = _with_choices(model, model.sample_of(trajectories), has_choice, logs.num_trajectories)
    log = model.recent(model.transitions(trajectories))
    diagnostics = weight_diagnostics(log.weight, model.cut_model and model.cut_model.truncate_at)
    return Fit(model, model.fit(log), chosen, log.weight, diagnostics)


def _streaming(stream: LogStream, model: QModel, has_choice: bool, workers: Workers) -> Fit:
    """Gather the inputs of Ĝ and a sample of trajectories in the first pass; then make each backward step a pass."""
    refuse_all_cut(stream.is_finished)
    shards, num_trajectories = stream.shards(), stream.num_trajectories
    with (
        (workers if len(shards) > 1 else ALONE).ready() as pool,
        kept_parts(shards[-1].parts[-1].number + 1, pool.is_here) as kept,
    ):
        work = partial(_Work, stream.as_folder, num_trajectories, kept)
        sample = _read(stream, shards, sampled(num_trajectories, model.random_state), pool)
        model = model.with_task(stream, sample)
        support, clocks = _joined(pool.in_order(partial(_look_at, work(model)), shards))
        clocks = clocks or [StageClocks.of_ends(stream.end_s, stream.is_finished)]
        model = model.with_clocks(clocks[0], support)
        trajectories = model.lay_out(sample)
        give_back()
        model = model.with_sample(trajectories).with_durations(trajectories)
        model, chosen = _with_choices(model, trajectories, has_choice, num_trajectories)
        give_back()
        rewarded = chain.from_iterable(work(model).rewarded(shard) for shard in shards)
        model = replace(model, task=model.task.fitted_to_rewards(rewarded))
        return _backward_streaming(work(model), shards, pool, trajectories.is_possible.shape[-1], chosen)


def _with_choices(
    model: QModel, sample: TrajectoryArrays, has_choice: bool, num_trajectories: int
) -> tuple[QModel, tuple[str, ...]]:
    """Choose the stage mode and the half-life by the log, if they are open; return the reasons, too."""
    model, chosen = with_stages(model, sample) if has_choice else (model, model.chosen)
    model, why = with_half_life(model, sample, num_trajectories)
    model, preferred = with_preference(model, sample)
    return model, (*chosen, *why, *preferred)


def _backward_streaming(
    work: "_Work", shards: list[Shard], pool: Pool, num_actions: int, chosen: tuple[str, ...]
) -> Fit:
    model, num_trajectories = work.model, work.num_trajectories
    regression = model.regression(num_trajectories, num_actions)
    fold = model.folds(num_trajectories).astype(np.min_scalar_type(-regression.num_folds))
    dealt = [(shard, fold[shard.trajectories]) for shard in shards]
    tally = WeightTally(model.cut_model and model.cut_model.truncate_at)
    num_passes, is_first = model.horizon + (regression.end_action is not None), True
    # The file has no name; it is deleted with the last array that maps it.
    with one_thread(), TemporaryFile(prefix="halfseen-") as file, Progress(num_passes, "learn", "passes") as bar:

        def ask(step: Step) -> StepSums:
            nonlocal is_first
            total = None
            for sums, weight in pool.in_order(partial(_sums_of, work, step, is_first), dealt):
                if weight is not None:
                    file.write(np.ascontiguousarray(weight).tobytes())
                    tally.add(weight)
                total = _plus(total, sums)
            assert total is not None
            is_first = False
            bar.update()
            return total

        q = backward(ask, (num_trajectories, model.horizon), regression)
        if isinstance(model.reg, CrossValidation):
            refuse_too_few(tally.num_rows_seen, num_trajectories)
        file.flush()
        weights = np.memmap(file, dtype=np.float64, mode="r", shape=(num_trajectories, model.horizon))
    return Fit(model, q, chosen, weights, tally.diagnostics())


def sample_of(stream: LogStream, seed: int, most: int | None = None) -> Logs:
    """Read a sample of trajectories; by default the one that `QModel.sample_of` draws from a log in memory."""
    return _read(stream, stream.shards(), sampled(stream.num_trajectories, seed, most), Pool(None))


def _read(stream: LogStream, shards: Sequence[Shard], rows: Int[np.ndarray, " k"], pool: Pool) -> Logs:
    wanted = [(shard, rows[(rows >= shard.trajectories.start) & (rows < shard.trajectories.stop)]) for shard in shards]
    found = pool.in_order(partial(_tables_of, stream.as_folder), wanted)
    return logs_of(stream.as_folder, list(chain.from_iterable(found)))


def _tables_of(folder: Folder, wanted: tuple[Shard, Int[np.ndarray, " k"]]) -> list[Tables]:
    """Read some trajectories of a shard, by row, without checks."""
    reader, (shard, rows), found = ShardReader(folder), wanted, []
    for part in shard.parts:
        here = rows[(rows >= part.trajectories[0]) & (rows < part.trajectories[1])] - part.trajectories[0]
        if len(here):
            found.append(reader.tables(part, here))
    return found


def give_back() -> None:
    """Return freed memory to the system: that of Arrow, and what the allocator keeps."""
    arrow = sys.modules.get("pyarrow")
    if arrow is not None:
        arrow.default_memory_pool().release_unused()
    if sys.platform == "linux":
        # Other C libraries do so on their own, or offer no such call.
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


@dataclass(frozen=True)
class KeptParts:
    """A folder of parts, by kind and number; each process writes and reads whole files."""

    name: str
    """Of the folder, or an identifier for the folder that each process makes for itself."""
    is_shared: bool
    """Whether all processes are on this machine and the folder exists."""
    most_bytes: int
    """Size limit of a part."""

    def keep(self, kind: str, number: int, part: Any) -> None:
        """Keep a part, which is nested records of arrays, if there is room; an existing one is replaced.

        A part is written whole: if the disk fills up, nothing of it remains.
        """
        import joblib

        if num_bytes_of(part) > self.most_bytes:
            return
        file = self._file(kind, number)
        beside = file.with_name(f"{file.name}.{os.getpid()}")
        try:
            joblib.dump(part, beside)
            beside.replace(file)
        except OSError:
            beside.unlink(missing_ok=True)

    def read(self, kind: str, number: int) -> Any:
        """Read a part; None if it was not kept."""
        import joblib

        try:
            return joblib.load(self._file(kind, number), mmap_mode="r")
        except FileNotFoundError:
            return None

    def forget(self, kind: str, number: int) -> None:
        """Delete a part."""
        self._file(kind, number).unlink(missing_ok=True)

    def _file(self, kind: str, number: int) -> Path:
        return Path(self.name if self.is_shared else _own_folder(self.name)) / f"{kind}-{number}"


def num_bytes_of(part: Any) -> int:
    """Bytes of the arrays when written; broadcast arrays are written in full."""
    return sum(map(num_bytes_of, part)) if isinstance(part, tuple) else getattr(part, "nbytes", 0)


@contextmanager
def kept_parts(num_parts: int, is_shared: bool = True) -> Iterator[KeptParts]:
    """Provide a place for the parts of a log for the length of a ``with`` block.

    If not all workers are on this machine, each keeps its own parts until it gets another log.
    """
    with TemporaryDirectory(prefix="halfseen-") as name:
        most = int(MOST_SHARE * shutil.disk_usage(name).free / num_parts)
        yield KeptParts(name if is_shared else uuid4().hex, is_shared, most)


_OWN: dict[str, TemporaryDirectory] = {}


def _own_folder(name: str) -> str:
    """Folder of this process for one log; that of the previous log is deleted."""
    if name not in _OWN:
        while _OWN:
            _OWN.popitem()[1].cleanup()
        _OWN[name] = TemporaryDirectory(prefix="halfseen-")
    return _OWN[name].name


@dataclass(frozen=True)
class _Work:
    """What all workers receive once per pass: the log, the model as fitted so far, and where parts are kept."""

    folder: Folder
    num_trajectories: int
    kept: KeptParts
    model: QModel

    def trajectories_of(self, shard: Shard) -> Iterator[TrajectoryArrays]:
        """Arrange the parts of a shard as arrays."""
        reader = cache(partial(ShardReader, self.folder))
        for part in shard.parts:
            trajectories = self.kept.read("trajectories", part.number)
            if trajectories is None:
                trajectories = self._laid_out(reader, part)
                self.kept.keep("trajectories", part.number, trajectories)
            yield trajectories

    def rewarded(self, shard: Shard) -> Iterator[RewardedStages]:
        """Rewards of the stages of a shard, read lazily."""
        for trajectories in self.trajectories_of(shard):
            yield self.model.rewarded(trajectories, self.model.targets.weights(trajectories, self.model.cut_model))

    def rows_of(
        self, shard: Shard, fold: Int[np.ndarray, " n"], is_first: bool
    ) -> Iterator[tuple[LogPart, Rows, Float[np.ndarray, "n T"] | None]]:
        """Pack the parts of a shard; in the first pass with the weight of every stage."""
        reader, begin = cache(partial(ShardReader, self.folder)), shard.trajectories.start
        for part in shard.parts:
            rows, weight = None if is_first else self.kept.read("rows", part.number), None
            if rows is None:
                trajectories = self.kept.read("trajectories", part.number) or self._laid_out(reader, part)
                weight, imputed = self.model.weights_and_imputation(trajectories)
                first, end = part.trajectories
                log = self.model.weighted(trajectories, weight, imputed, fold[first - begin : end - begin])
                log = self.model.recent(log, first, self.num_trajectories)
                weight = log.weight
                rows = packed(log, self.model.regression(self.num_trajectories, log.is_possible.shape[-1]))
                self.kept.forget("trajectories", part.number)
                self.kept.keep("rows", part.number, rows)
            yield part, rows, weight

    def _laid_out(self, reader: Callable[[], ShardReader], part: LogPart) -> TrajectoryArrays:
        """A part of the log, whose reader is opened on first use."""
        logs = reader().read(part)
        self.model.check_horizon(logs)
        return self.model.lay_out(logs)


_Look = tuple[Support, list[StageClocks]]


def _look_at(work: _Work, shard: Shard) -> _Look:
    """Read a shard for the first time: its support and, if Ĝ is fitted, the data that Ĝ needs besides ends."""
    model, looks = work.model, []
    for trajectories in work.trajectories_of(shard):
        clocks = model.targets.looks_at(trajectories.clocks)
        looks.append((model.support_in(trajectories), [] if clocks is None else [clocks]))
    # This process may now wait long for other readers.
    give_back()
    return _joined(looks)


def _joined(looks: Iterable[_Look]) -> _Look:
    seen, clocks = zip(*looks, strict=True)
    every = list(chain.from_iterable(clocks))
    return reduce(Support.plus, seen), [stacked(every)] if every else []


def _sums_of(
    work: _Work, step: Step, is_first: bool, dealt: tuple[Shard, Int[np.ndarray, " n"]]
) -> tuple[StepSums, Float[np.ndarray, "n T"] | None]:
    """Sum a shard for one backward step, given the folds of its trajectories; in the first pass with all weights."""
    total, weights, keeps_norms = None, [], work.model.stages == "pooled"
    for part, rows, weight in work.rows_of(*dealt, is_first):
        known = work.kept.read("norms", part.number) if keeps_norms else None
        regression = work.model.regression(work.num_trajectories, len(rows.block_of_action))
        sums = sums_of_step(rows, step, regression, known)
        if keeps_norms and sums.norms is not known:
            work.kept.keep("norms", part.number, sums.norms)
        weights.append(weight)
        total = _plus(total, sums._replace(norms=None))
    assert total is not None
    return total, np.concatenate(weights) if is_first else None


def _plus(total: StepSums | None, sums: StepSums) -> StepSums:
    if total is None:
        return sums
    moments, crosses = mapped(np.add, (total.moments, total.crosses), (sums.moments, sums.crosses))
    return total._replace(moments=moments, crosses=crosses)
