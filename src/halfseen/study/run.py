"""The study from end to end: run experiments, write tables, figures and the report."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.figures import drawn
from halfseen.study.experiment import Experiment, Setting
from halfseen.study.experiments import EXPERIMENTS
from halfseen.study.report import StudyResults, report_of
from halfseen.study.runner import design_of, run_all, store_of
from halfseen.study.store import as_json
from halfseen.suggestions import did_you_mean
from halfseen.workers import Workers
from halfseen.workers.piece import versions
from halfseen.writing import held_alone, write_file


def chosen(names: Sequence[str], experiments: Sequence[Experiment] = EXPERIMENTS) -> tuple[Experiment, ...]:
    """Experiments of these names; all if there are none."""
    known = {each.name: each for each in experiments}
    for name in names:
        if name not in known:
            there = f"there are {', '.join(known)}{did_you_mean(name, known)}"
            raise ArgumentError(f"--only {name}: there is no such experiment; {there}")
    return tuple(each for each in experiments if not names or each.name in names)


def without_laws(experiments: Sequence[Experiment]) -> tuple[Experiment, ...]:
    """The same experiments, where what is learned is linear eq. 3 without laws."""
    every: Sequence[Any] = experiments
    return tuple(replace(each, laws=False) if hasattr(each, "laws") else each for each in every)


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
    setting = asdict(results.setting)
    return {
        "answer": results.answer,
        "sentences": {name: section.sentences for name, section in results.sections.items()},
        "experiments": {each.name: design_of(each) for each in results.experiments},
        "setting": {name: value for name, value in setting.items() if name not in ("scenes", "law")},
        "scenes": [
            {"name": scene.name, "hides": scene.hides.tolist(), "grip": np.asarray(scene.grip).tolist()}
            for scene in results.setting.scenes
        ],
        "versions": dict(results.versions),
        "tables": {
            name: table.astype(object).where(table.notna(), None).to_dict(orient="records")
            for tables in results.tables
            for name, table in tables.items()
        },
    }
