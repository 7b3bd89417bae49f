"""A policy in service, whatever door it is asked by: it decides, steps back, compares and records."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from anyio import move_on_after, to_thread
from msgspec import UNSET

from halfseen.policies.decision import Decision
from halfseen.serving.answering import Answering, Seen
from halfseen.serving.in_service import InService, SteppedBack, asked, late, taken_into_service
from halfseen.serving.models import Decided, Ended, Health, Progress, Refusal
from halfseen.serving.recording import RecordedTrajectories

if TYPE_CHECKING:
    from halfseen.policies.table_observation import SeenLaw

Check = Callable[[], Awaitable[None]]


async def _anybody() -> None:
    """Whoever asked still waits."""


@dataclass(eq=False)
class Served:
    """A policy that is served, and what it is served with.

    Parameters
    ----------
    folder
        Of the policy; it is read again where a reload is asked for.
    answering
        How decisions are taken and kept.
    extrapolates
        Whether to decide far outside what the logs showed, too.
    law
        Of tables, what a cell's law tells of labels; None for the assumed one.
    stays_within
        Of named actions, whether the rule decides whatever lies farther outside the logs than chance explains.
    rule
        A file with the rule; None for what the log did most.
    limit_s
        How long to wait for the policy until the rule decides [s]; None for as long as it takes.
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
        self.lock = asyncio.Lock()

    def read(self) -> InService:
        """Read the policy as it is in its folder now; raises what `taken_into_service` does."""
        return taken_into_service(
            self.folder, extrapolates=self.extrapolates, stays_within=self.stays_within, rule=self.rule
        )

    async def reload(self) -> InService:
        """Put the policy of the folder in the place of the one that answers; requests go on meanwhile.

        Raises
        ------
        PolicyError
            The folder cannot be read; what answered goes on.
        """
        fresh = await to_thread.run_sync(self.read)
        async with self.lock:
            answering, recording = self.answering, self.answering.trajectories
            if answering.comparison is not None and recording is not None:
                to = partial(answering.comparison.of, fresh, is_in_progress=recording.facts.trajectory is not None)
                self.answering = replace(answering, comparison=await to_thread.run_sync(to))
            self.service = fresh
        return fresh

    async def decide(self, look: Callable[[InService], Seen], check: Check = _anybody) -> Decided:
        """Look, decide and record, one at a time; what may last runs beside the loop, so that others are answered.

        Parameters
        ----------
        look
            Takes what is to be decided about.
        check
            Of tables, raises `Refusal` where nobody waits for the decision any more.

        Raises
        ------
        Refusal
            It cannot be recorded, or nobody would learn what was decided; then nothing was.
        """
        async with self.lock:
            service, is_table = self.service, self.service.stored.is_table
            if not is_table:
                seen = look(service)
                given = self.answering.answer(service, seen, await self._decided(service, seen))
                return self.answering.recorded(seen, given)
            await check()
            seen = await to_thread.run_sync(look, service)
            given = self.answering.answer(service, seen, await self._decided(service, seen))
            await check()
            return await to_thread.run_sync(self.answering.recorded, seen, given)

    async def _decided(self, service: InService, seen: Seen) -> Decision | SteppedBack:
        """Ask the policy; what comes too late is dropped."""
        ask = partial(asked, seen.decide, seen.stage, service.stored.horizon)
        if self.limit_s is None:
            return await to_thread.run_sync(ask) if service.stored.is_table else ask()
        with move_on_after(self.limit_s):
            return await to_thread.run_sync(ask, abandon_on_cancel=True)
        return late(self.limit_s)

    async def rewarded(self, reward: float, elapsed_s: float | None = None, held: bool | None = None) -> Progress:
        """Complete the stage in progress, as `RecordedTrajectories.rewarded` does, and raise what it raises."""
        async with self.lock:
            return self.recording.rewarded(reward, elapsed_s, held)

    async def ended(self, cause: str | None, elapsed_s: float | None = None) -> Ended:
        """End the trajectory in progress, as `RecordedTrajectories.ended` does, and count it where it is compared."""
        async with self.lock:
            recording, comparison = self.recording, self.answering.comparison
            ended = recording.ended(cause, elapsed_s)
            if comparison is not None:
                await to_thread.run_sync(comparison.ended, recording.events)
            self.answering.recent.ended(recording.events)
            return ended

    @property
    def recording(self) -> RecordedTrajectories:
        """Where decisions are recorded.

        Raises
        ------
        Refusal
            They are not.
        """
        if self.answering.trajectories is None:
            raise Refusal(409, "this server records nothing; start it with --record LOGS")
        return self.answering.trajectories

    @property
    def health(self) -> Health:
        """How it stands."""
        answering, kind = self.answering, self.service.stored.record["kind"]
        recording = UNSET if answering.trajectories is None else answering.trajectories.facts
        compared = UNSET if answering.comparison is None else answering.comparison.facts
        return Health("ok", self.service.digest, kind, answering.tally.facts, recording, compared)
