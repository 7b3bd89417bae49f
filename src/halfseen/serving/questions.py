"""What a policy in service is asked about: covariates, objects of a table as a log has them, or a cloud in a form."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.arrays import Points, mapped
from halfseen.errors import HalfseenError, OutOfRangeError
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
)
from halfseen.serving.in_service import InService
from halfseen.serving.models import BODY, Cloud, Refusal, Table, model_of
from halfseen.serving.recording import Begun, RecordedTrajectories
from halfseen.tables.present import Present
from halfseen.world.log_checks import DISHWASHER, OPTIONAL_COLUMNS, PLACE_COLUMNS, TABLE
from halfseen.world.logs import objects_of, states_of
from halfseen.world.state import TableState

if TYPE_CHECKING:
    from halfseen.policies.table_observation import SeenLaw

Row = dict[str, Any]

LATEST_STAGE = 10_000
"""What is later is no stage."""
_NOTHING_DONE = {"robot": None, "action": None, "object": None, "probability": None}


@dataclass(frozen=True, eq=False)
class Seen:
    """What a policy is asked about.

    Parameters
    ----------
    decide
        Asks it.
    stage
        The stage to decide, from 1.
    begun
        To be recorded.
    names
        Of the objects, in the order of the numbers that actions have; none where nothing is acted on.
    said
        What labels told, in one sentence.
    """

    decide: Callable[[], Decision]
    stage: int
    begun: Begun = field(default_factory=Begun)
    names: Sequence[Any] = ()
    said: str = ""


def seen_in_state(
    service: InService,
    state: Mapping[str, Any],
    next_stage: int | None = None,
    last: Mapping[str, Any] | None = None,
) -> Seen:
    """Take a state as JSON has it.

    Parameters
    ----------
    service
        What decides.
    state
        Covariates by name, or what `Table` holds; and the stage, if it is not the first.
    next_stage
        The stage that is recorded next; None if nothing is recorded.
    last
        Covariates of the stage before, as they are recorded; None where none is.

    Raises
    ------
    HalfseenError
        It is not what the policy looks at.
    Refusal
        It says another stage than the one that is recorded next.
    """
    stage = checked_stage(state.get("stage", next_stage or 1), LATEST_STAGE, BODY)
    _check_next(stage, next_stage)
    if service.stored.is_table:
        objects = model_of(state, Table).objects
        present, names = present_of(service.stored, objects, stage)
        return Seen(lambda: service.decider.decide(present), stage, Begun(_covariates(state), objects), names)
    decider = service.decider
    assert isinstance(decider, NamedDecider), "what is not of tables is of named actions"
    policy = decider.policy
    full, filled = completed(policy, state, last)
    begun, texts = Begun(_covariates(full)), policy.categories.items()
    new = {name: given for name, of in texts if isinstance(given := full.get(name), str) and given not in of}
    known = known_covariates(policy, {**full, **{name: policy.categories[name][0] for name in new}}, BODY)
    if new:
        return Seen(partial(_refuse_new, new), stage, begun)
    return Seen(lambda: decider.decide_known(known, stage, filled), stage, begun)


def _covariates(state: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in state.items() if name not in Table.__struct_fields__}


def _refuse_new(new: Mapping[str, str]) -> Decision:
    name, given = next(iter(new.items()))
    raise OutOfRangeError(f"{name} is {given!r:.40}, which no state of the logs showed")


def _check_next(stage: int | None, next_stage: int | None) -> None:
    if next_stage is not None and stage not in (None, next_stage):
        raise Refusal(409, f"stage is {stage}, but the trajectory in progress has come to {next_stage}; leave it out")


def seen_in_cloud(
    service: InService, given: Cloud, law: "SeenLaw | None", trajectories: RecordedTrajectories | None = None
) -> Seen:
    """Take a cloud of a table that nothing is known of but this look, and what is recorded of its trajectory.

    Parameters
    ----------
    service
        What decides.
    given
        What is seen of it.
    law
        As `halfseen.policies.table_observation.see_table` takes it.
    trajectories
        What records; None if nothing is recorded, and then the cloud begins a trajectory.

    Raises
    ------
    HalfseenError
        The files cannot be read, or are not what the policy looks at; the folder of the cloud is left out of the line.
    Refusal
        The policy is not of tables, the stage is another than the one that is recorded next, or that cannot begin.
    """
    if not service.stored.is_table:
        looks_at = covariates_in_words(service.stored.policy)
        raise Refusal(415, f"the policy looks at {looks_at}, not at clouds; give a JSON object of these")
    from halfseen.policies.table_observation import Past, see_table

    stage, labels = given.stage or None, given.labels or None
    if trajectories is not None:
        _check_next(stage, trajectories.next_stage(is_of_cloud=True))
    so_far = None if trajectories is None else trajectories.so_far
    past = None if so_far is None else Past(so_far.logs, so_far.held)
    try:
        table = see_table(service.stored, given.cloud, past, stage, labels, law)
    except HalfseenError as error:
        raise type(error)(str(error).replace(f"{given.cloud.parent}/", "")) from error
    present, said = table.present, table.present.seen.replace(f"{given.cloud.parent}/", "")
    seen = Seen(lambda: service.decider.decide(present), present.stage, said=said)
    if trajectories is None:
        return seen
    before = () if so_far is None else so_far.objects
    rows, names = rows_of(present, table.view.places_m, before, counts_views=law is not None)
    columns = {"dirty_share": present.dirty_share}
    return replace(seen, begun=Begun({}, rows, columns, is_of_cloud=True), names=names)


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
