"""Many fresh tables, cleared by one policy in as many processes as there are cores, and their log.

A calibration is a campaign that lifts what stands there, at random, until so many attempts were begun.

Each table is recorded into a folder of its own while it runs. What a kill leaves behind can be read there, and the next
campaign into the same folder goes on with the tables that are missing: table k is drawn from the seed and k alone, so
that the log is the same, to the last bit, in any number of processes.
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
from halfseen.cell.camera import Errors
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
from halfseen.world.policy import Decision, Policy, uniformly
from halfseen.world.random import Key
from halfseen.world.state import TableState
from halfseen.writing import placed, refuse_unwritable, write_file

RUN_FILE = "run.json"  # beside the recording of a table once it is over: what came of it
WHAT_FILE = "what.txt"  # in the folder of a campaign: what runs there


@dataclass(frozen=True)
class Conditions:
    """What the tables of a campaign, and the cell that clears them, are like.

    Parameters
    ----------
    dirty_share
        Probability that a cup is dirty.
    frictions
        Of a cup on pads, drawn evenly in its logarithm: smallest and largest [-].
    stations, grasping, errors, stops
        As for `Workcell`.
    """

    dirty_share: float = 0.6
    frictions: tuple[float, float] = (0.1, 0.6)
    stations: tuple[Station, ...] = (Station(),)
    grasping: str = "completed"
    errors: Errors = Errors()  # noqa: RUF009 - frozen
    stops: Stops | None = Stops()  # noqa: RUF009 - frozen

    def cell(self, seed: int, index: int) -> tuple[Workcell, Bool[np.ndarray, " N"]]:
        """Draw a table with its cell, and which cups are dirty.

        Parameters
        ----------
        seed, index
            Of the campaign, and of the table in it; nothing else decides.
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
    """A policy at work on many tables.

    Parameters
    ----------
    policy, belief, tells_truth
        As for `play`.
    conditions
        What the tables are like.
    seed
        Of everything that is drawn.
    follow
        Who follows each table, in this process; None for nobody.
    """

    policy: Policy
    belief: Belief
    conditions: Conditions
    seed: int
    tells_truth: bool = False
    follow: Follow | None = None

    def runs(self, tables: Sequence[int], folder: Path, pool: Pool) -> Iterator[tuple[int, Run]]:
        """Clear tables, record each below a folder, and tell what came of each as soon as it is over.

        Parameters
        ----------
        tables
            Their numbers.
        folder
            Where to; tables that are over there already are not run again.
        pool
            Who clears them.

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
        """Clear one table on a machine that has other folders, and give what was recorded, by the name of the file."""
        with TemporaryDirectory() as name:
            self.run(index, Path(name))
            place = Path(name) / table_name(index)
            return {path.name: path.read_bytes() for path in sorted(place.iterdir())}

    def run(self, index: int, folder: Path) -> Run:
        """Clear one table, or read what came of it.

        Parameters
        ----------
        index
            Its number.
        folder
            Where it is recorded.
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
    """Give the folder in which tables are recorded while a campaign runs; it goes when all went well.

    Parameters
    ----------
    what
        What runs there, with all that its tables depend on: only the same goes on with what is there.
    refuse
        Called once no other campaign can run there; raises where the result may not be written: one that began at the
        same time may be done by now.

    Raises
    ------
    ArgumentError
        Another campaign runs there or was stopped there, or it cannot be written.
    """
    place = target.absolute()
    folder = place.with_name(f"{place.name}.running")
    refuse_unwritable(folder)
    # A recorder holds its folder for as long as its process lives: no second campaign gets in.
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
                f"{folder}: it holds what was stopped of another run ({held[:500]}), and this is "
                f"{what}; call that again to go on with it, remove the folder, or choose another --out"
            )
        yield folder
        done = _aside(folder)
    shutil.rmtree(done)


def _aside(folder: Path) -> Path:
    """Give a folder another name, while it is ours: anyone who waits for it begins a new one, which is not removed."""
    return folder.rename(folder.with_name(f"{folder.name}.{os.getpid()}-{get_ident()}"))


def logs_of(folder: Path, tables: Sequence[int]) -> Logs:
    """Read what was recorded of tables, as one log; those that were cut before anything was decided are in none.

    Raises
    ------
    LogError
        Every table was cut before anything was decided.
    """
    runs = {folder / table_name(index): _run_of(folder / table_name(index)) for index in tables}
    seen = [place for place, run in runs.items() if run.is_seen]
    if not seen:
        causes = ", ".join(sorted({run.cause for run in runs.values() if run.cause is not None}))
        raise LogError(
            f"{folder}: all {len(runs)} tables were cut ({causes}) before anything was decided, so there is nothing to "
            "read; run more tables, or mend what cuts them"
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
            f"{place / RUN_FILE}: it tells of no run ({error}); remove {place}, and it is made again"
        ) from error


def table_name(index: int) -> str:
    """Name of the folder of a table."""
    return f"table-{index:06d}"


@record
class LiftAtRandom:
    """Lifts each object on the table with the same probability; finishes where none is left."""

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table."""
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
    """Let a cell try, and give its log.

    Parameters
    ----------
    num_attempts
        Tables follow one another until so many attempts were begun.
    folder
        Where tables are recorded while they run; a campaign that was killed goes on there.
    """
    belief = Belief(WorldConfig(horizon=HORIZON), no_grip)
    campaign = Campaign(LiftAtRandom(), belief, conditions, seed, tells_truth=True)
    begun: list[int] = []
    while sum(begun) < num_attempts:
        # Most tables that are likely to be needed, as workers wait at the end of a batch: nothing records any more when
        # this returns.
        likely = int(0.8 * (num_attempts - sum(begun)) * len(begun) / max(sum(begun), 1))
        batch = range(len(begun), len(begun) + max(4 * pool.num_workers, likely))
        for _, run in campaign.runs(batch, folder, pool):
            begun.append(sum(run.verbs.values()))
            on_table(begun[-1])
    # As many tables as it takes, however many there were in a batch.
    return logs_of(folder, range(1 + int(np.searchsorted(np.cumsum(begun), num_attempts))))
