"""From a request to what a policy decides from: covariates, the objects of a table as a log has them, or a cloud."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from halfseen.errors import HalfseenError
from halfseen.policies.decision import Decision
from halfseen.policies.named_decider import NamedDecider, checked_stage, known_covariates
from halfseen.serving.in_service import InService
from halfseen.serving.refusal import Refusal
from halfseen.serving.trajectories import Begun, RecordedTrajectories

if TYPE_CHECKING:
    from halfseen.policies.table_observation import SeenLaw

BODY = "the request"
OBJECTS, STAGE = "objects", "stage"
NO_TABLE = 'the policy is of tables; give {"objects": [...]} as a stage of a log has them, or a cloud as multipart'


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
    told
        What labels told, in one sentence.
    """

    decide: Callable[[], Decision]
    stage: int
    begun: Begun = field(default_factory=Begun)
    names: Sequence[Any] = ()
    told: str = ""


def seen_in_state(service: InService, state: Mapping[str, Any], next_stage: int | None = None) -> Seen:
    """Take a state as JSON has it.

    Parameters
    ----------
    service
        What decides.
    state
        Covariates by name, or `OBJECTS`; and `STAGE`, if it is not the first.
    next_stage
        The stage that is recorded next; None if nothing is recorded.

    Raises
    ------
    HalfseenError
        It is not what the policy looks at.
    Refusal
        It says another stage than the one that is recorded next.
    """
    stage = checked_stage(state.get(STAGE, next_stage or 1), service.stored.horizon, BODY)
    _check_next(stage, next_stage)
    covariates = {name: value for name, value in state.items() if name not in (STAGE, OBJECTS)}
    if service.stored.is_table:
        return _table(service, state, covariates, stage)
    decider = service.decider
    assert isinstance(decider, NamedDecider), "what is not of tables is of named actions"
    known = known_covariates(decider.policy, state, BODY)
    return Seen(lambda: decider.decide_known(known, stage), stage, Begun(covariates))


def _check_next(stage: int | None, next_stage: int | None) -> None:
    if next_stage is not None and stage not in (None, next_stage):
        raise Refusal(409, f"stage is {stage}, but the trajectory in progress has come to {next_stage}; leave it out")


def _table(service: InService, state: Mapping[str, Any], covariates: Mapping[str, Any], stage: int) -> Seen:
    objects = state.get(OBJECTS)
    if not isinstance(objects, list) or not objects or not all(isinstance(one, dict) for one in objects):
        raise Refusal(422, NO_TABLE)
    from halfseen.serving.table_state import present_of

    present, names = present_of(service.stored, objects, stage)
    return Seen(lambda: service.decider.decide(present), stage, Begun(covariates, objects), names)


def seen_in_cloud(
    service: InService,
    cloud: Path,
    labels: Path | None,
    stage: int | None,
    law: "SeenLaw | None",
    trajectories: RecordedTrajectories | None = None,
) -> Seen:
    """Take a cloud of a table that nothing is known of but this look, and what is recorded of its trajectory.

    Parameters
    ----------
    service
        What decides.
    cloud, labels, stage, law
        As `halfseen.policies.table_observation.see_table` takes them.
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
        looks_at = ", ".join(service.stored.policy.covariates) or "no covariates"
        raise Refusal(415, f"the policy looks at {looks_at}, not at clouds; give a JSON object of these")
    from halfseen.policies.table_observation import Past, see_table

    if trajectories is not None:
        _check_next(stage, trajectories.next_stage(is_of_cloud=True))
    so_far = None if trajectories is None else trajectories.so_far
    past = None if so_far is None else Past(so_far.logs, so_far.held)
    try:
        table = see_table(service.stored, cloud, past, stage, labels, law)
    except HalfseenError as error:
        raise type(error)(str(error).replace(f"{cloud.parent}/", "")) from error
    present, told = table.present, table.present.seen.replace(f"{cloud.parent}/", "")
    seen = Seen(lambda: service.decider.decide(present), present.stage, told=told)
    if trajectories is None:
        return seen
    from halfseen.serving.table_state import rows_of

    before = () if so_far is None else so_far.objects
    rows, names = rows_of(present, table.view.places_m, before, counts_views=law is not None)
    columns = {"dirty_share": present.dirty_share}
    return replace(seen, begun=Begun({}, rows, columns, is_of_cloud=True), names=names)
