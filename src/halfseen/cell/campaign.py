"""Campaigns: many random tables, cleared by one policy in parallel processes, and their log.

A calibration is a campaign that lifts random objects until a given number of attempts have begun.

Each table is recorded into its own folder while it runs. After a kill, the recorded part can be read there, and the
next campaign into the same folder continues with the missing tables. Table k depends only on the seed and k, so the log
is bitwise identical for any number of processes.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import get_ident

import numpy as np

from halfseen.arrays import record
from halfseen.cell.calibration.attempts import HORIZON
from halfseen.cell.camera import PoseErrors
from halfseen.cell.episode import Follow, TeamRun, play
from halfseen.cell.live_cell import Stops
from halfseen.cell.model import Station
from halfseen.cell.rewards import Run
from halfseen.cell.table_state import Belief, no_grip
from halfseen.cell.workcell import Workcell
from halfseen.errors import ArgumentError, LogError
from halfseen.logs import LogRecorder, Logs, read_logs
from halfseen.logs.joining import joined
from halfseen.reading import json_of, read_text
from halfseen.scene.cups import draw_surface
from halfseen.scene.draw import random_table
from halfseen.shapes import Bool
from halfseen.workers import Pool
from halfseen.world import random
from halfseen.world.actions import ActionSpace, Verb, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy, PolicyDraw, uniformly
from halfseen.world.random import Key
from halfseen.world.state import TableState
from halfseen.writing import placed, refuse_unwritable, write_file

RUN_FILE = "run.json"  # result of a finished table, next to its recording
WHAT_FILE = "what.txt"  # description of a campaign, in its folder


@dataclass(frozen=True)
class Conditions:
    """Conditions of a campaign: its tables and the cell that clears them.

    Parameters
    ----------
    dirty_share
        Probability that a cup is dirty.
    frictions
        Smallest and largest friction of a cup on the pads, drawn log-uniformly [-].
    stations, grasping, errors, stops
        As for `Workcell`.
    """

    dirty_share: float = 0.6
    frictions: tuple[float, float] = (0.1, 0.6)
    stations: tuple[Station, ...] = (Station(),)
    grasping: str = "completed"
    errors: PoseErrors = PoseErrors()  # noqa: RUF009 - frozen
    stops: Stops | None = Stops()  # noqa: RUF009 - frozen

    def cell(self, seed: int, index: int) -> tuple[Workcell, Bool[np.ndarray, " N"]]:
        """Draw a table with its cell, and which cups are dirty.

        Parameters
        ----------
        seed, index
            Seed of the campaign and index of the table; the draw depends on nothing else.
        """
        rng = np.random.default_rng([seed, index])
        table = random_table(int(rng.integers(2**31)))
        is_dirty = rng.random(table.num_cups) < self.dirty_share
        surfaces = [draw_surface(cup, bool(dirty), rng) for cup, dirty in zip(table.cups, is_dirty, strict=True)]
        low, high = np.log(self.frictions).tolist()
        frictions = np.exp(rng.uniform(low, high, table.num_cups)).tolist()
        cell = Workcell(
            table,
            rng,
            surfaces,
            stations=self.stations,
            frictions=frictions,
            grasping=self.grasping,
            errors=self.errors,
            stops=self.stops,
        )
        return cell, is_dirty


@dataclass(frozen=True)
class Campaign:
    """A policy run on many tables.

    Parameters
    ----------
    policy, belief, tells_truth
        As for `play`.
    conditions
        Conditions of the tables.
    seed
        Seed of all draws.
    follow
        Makes the observer of each table, in this process; None for no observer.
    """

    policy: Policy
    belief: Belief
    conditions: Conditions
    seed: int
    tells_truth: bool = False
    follow: Follow | None = None

    def runs(self, tables: Sequence[int], folder: Path, pool: Pool) -> Iterator[tuple[int, Run]]:
        """Clear tables, record each below a folder, and yield each result as soon as it is available.

        Parameters
        ----------
        tables
            Numbers of the tables.
        folder
            Output folder; tables already finished there are not run again.
        pool
            Worker pool.

        Yields
        ------
        tuple of int and Run
            In the order of `tables`.
        """
        if pool.is_here:
            yield from zip(tables, pool.in_order(partial(self.run, folder=folder), tables), strict=True)
            return
        places = {index: folder / table_name(index) for index in tables}
        recorded = pool.in_order(self.recorded, [index for index in tables if not _is_over(places[index])])
        for index, place in places.items():
            if not _is_over(place):
                shutil.rmtree(place, ignore_errors=True)
                with placed(place) as fresh:
                    for name, content in next(recorded).items():
                        write_file(fresh / name, content)
            yield index, _run_of(place)

    def recorded(self, index: int) -> dict[str, bytes]:
        """Clear one table on a machine without access to the folder; return the recorded files by name."""
        with TemporaryDirectory() as name:
            self.run(index, Path(name))
            place = Path(name) / table_name(index)
            return {path.name: path.read_bytes() for path in sorted(place.iterdir())}

    def run(self, index: int, folder: Path) -> Run:
        """Clear one table, or read its result if it is finished.

        Parameters
        ----------
        index
            Number of the table.
        folder
            Folder of the recordings.
        """
        place = folder / table_name(index)
        if _is_over(place):
            return _run_of(place)
        shutil.rmtree(place, ignore_errors=True)
        cell, is_dirty = self.conditions.cell(self.seed, index)
        with LogRecorder(place) as recorder:
            trajectory = recorder.begin_trajectory(index, dirty_share=float(self.belief.config.dirty_share))
            key = random.fold_in(random.key_of(self.seed), index)
            follower = None if self.follow is None else self.follow(index, cell)
            run = play(
                cell,
                is_dirty,
                self.policy,
                self.belief,
                trajectory,
                key,
                tells_truth=self.tells_truth,
                on_decision=(lambda _: None) if follower is None else follower.decided,
            )
        if follower is not None:
            follower.ended(run)
        write_file(place / RUN_FILE, json.dumps(asdict(run), indent=1))
        return run


@contextmanager
def working_folder(target: Path, what: str, refuse: Callable[[], None] = lambda: None) -> Iterator[Path]:
    """Context manager of the folder for recordings of a running campaign; it is removed on success.

    Parameters
    ----------
    what
        Description of the campaign with everything that its tables depend on; only an identical campaign may resume.
    refuse
        Called once the folder is locked. It raises if the result may not be written, for example because a campaign
        that started at the same time has finished.

    Raises
    ------
    ArgumentError
        A different campaign was stopped there, one is running there, or the folder cannot be written.
    """
    place = target.absolute()
    folder = place.with_name(f"{place.name}.running")
    refuse_unwritable(folder)
    # A recorder locks its folder while its process lives, so no second campaign can run there.
    with LogRecorder(folder / "campaign"):
        described = folder / WHAT_FILE
        if not described.exists():
            try:
                refuse()
            except BaseException:
                shutil.rmtree(_aside(folder))
                raise
            write_file(described, what)
        elif (held := read_text(described)) != what:
            raise ArgumentError(
                f"{folder}: it holds another run that was stopped ({held[:500]}), and this run is {what}; "
                "repeat that command to continue it, remove the folder, or choose another --out"
            )
        yield folder
        done = _aside(folder)
    shutil.rmtree(done)


def _aside(folder: Path) -> Path:
    """Rename a folder while it is locked, so that a waiting process makes a new folder, which is not removed."""
    return folder.rename(folder.with_name(f"{folder.name}.{os.getpid()}-{get_ident()}"))


def logs_of(folder: Path, tables: Sequence[int]) -> Logs:
    """Read the recordings of tables as one log; tables cut before any decision are not in it.

    Raises
    ------
    LogError
        Every table was cut before any decision.
    """
    runs = {folder / table_name(index): _run_of(folder / table_name(index)) for index in tables}
    seen = [place for place, run in runs.items() if run.is_seen]
    if not seen:
        causes = ", ".join(sorted({run.cause for run in runs.values() if run.cause is not None}))
        raise LogError(
            f"{folder}: all {len(runs)} tables were cut ({causes}) before anything was decided, so there are no "
            "stages to read; run more tables, or fix what cuts them"
        )
    return joined([read_logs(place) for place in seen])


def _is_over(place: Path) -> bool:
    return (place / RUN_FILE).is_file()


def _run_of(place: Path) -> Run:
    try:
        run = json_of(read_text(place / RUN_FILE))
        return TeamRun(**run) if "num_collisions" in run else Run(**run)
    except (ValueError, TypeError) as error:
        raise LogError(
            f"{place / RUN_FILE}: it does not describe a run ({error}); remove {place} to run that table again"
        ) from error


def table_name(index: int) -> str:
    """Name of the folder of a table."""
    return f"table-{index:06d}"


@record
class LiftAtRandom:
    """Lifts a uniformly random object on the table; finishes if none is left."""

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose an action for each table."""
        actions = ActionSpace(state.num_objects)
        verbs = actions.verb(np.arange(actions.num_actions))
        is_lift = possible_actions(state) & (verbs == Verb.LIFT)
        return uniformly(np.where(is_lift.any(axis=-1, keepdims=True), is_lift, verbs == Verb.FINISH), key)


def attempts_of(
    num_attempts: int,
    seed: int,
    folder: Path,
    pool: Pool,
    conditions: Conditions = Conditions(),
    on_table: Callable[[int], None] = lambda _: None,
) -> Logs:
    """Run tables with random lifts and return their log.

    Parameters
    ----------
    num_attempts
        Tables are run until this many attempts have begun.
    folder
        Folder for recordings of running tables; a killed campaign resumes there.
    """
    belief = Belief(WorldConfig(horizon=HORIZON), no_grip)
    campaign = Campaign(LiftAtRandom(), belief, conditions, seed, tells_truth=True)
    begun: list[int] = []
    while sum(begun) < num_attempts:
        # A batch has most of the tables that are likely to be needed, as workers wait at its end: nothing may still be
        # recording when this returns.
        likely = int(0.8 * (num_attempts - sum(begun)) * len(begun) / max(sum(begun), 1))
        batch = range(len(begun), len(begun) + max(4 * pool.num_workers, likely))
        for _, run in campaign.runs(batch, folder, pool):
            begun.append(sum(run.verbs.values()))
            on_table(begun[-1])
    # Keep only as many tables as are needed, whatever the batch size.
    return logs_of(folder, range(1 + int(np.searchsorted(np.cumsum(begun), num_attempts))))
