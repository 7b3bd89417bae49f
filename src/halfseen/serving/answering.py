"""A question, an answer: what `halfseen act --json` says, with the probability of what is done.

A policy that is warm is asked about covariates, the objects of a table as a log has them, or a cloud in a form.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import HalfseenError
from halfseen.policies import decider_of, read_policy
from halfseen.policies.decision import Decider, Decision
from halfseen.policies.exploration_table import ExplorationTable
from halfseen.policies.folder.kinds import kind_named
from halfseen.policies.folder.record import as_json
from halfseen.policies.folder.stored import UNDECIDED, StoredPolicy, refuse_team
from halfseen.policies.named_decider import NamedDecider, checked_stage, known_covariates
from halfseen.policies.ranges import middle_of
from halfseen.serving.limits import Refusal
from halfseen.serving.recording import Begun, RecordedTrajectories, taken, uniform_shares

MOST_WARMED = 12
"""Objects of the largest table that is compiled for before the first request; a larger one is when it comes."""


@dataclass(frozen=True, eq=False)
class InService:
    """A policy that answers; it never changes.

    Parameters
    ----------
    stored
        The policy.
    decider
        The same behind the port.
    digest
        What tells it from others: the first 12 digits of the SHA-256 of its record and its numbers.
    """

    stored: StoredPolicy
    decider: Decider
    digest: str

    @property
    def counts_views(self) -> bool:
        """Whether it learned from logs that count what has been in view, so that a cell's law tells what labels do."""
        return self.stored.is_table and self.stored.record["schema"].get("counts_views", False)


def taken_into_service(folder: Path, *, extrapolates: bool = False) -> InService:
    """Read a policy, check all of it, and let it decide once, so that no request waits for what loads late.

    Parameters
    ----------
    folder
        As `read_policy` takes it.
    extrapolates
        As `decider_of` takes it.

    Raises
    ------
    PolicyError
        It cannot be read, or decides for a team.
    """
    stored = read_policy(folder)
    refuse_team(stored, UNDECIDED, folder)
    decider = decider_of(stored, extrapolates=extrapolates)
    _warm(stored, decider)
    return InService(stored, decider, _digest(stored))


def _warm(stored: StoredPolicy, decider: Decider) -> None:
    """Decide once at each stage, or, of tables, for each number of objects in the logs: it is compiled then."""
    if isinstance(decider, NamedDecider):
        for stage in range(1, stored.horizon + 1):
            ranges = stored.ranges(stage)
            if ranges is not None:
                decider.decide_known({name: middle_of(seen) for name, seen in ranges.items()}, stage)
        return
    from halfseen.tables.present import first_state
    from halfseen.world.scene import Scene

    fewest, most = (stored.ranges(1) or {}).get("num_objects", (1, 0))
    for number in range(max(1, int(fewest)), min(int(most), MOST_WARMED) + 1):
        nothing_hidden = Scene(np.zeros((number, number)))
        decider.decide(first_state(nothing_hidden, stored.horizon, stored.record["schema"]["dirty_share"]))


def _digest(stored: StoredPolicy) -> str:
    digest = hashlib.sha256(as_json(stored.record))
    for name, array in sorted(kind_named(stored.record["kind"]).arrays_of(stored.policy).items()):
        digest.update(name.encode() + array.tobytes())
    return digest.hexdigest()[:12]


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


@dataclass(frozen=True, eq=False)
class Answering:
    """How decisions are taken and kept.

    Parameters
    ----------
    epsilon
        Share of decisions that are drawn at random, in [0, 1).
    table
        Which actions are drawn instead, and where; None where all are.
    rng
        What they are drawn with.
    trajectories
        Where they are recorded; None if they are not.
    """

    epsilon: float = 0.0
    table: ExplorationTable | None = None
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    trajectories: RecordedTrajectories | None = None

    def answer(self, service: InService, seen: Seen) -> dict[str, Any]:
        """Decide, and say so.

        Raises
        ------
        HalfseenError
            The policy cannot decide from this.
        """
        decided = seen.decide()
        shares = (
            uniform_shares(decided, self.epsilon)
            if self.table is None
            else self.table.shares(seen.begun.covariates, seen.stage)
        )
        made = taken(decided, shares, self.rng)
        decision, stored = made.decision, service.stored
        told: dict[str, Any] = {
            "action": decision.action,
            "probability": made.probability,
            "is_explored": made.is_explored,
            "stage": seen.stage,
            "horizon": stored.horizon,
            **vars(decision),
            "warnings": [*decision.warnings, *stored.doubts],
            "policy": service.digest,
        }
        if seen.told:
            told["seen"] = seen.told
        if seen.names:
            verb, _, number = str(decision.action).partition(" ")
            told |= {"verb": verb, "object": seen.names[int(number)] if number else None}
        return told

    def recorded(self, seen: Seen, told: dict[str, Any]) -> dict[str, Any]:
        """Record what was decided, where that is wanted, and say so.

        Raises
        ------
        Refusal
            It cannot be recorded; then nothing was decided.
        """
        return told if self.trajectories is None else told | {"trajectory": self.trajectories.decided(seen.begun, told)}
