"""One runner for all experiments: prepare once, repeat what is missing, tabulate."""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from dataclasses import asdict, is_dataclass
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import HalfseenError
from halfseen.progress import Progress, Telling, telling
from halfseen.study.experiment import Experiment, PieceOf, Pieces, Setting, Tables, Timed
from halfseen.study.store import Store

PACKAGES = ("halfseen", "jax", "jaxlib", "mujoco", "numpy", "pandas", "scipy")
TABULATING = 0.1
"""What measuring and tabulating an experiment take, where its repetitions take 1: about as long for each of them."""
LOOK_S = 0.5
"""Between two looks at how far the processes have come [s]."""


def versions() -> dict[str, str]:
    """Versions of the packages that the numbers depend on."""
    return {name: version(name) for name in PACKAGES}


def store_of(experiment: Experiment, setting: Setting, folder: Path, is_resumed: bool) -> Store:
    """Open the store of an experiment; more repetitions add pieces and change none."""
    scenes = [[scene.name, scene.hides.tolist(), np.asarray(scene.grip).tolist()] for scene in setting.scenes]
    # Of the law the numbers count, and not where it lies.
    fixed = asdict(setting) | {"scenes": scenes, "law": setting.law is not None}
    fixed.pop("repetitions")
    design = design_of(experiment)
    design.pop("most_repetitions", None)
    fingerprint = {"design": design, "setting": fixed, "versions": versions()}
    return Store(folder / "progress" / experiment.name, fingerprint, is_resumed)


def design_of(experiment: Experiment) -> dict[str, Any]:
    """The configuration of an experiment."""
    return asdict(experiment) if is_dataclass(experiment) and not isinstance(experiment, type) else {}


def run(
    experiment: Experiment, setting: Setting, store: Store, on_repetition: Callable[[], object] = lambda: None
) -> Tables:
    """Run an experiment to its tables; pieces that are kept are read back.

    Repetitions are made in turn: two threads that execute compiled code at once can wait for one another for ever (seen
    with jaxlib 0.10).
    """
    measured = measured_of(experiment, setting, store)
    repetitions = []
    for index in range(num_of(experiment, setting)):
        repetitions.append(repetition_of(experiment, setting, store, index))
        on_repetition()
    return experiment.tabulate(setting, Pieces(_prepared(experiment, setting, store), measured, repetitions))


def num_of(experiment: Experiment, setting: Setting) -> int:
    """Repetitions of an experiment."""
    return min(setting.repetitions, experiment.most_repetitions or setting.repetitions)


def repetition_of(experiment: Experiment, setting: Setting, store: Store, index: int) -> PieceOf:
    """Make one repetition, or read it back."""
    prepared = _prepared(experiment, setting, store)
    return store.kept(f"repetition-{index:05d}", lambda: experiment.repeat(setting, prepared, index))


def _prepared(experiment: Experiment, setting: Setting, store: Store) -> PieceOf:
    return store.kept("prepared", lambda: experiment.prepare(setting))


def measured_of(experiment: Experiment, setting: Setting, store: Store) -> dict[str, Any]:
    """Times, measured once and kept: a resumed study reports what the killed one measured."""
    return store.kept("measured", lambda: experiment.measure(setting)) if isinstance(experiment, Timed) else {}


def run_all(
    experiments: Sequence[Experiment], setting: Setting, stores: Sequence[Store], num_jobs: int
) -> list[Tables]:
    """Run experiments, their repetitions in several processes at once where `num_jobs` is more than 1.

    Times are measured while nothing else runs: after that, when what is timed has been compiled.
    """
    with Progress(len(experiments) * (1 + TABULATING), "study") as bar:
        if num_jobs > 1:
            _repeat_in_processes(experiments, setting, stores, num_jobs, bar)
        tables = []
        for experiment, store in zip(experiments, stores, strict=True):
            bar.begin(f"study, {experiment.name}", 0)
            share = 0 if num_jobs > 1 else 1 / num_of(experiment, setting)
            tables.append(run(experiment, setting, store, partial(bar.update, share)))
            bar.update(TABULATING)
    return tables


def _repeat_in_processes(
    experiments: Sequence[Experiment], setting: Setting, stores: Sequence[Store], num_jobs: int, bar: Progress
) -> None:
    """Make all repetitions in processes of their own; which process makes one changes nothing in it."""
    # Those of few repetitions, which are long, come first, so that all processes end together.
    pairs = sorted(zip(experiments, stores, strict=True), key=lambda pair: num_of(pair[0], setting))
    context = get_context("spawn")
    begun, over = context.Array("i", len(pairs)), context.Array("i", len(pairs))
    nums = [num_of(experiment, setting) for experiment, _ in pairs]
    with ProcessPoolExecutor(num_jobs, context, initializer=_share, initargs=(begun, over)) as pool:
        workers = [pool.submit(_work, pairs, setting) for _ in range(num_jobs)]
        while wait(workers, LOOK_S).not_done:
            bar.reach(sum(done / num for done, num in zip(over[:], nums, strict=True)))
        for worker in workers:
            worker.result()


_shared: dict[str, Any] = {}


def _share(begun: Any, over: Any) -> None:
    _shared.update(begun=begun, over=over)


def _work(pairs: Sequence[tuple[Experiment, Store]], setting: Setting) -> None:
    """Make repetitions until all are begun."""
    nums, own = [num_of(experiment, setting) for experiment, _ in pairs], None
    while True:
        with _shared["begun"].get_lock():
            own = next_of(_shared["begun"][:], nums, own)
            if own is None:
                return
            index = _shared["begun"][own]
            _shared["begun"][own] += 1
        experiment, store = pairs[own]
        with telling(Telling.NOTHING):
            repetition_of(experiment, setting, store, index)
        with _shared["over"].get_lock():
            _shared["over"][own] += 1
        _stop_if_abandoned()


def next_of(begun: Sequence[int], nums: Sequence[int], own: int | None) -> int | None:
    """Choose the experiment of which a process makes one more repetition; None if all repetitions are begun.

    It stays with its own, for which everything is compiled. After that it takes one that nobody began, the first; or
    else helps with the one of which most are left.
    """
    left = [num - done for num, done in zip(nums, begun, strict=True)]
    if own is not None and left[own]:
        return own
    fresh = [k for k, done in enumerate(begun) if not done and left[k]]
    most = max(range(len(left)), key=lambda k: left[k])
    return fresh[0] if fresh else most if left[most] else None


def _stop_if_abandoned() -> None:
    """End a process whose study was killed: what it would go on to make, the resumed study makes as well."""
    parent = parent_process()
    if parent is not None and not parent.is_alive():
        raise HalfseenError("the study that asked for these repetitions has ended")
