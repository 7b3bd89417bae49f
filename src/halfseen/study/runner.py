"""One runner for all experiments: prepare once, repeat what is missing, tabulate."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from halfseen.progress import Progress
from halfseen.study.experiment import Experiment, PieceOf, Pieces, Setting, Tables, Timed
from halfseen.study.store import Store
from halfseen.workers import Pool, Workers
from halfseen.workers.piece import versions

TABULATING = 0.1
"""What measuring and tabulating an experiment take, where its repetitions take 1: about as long for each of them."""
MOST_AT_ONCE = 8
"""Repetitions that a worker makes in a row: short ones together take a few seconds."""


def store_of(experiment: Experiment, setting: Setting, folder: Path, is_resumed: bool) -> Store:
    """Open the store of an experiment; more repetitions add pieces and change none."""
    scenes = [[scene.name, *map(_numbers, (scene.hides, scene.grip, scene.places_m))] for scene in setting.scenes]
    # Of the law the numbers count, and not where it lies.
    fixed = asdict(setting) | {"scenes": scenes, "law": setting.law is not None}
    fixed.pop("repetitions")
    design = design_of(experiment)
    design.pop("most_repetitions", None)
    fingerprint = {"design": design, "setting": fixed, "versions": versions()}
    return Store(folder / "progress" / experiment.name, fingerprint, is_resumed)


def _numbers(array: np.ndarray | None) -> Any:
    return None if array is None else array.tolist()


def design_of(experiment: Experiment) -> dict[str, Any]:
    """The configuration of an experiment."""
    return asdict(experiment) if is_dataclass(experiment) and not isinstance(experiment, type) else {}


class Run(NamedTuple):
    """An experiment, and where it keeps its pieces."""

    experiment: Experiment
    store: Store

    def num(self, setting: Setting) -> int:
        """Repetitions of the experiment."""
        return min(setting.repetitions, self.experiment.most_repetitions or setting.repetitions)

    def missing(self, setting: Setting) -> list[int]:
        """Repetitions that are to be made."""
        return [index for index in range(self.num(setting)) if not self.store.has(repetition(index))]

    def tabulated(self, setting: Setting) -> Tables:
        """Make the tables from the pieces that are kept."""
        repetitions = [self.store.read(repetition(index)) for index in range(self.num(setting))]
        pieces = Pieces(self.store.read(PREPARED), self.measured(setting), repetitions)
        return self.experiment.tabulate(setting, pieces)

    def measured(self, setting: Setting) -> dict[str, Any]:
        """Times, measured once and kept: a resumed study reports what the killed one measured."""
        its = self.experiment
        return self.store.kept("measured", lambda: its.measure(setting)) if isinstance(its, Timed) else {}


PREPARED = "prepared"


def repetition(index: int) -> str:
    """Name of the piece that a repetition is."""
    return f"repetition-{index:05d}"


def run_all(
    experiments: Sequence[Experiment], setting: Setting, stores: Sequence[Store], workers: Workers
) -> list[Tables]:
    """Run experiments, whose repetitions workers make.

    Times are measured while nothing else runs: after that, when what is timed has been compiled.
    """
    runs = [Run(experiment, store) for experiment, store in zip(experiments, stores, strict=True)]
    with Progress(len(runs) * (1 + TABULATING), "study, prepare") as bar:
        # Those of few repetitions, which are long, come first, so that all workers end together.
        by_num = sorted(runs, key=lambda run: run.num(setting))
        with workers.ready() as pool:
            _prepare(by_num, setting, pool)
            _repeat(by_num, setting, pool, bar)
        tables = []
        for run in runs:
            bar.begin(f"study, {run.experiment.name}", 0)
            tables.append(run.tabulated(setting))
            bar.update(TABULATING)
    return tables


def _prepare(runs: Sequence[Run], setting: Setting, pool: Pool) -> None:
    left = [run for run in runs if not run.store.has(PREPARED)]
    for number, piece in pool.each(_Preparing(setting), [run.experiment for run in left]):
        left[number].store.keep(PREPARED, piece)


@dataclass(frozen=True)
class _Preparing:
    """Prepares experiments."""

    setting: Setting

    def __call__(self, experiment: Experiment) -> PieceOf:
        return experiment.prepare(self.setting)


def _repeat(runs: Sequence[Run], setting: Setting, pool: Pool, bar: Progress) -> None:
    nums, missing = [run.num(setting) for run in runs], [run.missing(setting) for run in runs]
    bar.begin("study", sum(1.0 - len(those) / num for num, those in zip(nums, missing, strict=True)))
    todo = [(k, some) for k, those in enumerate(missing) for some in in_rows(those, pool.num_workers)]
    prepared = tuple(run.store.read(PREPARED) for run in runs)
    repeat = _Repeating(tuple(run.experiment for run in runs), setting, prepared)
    for number, pieces in pool.each(repeat, todo):
        k, some = todo[number]
        for index, piece in zip(some, pieces, strict=True):
            runs[k].store.keep(repetition(index), piece)
        bar.update(len(some) / nums[k])


@dataclass(frozen=True)
class _Repeating:
    """Makes some repetitions of one of the experiments; who makes them changes nothing in them."""

    experiments: tuple[Experiment, ...]
    setting: Setting
    prepared: tuple[PieceOf, ...]

    def __call__(self, some: tuple[int, Sequence[int]]) -> list[PieceOf]:
        k, indices = some
        return [self.experiments[k].repeat(self.setting, self.prepared[k], index) for index in indices]


def in_rows(indices: Sequence[int], num_workers: int) -> list[Sequence[int]]:
    """Divide repetitions into rows for one worker each: long ones where there are many, so that all end together."""
    length = max(1, min(MOST_AT_ONCE, len(indices) // (8 * num_workers)))
    return [indices[begin : begin + length] for begin in range(0, len(indices), length)]
