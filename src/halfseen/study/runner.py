"""One runner for all experiments: prepare once, repeat what is missing, tabulate."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, is_dataclass
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

from tqdm import tqdm

from halfseen.errors import HalfseenError
from halfseen.study.experiment import Experiment, Pieces, Setting, Tables, Timed
from halfseen.study.store import Store

PACKAGES = ("halfseen", "jax", "jaxlib", "mujoco", "numpy", "pandas", "scipy")


def versions() -> dict[str, str]:
    """Versions of the packages that the numbers depend on."""
    return {name: version(name) for name in PACKAGES}


def store_of(experiment: Experiment, setting: Setting, folder: Path, is_resumed: bool) -> Store:
    """Open the store of an experiment; more repetitions add pieces and change none."""
    fixed = asdict(setting) | {"scenes": [[scene.name, scene.hides.tolist()] for scene in setting.scenes]}
    fixed.pop("repetitions")
    design = design_of(experiment)
    design.pop("most_repetitions", None)
    fingerprint = {"design": design, "setting": fixed, "versions": versions()}
    return Store(folder / "progress" / experiment.name, fingerprint, is_resumed)


def design_of(experiment: Experiment) -> dict[str, Any]:
    """The configuration of an experiment."""
    return asdict(experiment) if is_dataclass(experiment) and not isinstance(experiment, type) else {}


def run(experiment: Experiment, setting: Setting, store: Store) -> Tables:
    """Run an experiment to its tables; pieces that are kept are read back.

    Repetitions are made in turn: two threads that execute compiled code at once can wait for one another for ever (seen
    with jaxlib 0.10).
    """
    measured = measured_of(experiment, setting, store)
    prepared = store.kept("prepared", lambda: experiment.prepare(setting))
    repetitions = []
    num = min(setting.repetitions, experiment.most_repetitions or setting.repetitions)
    for index in tqdm(range(num), desc=experiment.name, unit="rep", disable=None, leave=False):
        make = partial(experiment.repeat, setting, prepared, index)
        repetitions.append(store.kept(f"repetition-{index:05d}", make))
        _stop_if_abandoned()
    return experiment.tabulate(setting, Pieces(prepared, measured, repetitions))


def measured_of(experiment: Experiment, setting: Setting, store: Store) -> dict[str, Any]:
    """Times, measured once and kept: a resumed study reports what the killed one measured."""
    return store.kept("measured", lambda: experiment.measure(setting)) if isinstance(experiment, Timed) else {}


def run_all(
    experiments: Sequence[Experiment], setting: Setting, stores: Sequence[Store], num_jobs: int
) -> list[Tables]:
    """Run experiments, several at once in processes of their own where `num_jobs` is more than 1.

    Times are measured before, while nothing else runs. A process takes one experiment after the other, as what it
    compiled serves that experiment alone.
    """
    for experiment, store in zip(experiments, stores, strict=True):
        measured_of(experiment, setting, store)
    jobs = min(num_jobs, len(experiments))
    if jobs < 2:
        return [run(experiment, setting, store) for experiment, store in zip(experiments, stores, strict=True)]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        return list(pool.map(run, experiments, [setting] * len(experiments), stores))


def _stop_if_abandoned() -> None:
    """End a process whose study was killed: what it would go on to make, the resumed study makes as well."""
    parent = parent_process()
    if parent is not None and not parent.is_alive():
        raise HalfseenError("the study that asked for these repetitions has ended")
