"""A served policy, independent of the protocol: it decides, steps back, compares and records.

An answer has the fields of `halfseen act --json`, and the probability of the action.
"""

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from anyio import to_thread
from msgspec import UNSET

from halfseen.errors import StorageError
from halfseen.logs.columns import DECIDED_BY, RULE
from halfseen.monitoring.dealing import POLICY
from halfseen.policies.decision import Decision
from halfseen.policies.exploration import ExplorationTable, Taken, chance_of, taken, uniform_shares
from halfseen.serving.comparing import LiveComparison
from halfseen.serving.in_service import InService, SteppedBack, Worker, asked, asked_in_time, taken_into_service
from halfseen.serving.models import DecisionAnswer, EndAnswer, Health, RecordingProgress, Refusal, StepBacks
from halfseen.serving.questions import AskedState
from halfseen.serving.recording import RecordedTrajectories
from halfseen.serving.watching import Recent

if TYPE_CHECKING:
    from halfseen.policies.table_observation import SeenLaw

NOBODY = (
    "the policy's folder, of an earlier version, does not give the most frequent actions of its log; learn it "
    "again, or serve it with --fall-back RULE"
)


@dataclass(frozen=True, eq=False)
class Answering:
    """How decisions are taken and kept.

    Parameters
    ----------
    epsilon
        Share of decisions that are drawn at random, in [0, 1).
    table
        Actions to draw instead, and their states; None to draw all actions.
    rng
        Random generator of the draws.
    trajectories
        Recorder of decisions; None to record nothing.
    tally
        Counts of the rule's decisions.
    comparison
        Deals trajectories to the policy or the rule of today; None if all are the policy's.
    recent
        Latest decisions and trajectories.
    """

    epsilon: float = 0.0
    table: ExplorationTable | None = None
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    trajectories: RecordedTrajectories | None = None
    tally: StepBacks = field(default_factory=lambda: StepBacks(0, 0, {}, None))
    comparison: LiveComparison | None = None
    recent: Recent = field(default_factory=Recent)

    def answer(self, service: InService, seen: AskedState, decided: Decision | SteppedBack) -> DecisionAnswer:
        """Build the answer from the decision of the policy, or of the rule in its place.

        Raises
        ------
        Refusal
            The policy does not decide, and there is no rule in its place.
        """
        back = decided if isinstance(decided, SteppedBack) else None
        made = self._taken(service, seen, decided)
        arm: Any = UNSET
        if self.comparison is not None:
            made, arm = self._dealt(self.comparison, seen, decided, made)
            back = back if arm == POLICY else None
        verb, _, number = str(made.decision.action).partition(" ")
        acted = {"verb": verb, "object": seen.names[int(number)] if number else None} if seen.names else {}
        return DecisionAnswer(
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
        self, comparison: LiveComparison, seen: AskedState, decided: Decision | SteppedBack, made: Taken
    ) -> tuple[Taken, str]:
        """Action of the trajectory's arm, with its probability under the mixture of both arms."""
        deal, (action, name) = comparison.dealt(), comparison.rule.action(seen.begun.covariates, seen.stage)
        is_same = 1.0 if made.decision.action == action else 0.0
        if deal.is_policys:
            return made._replace(probability=deal.probability(made.probability, is_same)), POLICY
        by_policy = is_same
        if isinstance(decided, Decision):
            by_policy = chance_of(decided, self._shares(seen, decided), str(action))
        decision = Decision(action, {}, f"{action}: {name}, to which this trajectory was assigned.")
        return Taken(decision, deal.probability(by_policy, 1.0), False), RULE

    def _shares(self, seen: AskedState, decided: Decision) -> dict[str, float]:
        if self.table is not None:
            return self.table.shares(seen.begun.covariates, seen.stage)
        return uniform_shares(decided, self.epsilon)

    def _taken(self, service: InService, seen: AskedState, decided: Decision | SteppedBack) -> Taken:
        if isinstance(decided, Decision):
            return taken(decided, self._shares(seen, decided), self.rng)
        if service.fall_back is None:
            raise Refusal(422, f"{decided.detail}, and {NOBODY}")
        action, name = service.fall_back.action(seen.begun.covariates, seen.stage)
        reason = f"{action}: {name}, in the policy's place: {decided.detail}."
        return Taken(Decision(action, {}, reason), 1.0, False)

    def recorded(self, seen: AskedState, reply: DecisionAnswer) -> DecisionAnswer:
        """Record a decision, if recording is on, and add the trajectory to the answer.

        Raises
        ------
        Refusal
            It cannot be recorded; then nothing is decided.
        """
        begun, comparison = seen.begun, self.comparison
        if self.trajectories is None:
            self.recent.decided(begun.covariates, reply)
            return reply
        dealt = {} if comparison is None else comparison.columns()
        begun, doubts = self.trajectories.fitted(begun)
        begun = replace(begun, columns={**begun.columns, DECIDED_BY: reply.policy, **dealt})
        name = self.trajectories.decided(begun, reply)
        if comparison is not None:
            comparison.dealt().took()
        reply = msgspec.structs.replace(reply, trajectory=name, warnings=[*reply.warnings, *doubts])
        self.recent.decided(begun.covariates, reply)
        return reply


Check = Callable[[], Awaitable[None]]


async def _anybody() -> None:
    """Assume that the client still waits."""


@dataclass(eq=False)
class Served:
    """A served policy with its settings.

    Parameters
    ----------
    folder
        Folder of the policy; read again on reload.
    answering
        How decisions are taken and kept.
    extrapolates
        Whether the policy also decides far outside the log's range.
    law
        For tables, the law of labels in a cell; None for the assumed one.
    stays_within
        For named actions, whether the rule decides farther outside the log than chance explains.
    rule
        File of the rule; None for the most frequent actions of the log.
    limit_s
        Time limit for the policy, after which the rule decides [s]; None for no limit.
    """

    folder: Path
    answering: Answering = field(default_factory=Answering)
    extrapolates: bool = False
    law: "SeenLaw | None" = None
    stays_within: bool = False
    rule: Path | None = None
    limit_s: float | None = None

    def __post_init__(self) -> None:
        self.service = self.read()
        self._unanswered: set[Worker] = set()
        self._next: tuple[InService, LiveComparison | None] | None = None
        self._is_stored = True
        self.lock = asyncio.Lock()

    def read(self) -> InService:
        """Read the policy from its folder; raises the errors of `taken_into_service`."""
        return taken_into_service(
            self.folder, extrapolates=self.extrapolates, stays_within=self.stays_within, rule=self.rule
        )

    async def reload(self) -> InService:
        """Replace the current policy by that of the folder; requests are answered meanwhile.

        A recorded trajectory in progress is finished by the policy that began it, as its log says.

        Raises
        ------
        PolicyError
            The folder cannot be read, or the log cannot hold its states; the current policy stays.
        """
        fresh = await to_thread.run_sync(self.read)
        async with self.lock:
            comparison = self.answering.comparison
            if self.answering.trajectories is not None:
                self.answering.trajectories.refuse_other_log(fresh.stored)
            if comparison is not None:
                comparison = await to_thread.run_sync(comparison.of, fresh)
            self._next = fresh, comparison
            self._replace()
        return fresh

    def _replace(self) -> None:
        """Take the policy that was read last into service, unless a recorded trajectory is in progress."""
        recording, watch = self.answering.trajectories, self.answering.recent.watch
        if self._next is None or (recording is not None and recording.facts.trajectory is not None):
            return
        (fresh, comparison), self._next = self._next, None
        self.answering = replace(self.answering, comparison=comparison)
        if watch is not None and fresh.digest != self.service.digest:
            watch.restart(fresh.digest)
        self.service, self._unanswered = fresh, set()

    async def decide(self, look: Callable[[InService], AskedState], check: Check = _anybody) -> DecisionAnswer:
        """Look, decide and record, one request at a time; slow work runs in threads, so that the loop stays free.

        Parameters
        ----------
        look
            Reads the state to decide on.
        check
            For tables, raises `Refusal` if the client no longer waits.

        Raises
        ------
        Refusal
            The decision cannot be recorded, or the client is gone; then nothing is decided.
        """
        async with self.lock:
            self._replace()
            service, is_table = self.service, self.service.stored.is_table
            if not is_table:
                seen = look(service)
                decided = await self._decided(service, seen)
                reply = self._recorded(seen, self.answering.answer(service, seen, decided))
            else:
                await check()
                seen = await to_thread.run_sync(look, service)
                decided = await self._decided(service, seen)
                given = self.answering.answer(service, seen, decided)
                await check()
                reply = await to_thread.run_sync(self._recorded, seen, given)
            self.answering.tally.decisions += 1
            # In a comparison the rule's own trajectories do not step back.
            if isinstance(decided, SteppedBack) and reply.stepped_back is not UNSET:
                self.answering.tally.add(decided.why, decided.detail)
            return reply

    async def _decided(self, service: InService, seen: AskedState) -> Decision | SteppedBack:
        """Ask the policy; an answer after the time limit is dropped, as is a question while many are unanswered."""
        ask = partial(asked, seen.decide, seen.stage, service.stored.horizon)
        if self.limit_s is None:
            return await to_thread.run_sync(ask) if service.stored.is_table else ask()
        return await asked_in_time(ask, self.limit_s, self._unanswered)

    async def rewarded(
        self, reward: float, elapsed_s: float | None = None, held: bool | None = None, trajectory: Any = None
    ) -> RecordingProgress:
        """Complete the stage in progress, as `RecordedTrajectories` checks it and does."""
        async with self.lock:
            self.recording.check_in_progress(trajectory)
            with self._storing():
                return self.recording.rewarded(reward, elapsed_s, held)

    async def ended(self, cause: str | None, elapsed_s: float | None = None, trajectory: Any = None) -> EndAnswer:
        """End the trajectory in progress, as `RecordedTrajectories` checks it and does; count it in a comparison."""
        async with self.lock:
            recording, comparison = self.recording, self.answering.comparison
            recording.check_in_progress(trajectory)
            with self._storing():
                ended = recording.ended(cause, elapsed_s)
            if comparison is not None:
                await to_thread.run_sync(comparison.ended, recording.events)
            self._replace()
            self.answering.recent.ended(recording.events)
            return ended

    def _recorded(self, seen: AskedState, given: DecisionAnswer) -> DecisionAnswer:
        with self._storing():
            return self.answering.recorded(seen, given)

    @contextmanager
    def _storing(self) -> Iterator[None]:
        """Note whether the disk can store an event."""
        try:
            yield
        except StorageError as error:
            self._is_stored = False
            raise Refusal(507, str(error)) from error
        self._is_stored = True

    @property
    def recording(self) -> RecordedTrajectories:
        """Recorder of decisions.

        Raises
        ------
        Refusal
            Nothing is recorded.
        """
        if self.answering.trajectories is None:
            raise Refusal(409, "this server records nothing; start it with --record LOGS")
        return self.answering.trajectories

    @property
    def health(self) -> Health:
        """Answer of `/health`."""
        answering, kind = self.answering, self.service.stored.record["kind"]
        recording = UNSET if answering.trajectories is None else answering.trajectories.facts
        compared = UNSET if answering.comparison is None else answering.comparison.facts
        status = "ok" if self._is_stored else "not recording"
        return Health(status, self.service.digest, kind, answering.tally, recording, compared)
