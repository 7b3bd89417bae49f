"""Runs of the study: prepare once, make missing repetitions, tabulate, write tables, figures and the report.

Finished work is kept: each piece is one file, written atomically, so that a killed study can be resumed.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError, did_you_mean
from halfseen.figures import drawn
from halfseen.progress import Progress
from halfseen.reading import NUMBERS, json_of, read_text, reason_of
from halfseen.study.experiment import Experiment, Piece, Pieces, Tables
from halfseen.study.experiments import EXPERIMENTS
from halfseen.study.report import StudyResults, report_of
from halfseen.study.setting import Setting
from halfseen.workers import Workers
from halfseen.workers.pool import versions
from halfseen.writing import held_alone, write_file

FINGERPRINT = "design.json"
PREPARED = "prepared"
FORMAT = 2  # of pieces; those of another are not read
TABULATING = 0.1
"""Time for measuring and tabulating an experiment, relative to its repetitions; about the same for each of them."""
MOST_AT_ONCE = 8  # repetitions that a worker makes in a row: short ones together take a few seconds


def as_json(value: Any) -> str:
    """Serialise a value; the same value gives the same bytes, and NaN is refused."""
    plain = json.dumps(
        value, indent=1, sort_keys=True, allow_nan=False, default=lambda array: np.asarray(array).tolist()
    )
    return plain + "\n"


class Store:
    """The folder where an experiment keeps its pieces; pieces of another `fingerprint` are never mixed in.

    A piece is kept with a digest of itself and of its study. A piece that was changed, or that another study wrote into
    the same folder in the meantime, is refused.
    """

    def __init__(self, folder: Path, fingerprint: dict[str, Any], is_resumed: bool) -> None:
        self.folder = folder
        claim, path = as_json(fingerprint), folder / FINGERPRINT
        try:
            if not is_resumed and folder.exists():
                if not path.is_file() and any(folder.iterdir()):
                    raise ArgumentError(
                        f"--out: {folder} holds no study ({FINGERPRINT} is missing), so it is not removed; name "
                        "another folder"
                    )
                shutil.rmtree(folder)
            held = read_text(path) if path.exists() else claim
        except (OSError, UnicodeDecodeError) as error:
            raise ArgumentError(
                f"--out {folder}: cannot be written ({reason_of(error)}); name a writable folder"
            ) from error
        if held != claim:
            raise ArgumentError(
                f"--resume: {folder} belongs to a study of another design, seed or version; leave --resume out "
                "to begin again, or name another --out"
            )
        write_file(path, claim)
        self._claim = claim

    def has(self, name: str) -> bool:
        """Whether a piece is there."""
        return self._file(name).exists()

    def keep(self, name: str, piece: Any) -> None:
        """Keep a piece."""
        write_file(self._file(name), as_json({"piece": piece, "sha256": self._digest(piece)}))

    def read(self, name: str) -> Any:
        """Read a piece.

        Raises
        ------
        ArgumentError
            The piece cannot be read, was changed, or is of another study.
        """
        path = self._file(name)
        try:
            kept = json_of(read_text(path, NUMBERS))
            if not (isinstance(kept, dict) and kept.get("sha256") == self._digest(kept.get("piece"))):
                raise ValueError("it was changed, or written by another study")
        except (OSError, ValueError) as error:
            raise ArgumentError(
                f"--out: {path} cannot be read ({reason_of(error)}); remove it and run again with --resume"
            ) from error
        return kept["piece"]

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        """Read a piece, and make it first if it is missing; a new piece is returned as it would be read."""
        if not self.has(name):
            self.keep(name, make())
        return self.read(name)

    def _digest(self, piece: Any) -> str:
        return hashlib.sha256((self._claim + as_json(piece)).encode()).hexdigest()

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.json"


def store_of(experiment: Experiment, setting: Setting, folder: Path, is_resumed: bool) -> Store:
    """Open the store of an experiment; more repetitions add pieces and change none."""
    # The fingerprint has the numbers of the law, not its location.
    fixed = asdict(setting) | {"law": setting.law is not None, "repetitions": None}
    design = asdict(experiment) | {"most_repetitions": None}
    fingerprint = {"design": design, "setting": fixed, "versions": versions(), "format": FORMAT}
    return Store(folder / "progress" / experiment.name, fingerprint, is_resumed)


def repetition(index: int) -> str:
    """Name of the piece of a repetition."""
    return f"repetition-{index:05d}"


class Run(NamedTuple):
    """An experiment with its store and its number of repetitions."""

    experiment: Experiment
    store: Store
    num: int

    def tabulated(self, setting: Setting) -> Tables:
        """Make the tables from the stored pieces; a resumed study keeps the times measured before it was killed."""
        repetitions = [self.store.read(repetition(index)) for index in range(self.num)]
        measured = self.store.kept("measured", lambda: self.experiment.measure(setting))
        return self.experiment.tabulate(setting, Pieces(self.store.read(PREPARED), measured, repetitions))


def run_all(runs: Sequence[Run], setting: Setting, workers: Workers) -> list[Tables]:
    """Run experiments, with repetitions made by workers.

    Times are measured while nothing else runs: at the end, when the timed code has been compiled.
    """
    # Of what begins together, experiments with few repetitions, which are long, come first.
    in_order = sorted(runs, key=lambda run: run.num)
    with Progress(len(runs) * (1 + TABULATING), "study, prepare") as bar:
        with workers.ready() as pool:
            left = [run for run in in_order if not run.store.has(PREPARED)]
            for number, piece in pool.each(methodcaller("prepare", setting), [run.experiment for run in left]):
                left[number].store.keep(PREPARED, piece)
            missing = [[k for k in range(run.num) if not run.store.has(repetition(k))] for run in in_order]
            bar.begin("study", sum(1.0 - len(those) / run.num for run, those in zip(in_order, missing, strict=True)))
            todo = side_by_side([in_rows(those, pool.num_workers) for those in missing])
            ready = [(run.experiment, run.store.read(PREPARED)) for run in in_order]
            for number, pieces in pool.each(partial(_repeated, setting, ready), todo):
                k, some = todo[number]
                for index, piece in zip(some, pieces, strict=True):
                    in_order[k].store.keep(repetition(index), piece)
                bar.update(len(some) / in_order[k].num)
        tables = []
        for run in runs:
            bar.begin(f"study, {run.experiment.name}", 0)
            tables.append(run.tabulated(setting))
            bar.update(TABULATING)
    return tables


def _repeated(
    setting: Setting, ready: Sequence[tuple[Experiment, Piece]], some: tuple[int, Sequence[int]]
) -> list[Piece]:
    """Make some repetitions of one of the experiments; the worker does not affect the results."""
    experiment, prepared = ready[some[0]]
    return [experiment.repeat(setting, prepared, index) for index in some[1]]


def in_rows(indices: Sequence[int], num_workers: int) -> list[Sequence[int]]:
    """Divide repetitions into batches for one worker each: larger ones if there are many, so that all end together."""
    length = max(1, min(MOST_AT_ONCE, len(indices) // (8 * num_workers)))
    return [indices[begin : begin + length] for begin in range(0, len(indices), length)]


def side_by_side(rows: Sequence[Sequence[Sequence[int]]]) -> list[tuple[int, Sequence[int]]]:
    """Order the batches so that all experiments are equally far at any time: the speed so far is that of the rest."""
    placed = [(j / len(each), k, some) for k, each in enumerate(rows) for j, some in enumerate(each)]
    return [(k, some) for _, k, some in sorted(placed)]


def chosen(names: Sequence[str], experiments: Sequence[Experiment] = EXPERIMENTS) -> tuple[Experiment, ...]:
    """Experiments of these names; all if no names are given."""
    known = {each.name: each for each in experiments}
    for name in names:
        if name not in known:
            there = f"give one of {', '.join(known)}{did_you_mean(name, known)}"
            raise ArgumentError(f"--only {name}: unknown experiment; {there}")
    return tuple(each for each in experiments if not names or each.name in names)


def without_laws(experiments: Sequence[Any]) -> tuple[Experiment, ...]:
    """The same experiments with linear eq. 3, without laws, as the learned policy."""
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
    """Run experiments and write all results to a folder.

    Parameters
    ----------
    setting
        The shared setting.
    folder
        Destination: report.html, tables as .csv, figures as .svg and .png, study.json; and ``progress/``, from which a
        killed study is resumed.
    experiments
        The experiments to run.
    is_resumed
        Continue a killed study.
    workers
        The workers for the repetitions; by default one process per core.
    pictures
        PNG of each scene by its name, for the report.

    Raises
    ------
    ArgumentError
        The folder cannot be written, another study writes to it, or `is_resumed` and it holds another study.
    WorkerError
        The workers are unavailable.
    """
    with held_alone(folder / "progress", "study"):
        most = setting.repetitions
        runs = [
            Run(each, store_of(each, setting, folder, is_resumed), min(most, each.most_repetitions or most))
            for each in experiments
        ]
        tables = run_all(runs, setting, workers)
        sections = {each.name: each.section(setting, of) for each, of in zip(experiments, tables, strict=True)}
        results = StudyResults(setting, tuple(experiments), tuple(tables), sections, versions())
        write_results(results, pictures or {}, folder)
    return results


def write_results(results: StudyResults, pictures: Mapping[str, bytes], folder: Path) -> None:
    """Write tables, figures and report, each atomically."""
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
        "experiments": {each.name: asdict(each) for each in results.experiments},
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
