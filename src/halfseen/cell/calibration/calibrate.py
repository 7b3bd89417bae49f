"""Calibrating a cell: it lifts what stands on fresh tables, at random, until so many attempts were begun."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from halfseen.arrays import record
from halfseen.cell.calibration.law import Law, fit_law
from halfseen.cell.campaign import Campaign, Conditions, logs_of
from halfseen.cell.table_state import Belief, no_grip
from halfseen.logs import Logs
from halfseen.workers import Pool
from halfseen.world.actions import ActionSpace, Verb, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, uniformly
from halfseen.world.random import Key
from halfseen.world.state import TableState


@record
class LiftAtRandom:
    """Lifts each object on the table with the same probability; finishes where none is left."""

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table."""
        actions = ActionSpace(state.num_objects)
        verbs = actions.verb(np.arange(actions.num_actions))
        is_lift = possible_actions(state) & (verbs == Verb.LIFT)
        return uniformly(np.where(is_lift.any(axis=-1, keepdims=True), is_lift, verbs == Verb.FINISH), key)


HORIZON = 12
"""Attempts on one table, at most."""


def attempts_of(
    num_attempts: int,
    seed: int,
    folder: Path,
    pool: Pool,
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
    pool
        Who clears the tables.
    conditions
        What the tables and the cell are like.
    on_table
        Called with the number of attempts on each table.
    """
    belief = Belief(WorldConfig(horizon=HORIZON), no_grip)
    campaign = Campaign(LiftAtRandom(), belief, conditions, seed, tells_truth=True)
    begun: list[int] = []
    while sum(begun) < num_attempts:
        # A batch is waited for to its end: nothing records any more when this returns.
        for _, run in campaign.runs(_batch(begun, num_attempts, pool.num_workers), folder, pool):
            begun.append(sum(run.verbs.values()))
            on_table(begun[-1])
    # As many tables as it takes, however many there were in a batch.
    return logs_of(folder, range(1 + int(np.searchsorted(np.cumsum(begun), num_attempts))))


def _batch(begun: Sequence[int], num_attempts: int, num_workers: int) -> range:
    """Tables that are begun next: most of those that are likely to be needed, as workers wait at the end of a batch."""
    likely = 0.8 * (num_attempts - sum(begun)) * len(begun) / max(sum(begun), 1)
    return range(len(begun), len(begun) + max(4 * num_workers, int(likely)))


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
