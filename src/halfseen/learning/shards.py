"""What a worker does with a shard of a log: pure functions of the log and of what was fitted so far.

Each part is laid out once, kept (`kept_parts`), and summed in every pass. Whoever has not got it lays it out anew, to
the same bytes; so it does not matter which worker sums a shard, nor how often one is lost.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from halfseen.censoring import StageClocks
from halfseen.censoring.stage_clocks import stacked
from halfseen.learning.kept_parts import KeptParts
from halfseen.learning.memory import give_back
from halfseen.learning.path_arrays import PathArrays
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import Rows, rows_of
from halfseen.learning.state_values import values_of
from halfseen.learning.sums import Crosses, Grams, Shape, Step, crosses_of, grams_of, plus
from halfseen.learning.support import Support
from halfseen.logs import Logs
from halfseen.logs.shards import Folder, Part, Shard, ShardReader, Tables


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

    def paths_of(self, shard: Shard) -> Iterator[tuple[Part, PathArrays]]:
        """Lay out the parts of a shard as arrays."""
        reader = _Lazily(self.folder)
        for part in shard.parts:
            yield part, self.kept.found("paths", part.number, partial(self._laid_out, reader, part))

    def rows_of(self, shard: Shard, fold: Int[np.ndarray, " n"]) -> Iterator[tuple[Part, Rows, None]]:
        """Pack the parts of a shard."""
        reader, begin = _Lazily(self.folder), shard.paths.start
        for part in shard.parts:
            of_part = fold[part.paths[0] - begin : part.paths[1] - begin]
            anew = partial(self._packed, reader, part, of_part)
            yield part, self.kept.found("rows", part.number, lambda anew=anew: anew()[0]), None

    def packed(
        self, shard: Shard, fold: Int[np.ndarray, " n"]
    ) -> Iterator[tuple[Part, Rows, Float[np.ndarray, "n T"]]]:
        """Pack the parts of a shard for the first time, with the weight of every stage."""
        reader, begin = _Lazily(self.folder), shard.paths.start
        for part in shard.parts:
            rows, weight = self._packed(reader, part, fold[part.paths[0] - begin : part.paths[1] - begin])
            self.kept.forget("paths", part.number)
            self.kept.keep("rows", part.number, rows)
            yield part, rows, weight

    @property
    def shape(self) -> Shape:
        """Of the sums."""
        return Shape(self.model.reg.folds_of(self.num_paths), self.model.num_blocks, self.model.pessimism > 0)

    def _laid_out(self, reader: "_Lazily", part: Part) -> PathArrays:
        logs = reader.read(part)
        self.model.check_horizon(logs)
        return self.model.lay_out(logs)

    def _packed(
        self, reader: "_Lazily", part: Part, fold: Int[np.ndarray, " n"]
    ) -> tuple[Rows, Float[np.ndarray, "n T"]]:
        paths = self.kept.read("paths", part.number) or self._laid_out(reader, part)
        weight, imputed = self.model.weights_and_imputation(paths)
        log = self.model.weighted(paths, weight, imputed, fold)
        return rows_of(log, self.model.regression(self.num_paths, log.is_possible.shape[-1])), weight


class _Lazily:
    """Opens the log where a part of it is to be read."""

    def __init__(self, folder: Folder) -> None:
        self._folder, self._reader = folder, None

    def read(self, part: Part) -> Logs:
        self._reader = self._reader or ShardReader(self._folder)
        return self._reader.read(part)


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
    for _, paths in work.paths_of(shard):
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
    for part, rows, weight in work.packed(*dealt) if ask.is_first else work.rows_of(*dealt):
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
