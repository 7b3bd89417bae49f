"""The study from end to end: prepare once, repeat what is missing, tabulate, write tables, figures and the report."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.figures import drawn
from halfseen.progress import Progress
from halfseen.study.experiment import Experiment, PieceOf, Pieces, Tables, Timed
from halfseen.study.experiments import EXPERIMENTS
from halfseen.study.report import StudyResults, report_of
from halfseen.study.setting import Setting
from halfseen.study.store import Store, as_json
from halfseen.suggestions import did_you_mean
from halfseen.workers import Pool, Workers
from halfseen.workers.piece import versions
from halfseen.writing import held_alone, write_file

PREPARED = "prepared"
TABULATING = 0.1
"""What measuring and tabulating an experiment take, where its repetitions take 1: about as long for each of them."""
MOST_AT_ONCE = 8
"""Repetitions that a worker makes in a row: short ones together take a few seconds."""


def store_of(experiment: Experiment, setting: Setting, folder: Path, is_resumed: bool) -> Store:
    """Open the store of an experiment; more repetitions add pieces and change none."""
    # Of the law the numbers count, and not where it lies.
    fixed = asdict(setting) | {"law": setting.law is not None, "repetitions": None}
    design = design_of(experiment) | {"most_repetitions": None}
    fingerprint = {"design": design, "setting": fixed, "versions": versions()}
    return Store(folder / "progress" / experiment.name, fingerprint, is_resumed)


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
        """Make the tables from the pieces that are kept; a resumed study has the times that the killed one measured."""
        its = self.experiment
        repetitions = [self.store.read(repetition(index)) for index in range(self.num(setting))]
        measured = self.store.kept("measured", lambda: its.measure(setting)) if isinstance(its, Timed) else {}
        return its.tabulate(setting, Pieces(self.store.read(PREPARED), measured, repetitions))


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
            left = [run for run in by_num if not run.store.has(PREPARED)]
            for number, piece in pool.each(partial(_prepared, setting), [run.experiment for run in left]):
                left[number].store.keep(PREPARED, piece)
            _repeat(by_num, setting, pool, bar)
        tables = []
        for run in runs:
            bar.begin(f"study, {run.experiment.name}", 0)
            tables.append(run.tabulated(setting))
            bar.update(TABULATING)
    return tables


def _prepared(setting: Setting, experiment: Experiment) -> PieceOf:
    return experiment.prepare(setting)


def _repeat(runs: Sequence[Run], setting: Setting, pool: Pool, bar: Progress) -> None:
    nums, missing = [run.num(setting) for run in runs], [run.missing(setting) for run in runs]
    bar.begin("study", sum(1.0 - len(those) / num for num, those in zip(nums, missing, strict=True)))
    todo = [(k, some) for k, those in enumerate(missing) for some in in_rows(those, pool.num_workers)]
    ready = [(run.experiment, run.store.read(PREPARED)) for run in runs]
    for number, pieces in pool.each(partial(_repeated, setting, ready), todo):
        k, some = todo[number]
        for index, piece in zip(some, pieces, strict=True):
            runs[k].store.keep(repetition(index), piece)
        bar.update(len(some) / nums[k])


def _repeated(
    setting: Setting, ready: Sequence[tuple[Experiment, PieceOf]], some: tuple[int, Sequence[int]]
) -> list[PieceOf]:
    """Make some repetitions of one of the experiments; who makes them changes nothing in them."""
    experiment, prepared = ready[some[0]]
    return [experiment.repeat(setting, prepared, index) for index in some[1]]


def in_rows(indices: Sequence[int], num_workers: int) -> list[Sequence[int]]:
    """Divide repetitions into rows for one worker each: long ones where there are many, so that all end together."""
    length = max(1, min(MOST_AT_ONCE, len(indices) // (8 * num_workers)))
    return [indices[begin : begin + length] for begin in range(0, len(indices), length)]


def chosen(names: Sequence[str], experiments: Sequence[Experiment] = EXPERIMENTS) -> tuple[Experiment, ...]:
    """Experiments of these names; all if there are none."""
    known = {each.name: each for each in experiments}
    for name in names:
        if name not in known:
            there = f"there are {', '.join(known)}{did_you_mean(name, known)}"
            raise ArgumentError(f"--only {name}: there is no such experiment; {there}")
    return tuple(each for each in experiments if not names or each.name in names)


def without_laws(experiments: Sequence[Any]) -> tuple[Experiment, ...]:
    """The same experiments, where what is learned is linear eq. 3 without laws."""
    return tuple(replace(each, laws=False) if hasattr(each, "laws") else each for each in experiments)


def run_study(
    setting: Setting,
    folder: Path,
    experiments: Sequence[Experiment] = EXPERIMENTS,
    *,
    is_resumed: bool = False,
    workers: Workers = Workers(),  # noqa: B008 - frozen
    pictures: Mapping[str, bytes] | None = None,
) -> StudyResults:
    """Run experiments and write all that they make into a folder.

    Parameters
    ----------
    setting
        What they share.
    folder
        Where to write: report.html, tables as .csv, figures as .svg and .png, study.json; and ``progress/``, from which
        a killed study is resumed.
    experiments
        Which.
    is_resumed
        Go on where a killed study stopped.
    workers
        Who makes the repetitions; by default a process a core.
    pictures
        PNG of each scene by its name, for the report.

    Raises
    ------
    ArgumentError
        The folder cannot be written, another study writes into it, or it holds another one that is to be resumed.
    WorkerError
        The workers cannot do it.
    """
    with held_alone(folder / "progress", "study"):
        stores = [store_of(each, setting, folder, is_resumed) for each in experiments]
        tables = run_all(experiments, setting, stores, workers)
        sections = {each.name: each.section(setting, of) for each, of in zip(experiments, tables, strict=True)}
        results = StudyResults(setting, tuple(experiments), tuple(tables), sections, versions())
        write_results(results, pictures or {}, folder)
    return results


def write_results(results: StudyResults, pictures: Mapping[str, bytes], folder: Path) -> None:
    """Write tables, figures and report, each whole or not at all."""
    for tables in results.tables:
        for name, table in tables.items():
            write_file(folder / f"{name}.csv", table.to_csv(index=False, lineterminator="\n"))
    for section in results.sections.values():
        for drawing in filter(None, (section.opening, *section.drawings)):
            for kind in ("svg", "png"):
                picture = drawn(partial(drawing.draw, drawing.title), kind)
                write_file(folder / f"{drawing.name}.{kind}", picture)
    write_file(folder / "study.json", as_json(_as_dict(results)))
    write_file(folder / "report.html", report_of(results, pictures))


def _as_dict(results: StudyResults) -> dict[str, Any]:
    setting = results.setting
    return {
        "answer": results.answer,
        "sentences": {name: section.sentences for name, section in results.sections.items()},
        "experiments": {each.name: design_of(each) for each in results.experiments},
        "setting": {name: value for name, value in asdict(setting).items() if name not in ("scenes", "law")},
        "scenes": [
            {"name": scene.name, "hides": scene.hides, "grip": np.asarray(scene.grip)} for scene in setting.scenes
        ],
        "versions": dict(results.versions),
        "tables": {
            name: table.astype(object).where(table.notna(), None).to_dict(orient="records")
            for tables in results.tables
            for name, table in tables.items()
        },
    }
