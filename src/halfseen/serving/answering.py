"""A question, an answer: what `halfseen act --json` says, with the probability of what is done.

A policy that is warm is asked about covariates, the objects of a table as a log has them, or a cloud in a form.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from msgspec import UNSET

from halfseen.errors import HalfseenError, OutOfRangeError
from halfseen.monitoring.dealing import POLICY, RULE
from halfseen.policies.decision import Decision
from halfseen.policies.named_decider import NamedDecider, checked_stage, completed, known_covariates
from halfseen.policies.rule_files import ExplorationTable
from halfseen.serving.comparing import Comparison
from halfseen.serving.in_service import InService, SteppedBack, Tally, decided_by_rule
from halfseen.serving.models import BODY, Cloud, Decided, Refusal, Table, model_of
from halfseen.serving.recording import Begun, RecordedTrajectories, Taken, chance_of, taken, uniform_shares
from halfseen.serving.watching import Recent

if TYPE_CHECKING:
    from halfseen.policies.table_observation import SeenLaw

NOBODY = (
    "the folder of the policy, of an earlier version, does not say what its log did most; learn it again, or serve it "
    "with --fall-back RULE"
)
LATEST_STAGE = 10_000
"""What is later is no stage."""


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
        return _table(service, state, _covariates(state), stage)
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


def _table(service: InService, state: Mapping[str, Any], covariates: Mapping[str, Any], stage: int) -> Seen:
    objects = model_of(state, Table).objects
    from halfseen.serving.table_state import present_of

    present, names = present_of(service.stored, objects, stage)
    return Seen(lambda: service.decider.decide(present), stage, Begun(covariates, objects), names)


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
        looks_at = ", ".join(service.stored.policy.covariates) or "no covariates"
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
    tally
        How often the rule decided.
    comparison
        Deals trajectories to the policy or the rule of today; None where all are the policy's.
    recent
        What happened last.
    """

    epsilon: float = 0.0
    table: ExplorationTable | None = None
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    trajectories: RecordedTrajectories | None = None
    tally: Tally = field(default_factory=Tally)
    comparison: Comparison | None = None
    recent: Recent = field(default_factory=Recent)

    def answer(self, service: InService, seen: Seen, decided: Decision | SteppedBack) -> Decided:
        """Put what the policy decides, or what the rule does in its place, into an answer.

        Raises
        ------
        Refusal
            The policy does not decide, and nobody knows what does in its place.
        """
        back = decided if isinstance(decided, SteppedBack) else None
        made = self._taken(service, seen, decided)
        arm: Any = UNSET
        if self.comparison is not None:
            made, arm = self._dealt(self.comparison, seen, decided, made)
            back = back if arm == POLICY else None
        self.tally.add(back)
        verb, _, number = str(made.decision.action).partition(" ")
        acted = {"verb": verb, "object": seen.names[int(number)] if number else None} if seen.names else {}
        return Decided(
            **{**vars(made.decision), "warnings": [*made.decision.warnings, *service.stored.doubts]},
            probability=made.probability,
            is_explored=made.is_explored,
            stage=seen.stage,
            horizon=service.stored.horizon,
            policy=service.digest,
            seen=seen.said or UNSET,
            stepped_back=UNSET if back is None else back.why,
            arm=arm,
            **acted,
        )

    def _dealt(
        self, comparison: Comparison, seen: Seen, decided: Decision | SteppedBack, made: Taken
    ) -> tuple[Taken, str]:
        """What the arm of the trajectory does, with the probability that either arm does it."""
        deal, (action, name) = comparison.dealt(), comparison.rule.action(seen.begun.covariates, seen.stage)
        if deal.is_policys:
            by_rule = 1.0 if made.decision.action == action else 0.0
            return made._replace(probability=deal.probability(made.probability, by_rule)), POLICY
        by_policy = self._chance(seen, decided, made, action)
        decision = Decision(action, {}, f"{action}: {name}, to which this trajectory was dealt.")
        return Taken(decision, deal.probability(by_policy, 1.0), False), RULE

    def _chance(self, seen: Seen, decided: Decision | SteppedBack, made: Taken, action: Any) -> float:
        """Probability with which the policy's arm takes an action."""
        if isinstance(decided, SteppedBack):
            return 1.0 if made.decision.action == action else 0.0
        return chance_of(decided, self._shares(seen, decided), str(action))

    def _shares(self, seen: Seen, decided: Decision) -> dict[str, float]:
        if self.table is not None:
            return self.table.shares(seen.begun.covariates, seen.stage)
        return uniform_shares(decided, self.epsilon)

    def _taken(self, service: InService, seen: Seen, decided: Decision | SteppedBack) -> Taken:
        if isinstance(decided, Decision):
            return taken(decided, self._shares(seen, decided), self.rng)
        if service.fall_back is None:
            raise Refusal(422, f"{decided.detail}, and {NOBODY}")
        return Taken(decided_by_rule(decided, service.fall_back, seen.begun.covariates, seen.stage), 1.0, False)

    def recorded(self, seen: Seen, reply: Decided) -> Decided:
        """Record what was decided, where that is wanted, and say so.

        Raises
        ------
        Refusal
            It cannot be recorded; then nothing was decided.
        """
        begun, comparison = seen.begun, self.comparison
        if self.trajectories is None:
            self.recent.decided(begun.covariates, reply)
            return reply
        if comparison is not None:
            begun = replace(begun, columns={**begun.columns, **comparison.columns()})
        name = self.trajectories.decided(begun, reply)
        if comparison is not None:
            comparison.dealt().took()
        reply = msgspec.structs.replace(reply, trajectory=name)
        self.recent.decided(begun.covariates, reply)
        return reply
