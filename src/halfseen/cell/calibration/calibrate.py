"""Calibrating a cell: it lifts what stands on fresh tables, at random, until so many attempts were begun."""

from collections.abc import Callable, Iterator
from itertools import count, islice
from pathlib import Path

from halfseen.cell.calibration.law import Law, fit_law
from halfseen.cell.campaign import Campaign, Conditions, logs_of
from halfseen.cell.episode import Run
from halfseen.cell.table_state import Belief, no_grip
from halfseen.cell.trying import LiftAtRandom
from halfseen.logs import Logs
from halfseen.world.config import WorldConfig

HORIZON = 12
"""Attempts on one table, at most."""


def attempts_of(
    num_attempts: int,
    seed: int,
    folder: Path,
    num_workers: int,
    conditions: Conditions = Conditions(),  # noqa: B008 - frozen
    on_table: Callable[[int], None] = lambda _: None,
) -> Logs:
    """Let a cell try, and give its log.

    Parameters
    ----------
    num_attempts
        Tables follow one another until so many attempts were begun.
    seed
        Of everything that is drawn.
    folder
        Where tables are recorded while they run; a campaign that was killed goes on there.
    num_workers
        Processes.
    conditions
        What the tables and the cell are like.
    on_table
        Called with the number of attempts on each table.
    """
    belief = Belief(WorldConfig(horizon=HORIZON), no_grip)
    campaign = Campaign(LiftAtRandom(), belief, conditions, seed, tells_truth=True)
    tables, begun = [], 0
    for index, run in _in_batches(campaign, folder, num_workers):
        tables.append(index)
        begun += sum(run.verbs.values())
        on_table(sum(run.verbs.values()))
        if begun >= num_attempts:
            break
    return logs_of(folder, tables)


def _in_batches(campaign: Campaign, folder: Path, num_workers: int) -> Iterator[tuple[int, Run]]:
    """Tables without end; how many are under way at once changes nothing of any of them."""
    numbers = count()
    while True:
        yield from campaign.runs(list(islice(numbers, 4 * num_workers)), folder, num_workers)


def law_of(logs: Logs, conditions: Conditions = Conditions()) -> Law:  # noqa: B008 - frozen
    """Estimate the laws of a cell from what it tried.

    Parameters
    ----------
    logs
        As `attempts_of` gives them.
    conditions
        Under which it tried.
    """
    limit_s = 60.0 if conditions.stops is None else conditions.stops.limit_s
    return fit_law(logs, HORIZON, limit_s)
