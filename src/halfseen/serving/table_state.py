"""Between where a trajectory stands and the objects of a table, as a stage of a log has them: there, and back."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from halfseen.arrays import Points, mapped
from halfseen.logs.recording_state import Schema
from halfseen.logs.trajectory_recorder import log_so_far
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.tables.present import Present
from halfseen.world.log_checks import DISHWASHER, OPTIONAL_COLUMNS, PLACE_COLUMNS, TABLE
from halfseen.world.logs import objects_of, states_of
from halfseen.world.state import TableState

Row = dict[str, Any]

_NOTHING_DONE = {"robot": None, "action": None, "object": None, "probability": None}


def present_of(stored: StoredPolicy, objects: Sequence[dict[str, Any]], stage: int) -> tuple[Present, list[Any]]:
    """Put a table together from its objects.

    Parameters
    ----------
    stored
        A policy of tables.
    objects
        A dict for each, with the columns that `halfseen.world.logs` writes.
    stage
        The stage to decide, from 1.

    Returns
    -------
    present : Present
        Where its trajectory stands.
    names : list
        Of the objects, by the numbers that actions have.

    Raises
    ------
    LogError
        They break a rule of tables.
    """
    _, columns = Schema().with_stage({}, list(objects), _NOTHING_DONE, "the request")
    begun = {"event": "stage", "trajectory": 1, "stage": 1, "at_s": 0.0, "columns": {}, **columns}
    states = states_of(log_so_far([begun]), stored.horizon)
    state = mapped(lambda leaf: leaf[0, 0], states)
    state = replace(state, steps_to_go=np.int32(stored.horizon - stage + 1))
    dirty_share = stored.record["schema"]["dirty_share"]
    return Present(state, stage, is_labelled=True, dirty_share=dirty_share), sorted(one["object"] for one in objects)


def rows_of(
    present: Present, places_m: Points, before: Sequence[Row] = (), *, counts_views: bool = False
) -> tuple[list[Row], list[int]]:
    """Put down the objects of a stage: all that ever came into view on its trajectory.

    They are named by numbers, counted in the order in which they came into view, so that a name stays with its object.

    Parameters
    ----------
    present
        Where the trajectory stands, its labels counted, before the action.
    places_m
        Where the objects are that are seen, the first of `present` [m].
    before
        The rows of the stage before, in the order of names; none if this is the first.
    counts_views
        Whether a law tells how much of an object was seen and how well it is gripped; else that is 0, and not written.

    Returns
    -------
    rows : list of dict
        In the order of names, with `PLACE_COLUMNS`. What the stage before had on the table and `present` lacks was
        washed.
    names : list of int
        Of the objects, by the numbers that actions have.
    """
    new = count(len(before))
    names = [next(new) if was < 0 else was for was in present.was or [-1] * present.state.num_objects]
    num_rows = next(new)
    nothing = [0.0] * num_rows
    rows = {row["object"]: _washed(row) | {"hidden_by": nothing} for row in before}
    for number, (name, row) in enumerate(zip(names, _rows_on_table(present.state, counts_views), strict=True)):
        place_m = (
            places_m[number].tolist() if number < len(places_m) else [before[name][axis] for axis in PLACE_COLUMNS]
        )
        hidden_by = np.zeros(num_rows)
        hidden_by[names] = row["hidden_by"]
        seen = {"hidden_by": hidden_by.tolist(), **dict(zip(PLACE_COLUMNS, place_m, strict=True))}
        rows[name] = {**row, "object": name, **seen}
    return [rows[name] for name in range(num_rows)], names


def _washed(row: Row) -> Row:
    """The row of an object that is not on the table any more."""
    gone = {**row, "location": DISHWASHER, "occlusion": 0.0}
    if row["location"] != TABLE:
        return gone
    tried = {
        "attempt_occlusions": [*row["attempt_occlusions"], row["occlusion"]],
        "attempt_succeeded": [*row["attempt_succeeded"], True],
    }
    return {**gone, **tried, "successes": row["successes"] + 1}


def _rows_on_table(state: TableState, counts_views: bool) -> list[Row]:
    """Rows of the objects of one state, as `halfseen.world.logs` writes them, in every stage the same columns."""
    stage = mapped(lambda leaf: leaf[None, None], state)
    table = objects_of(stage, np.zeros((1, 2), dtype=np.int64)).drop_columns(["trajectory", "stage"])
    zeros = dict.fromkeys(OPTIONAL_COLUMNS, 0.0) if counts_views else {}
    return [zeros | row for row in table.to_pylist()]
