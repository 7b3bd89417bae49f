"""States to decide on: covariates, objects of a table as in a log, or a cloud in a form."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.arrays import Points, mapped
from halfseen.errors import HalfseenError, OutOfRangeError, closest
from halfseen.learning.covariates import Categories
from halfseen.logs.recording_state import Schema
from halfseen.logs.trajectory_recorder import log_so_far
from halfseen.policies.decision import Decision
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.named_decider import (
    NamedDecider,
    checked_stage,
    completed,
    covariates_in_words,
    known_covariates,
    stage_of,
)
from halfseen.serving.in_service import InService
from halfseen.serving.models import BODY, CloudRequest, Refusal, TableRequest, model_of
from halfseen.serving.recording import Begun, RecordedTrajectories
from halfseen.tables.present import Present
from halfseen.world.log_checks import DISHWASHER, OPTIONAL_COLUMNS, PLACE_COLUMNS, TABLE
from halfseen.world.logs import objects_of, states_of
from halfseen.world.state import TableState

if TYPE_CHECKING:
    from halfseen.policies.table_observation import SeenLaw

Row = dict[str, Any]

LATEST_STAGE = 10_000
"""Largest number that is accepted as a stage."""
_NOTHING_DONE = {"robot": None, "action": None, "object": None, "probability": None}


@dataclass(frozen=True, eq=False)
class AskedState:
    """A state to decide on.

    Parameters
    ----------
    decide
        Asks the policy.
    stage
        The stage to decide, from 1.
    begun
        The stage to record.
    names
        Names of the objects, indexed by the numbers in actions; empty if actions have no object.
    said
        Summary of the labels, in one sentence.
    """

    decide: Callable[[], Decision]
    stage: int
    begun: Begun = field(default_factory=Begun)
    names: Sequence[Any] = ()
    said: str = ""


def seen_in_state(
    service: InService, state: Mapping[str, Any], trajectories: RecordedTrajectories | None = None
) -> AskedState:
    """Interpret a state from JSON.

    Parameters
    ----------
    service
        The policy.
    state
        Covariates by name, or the fields of `TableRequest`; and the stage, if it is not the first.
    trajectories
        The recorder; None if nothing is recorded.

    Raises
    ------
    HalfseenError
        The state does not fit the policy.
    Refusal
        Its stage differs from the next stage to record, or that stage cannot begin.
    """
    next_stage = None if trajectories is None else trajectories.next_stage(state.get("trajectory"))
    said = stage_of(state, BODY, getattr(service.stored.policy, "covariates", ()))
    stage = checked_stage(said if "stage" in state else next_stage or 1, LATEST_STAGE, BODY, "")
    _check_next(stage, next_stage)
    covariates = {name: value for name, value in state.items() if name not in ("stage", "trajectory")}
    if service.stored.is_table:
        objects = model_of(state, TableRequest).objects
        del covariates["objects"]
        present, names = present_of(service.stored, objects, stage)
        return AskedState(lambda: service.decider.decide(present), stage, Begun(covariates, objects), names)
    decider = service.decider
    assert isinstance(decider, NamedDecider), "what is not of tables is of named actions"
    policy = decider.policy
    full, filled = completed(policy, covariates, None if trajectories is None else trajectories.last)
    texts = policy.categories.items()
    new = {name: given for name, of in texts if isinstance(given := full.get(name), str) and given not in of}
    known = known_covariates(policy, {**full, **{name: policy.categories[name][0] for name in new}}, BODY)
    # A category may come as a number, and is text in the log; a number as a truth value, and others follow.
    ranges: Any = service.stored.ranges(1) or {}
    numbers = {name: int(at) for name, at in full.items() if isinstance(at, bool) and {*ranges.get(name, ())} - {0, 1}}
    texts_in_log = {name: at for name, at in known.items() if isinstance(at, str) and name not in new}
    begun = Begun({**full, **numbers, **texts_in_log})
    if new:
        return AskedState(partial(_refuse_new, new, policy.categories), stage, begun)
    return AskedState(lambda: decider.decide_known(known, stage, filled), stage, begun)


def _refuse_new(new: Mapping[str, str], categories: Categories) -> Decision:
    name, given = next(iter(new.items()))
    meant = closest(given, categories[name])
    they = "" if meant is None else f"; they have {meant!r:.40}"
    raise OutOfRangeError(f"{name} is {given!r:.40}, which does not occur in the logs{they}")


def _check_next(stage: int, next_stage: int | None) -> None:
    if next_stage == 1 < stage:
        stopped = "no trajectory is in progress, as a server that stops cuts it; begin a new one"
        raise Refusal(409, f"stage is {stage}, but {stopped}")
    if next_stage not in (None, stage):
        raise Refusal(409, f"stage is {stage}, but the trajectory in progress is at stage {next_stage}; leave it out")


def seen_in_cloud(
    service: InService, given: CloudRequest, law: "SeenLaw | None", trajectories: RecordedTrajectories | None = None
) -> AskedState:
    """Interpret a cloud of a table, given only this view and the recorded trajectory.

    Parameters
    ----------
    service
        The policy.
    given
        The view.
    law
        As in `halfseen.policies.table_observation.see_table`.
    trajectories
        The recorder; None if nothing is recorded, so that the cloud begins a trajectory.

    Raises
    ------
    HalfseenError
        The files cannot be read, or do not fit the policy; the message omits the folder of the cloud.
    Refusal
        The policy is not of tables, the stage differs from the next stage to record, or that stage cannot begin.
    """
    if not service.stored.is_table:
        looks_at = covariates_in_words(service.stored.policy)
        raise Refusal(415, f"the policy looks at {looks_at}, not at clouds; give a JSON object of these")
    from halfseen.policies.table_observation import Past, see_table

    next_stage = None if trajectories is None else trajectories.next_stage(given.trajectory, is_of_cloud=True)
    stage = checked_stage(given.stage or next_stage or 1, LATEST_STAGE, BODY, "")
    _check_next(stage, next_stage)
    so_far = None if trajectories is None else trajectories.so_far
    past = None if so_far is None else Past(so_far.logs, so_far.held)
    try:
        # Beyond its horizon the policy steps back, but what is seen is still recorded.
        horizon = max(service.stored.horizon, stage)
        table = see_table(service.stored, given.cloud, past, stage, given.labels or None, law, horizon)
    except HalfseenError as error:
        raise type(error)(str(error).replace(f"{given.cloud.parent}/", "")) from error
    present, said = table.present, table.present.seen.replace(f"{given.cloud.parent}/", "")
    seen = AskedState(lambda: service.decider.decide(present), present.stage, said=said)
    if trajectories is None:
        return seen
    before = () if so_far is None else so_far.objects
    rows, names = rows_of(present, table.view.places_m, before, counts_views=law is not None)
    columns = {"dirty_share": present.dirty_share}
    return replace(seen, begun=Begun({}, rows, columns, is_of_cloud=True), names=names)


def present_of(stored: StoredPolicy, objects: Sequence[dict[str, Any]], stage: int) -> tuple[Present, list[Any]]:
    """Build the state of a table from its objects.

    Parameters
    ----------
    stored
        A policy of tables.
    objects
        A dict per object, with the columns of `halfseen.world.logs`.
    stage
        The stage to decide, from 1.

    Returns
    -------
    present : Present
        Current state of its trajectory.
    names : list
        Names of the objects, indexed by the numbers in actions.

    Raises
    ------
    LogError
        The objects break a rule of tables.
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
    """Rows for the objects of a stage: all that ever came into view in its trajectory.

    Objects are named by numbers in the order in which they came into view, so that each keeps its name.

    Parameters
    ----------
    present
        State of the trajectory before the action, including the labels.
    places_m
        Positions of the visible objects, which come first in `present` [m].
    before
        Rows of the previous stage, in the order of names; empty for the first stage.
    counts_views
        Whether a law models the share in view and the grip of an object; otherwise both are 0 and not written.

    Returns
    -------
    rows : list of dict
        Rows in the order of names, with `PLACE_COLUMNS`. An object that was on the table and is not in `present` was
        washed.
    names : list of int
        Names of the objects, indexed by the numbers in actions.
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
    """The row of an object that is no longer on the table."""
    gone = {**row, "location": DISHWASHER, "occlusion": 0.0}
    if row["location"] != TABLE:
        return gone
    tried = {
        "attempt_occlusions": [*row["attempt_occlusions"], row["occlusion"]],
        "attempt_succeeded": [*row["attempt_succeeded"], True],
    }
    return {**gone, **tried, "successes": row["successes"] + 1}


def _rows_on_table(state: TableState, counts_views: bool) -> list[Row]:
    """Rows of the objects of a state, as in `halfseen.world.logs`, with the same columns in every stage."""
    stage = mapped(lambda leaf: leaf[None, None], state)
    table = objects_of(stage, np.zeros((1, 2), dtype=np.int64)).drop_columns(["trajectory", "stage"])
    zeros = dict.fromkeys(OPTIONAL_COLUMNS, 0.0) if counts_views else {}
    return [zeros | row for row in table.to_pylist()]
