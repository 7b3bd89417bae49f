"""The exchange with a controller: requests, answers and recording, robust to lost messages.

The controller numbers its requests; each holds a state and the outcome of the previous decision. A decision is recorded
before it is written, and the log holds the number of its trajectory's first request. After a lost session or a restart
of either side, the log and the numbers determine the next step. With r the request and d the last decision of the
trajectory in progress:

* r = d, and the state equals that of the log: the logged decision is written again, not taken again;
* r = d + 1: the outcome of d is recorded, then the next decision is taken, or the trajectory ends;
* any other r: requests were lost, and the trajectory is cut.
"""

import asyncio
import sys
import traceback
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from halfseen.errors import ArgumentError, HalfseenError, LogError
from halfseen.logs.columns import DECIDED_BY, FINISHED
from halfseen.serving.comparing import COMPARISON
from halfseen.serving.in_service import InService
from halfseen.serving.models import Refusal, Wired
from halfseen.serving.opcua.controller import LOST, Controller, Snapshot, connected
from halfseen.serving.opcua.mapping import CellMapping
from halfseen.serving.questions import AskedState, seen_in_state
from halfseen.serving.served import Served

REQUEST = "first_request"
"""Column of a trajectory: the number of its first request."""
REQUESTS_LOST = "requests-lost"
"""Cause of the cut of a trajectory whose requests do not continue where the log ends."""
LOOKED_AFTER_S, TRIED_AGAIN_AFTER_S, BEGUN_AGAIN_AFTER_S = 1.0, 0.1, 0.5
"""Polling interval without news, in normal operation and after an error, and delay before a new session [s]."""


def _tell(line: str) -> None:
    print(f"halfseen: {line}", file=sys.stderr, flush=True)


@dataclass(eq=False)
class Wire:
    """A policy that a controller asks over OPC UA, trajectory after trajectory.

    Parameters
    ----------
    served
        The policy, which records with `resumes`.
    url
        Address of the controller, as opc.tcp://HOST:PORT.
    mapping
        Locations of its variables.
    password
        Password of the user in the mapping.
    tell
        Receives a line when an error begins, and when it is over.
    """

    served: Served
    url: str
    mapping: CellMapping
    password: str | None = None
    tell: Callable[[str], object] = _tell
    facts: Wired = field(init=False)
    _written: int | None = field(default=None, init=False)
    """Number of the request that was answered last; None before the first look."""

    def __post_init__(self) -> None:
        self.facts = Wired(self.url, "Preoperational", None, None)

    def resume(self) -> None:
        """Resume a trajectory in progress and its deal; cut one that another policy or comparison began."""
        comparison, recording = self.served.answering.comparison, self.served.answering.trajectories
        if recording is None or not recording.columns:
            return
        if comparison is None:
            begun_by = recording.columns.get(DECIDED_BY)
            is_its = COMPARISON not in recording.columns and begun_by == self.served.service.digest
        else:
            is_its = comparison.resumed(recording.events)
        if not is_its:
            recording.ended(REQUESTS_LOST)

    async def check(self) -> None:
        """Try to connect to the controller once; it may also become reachable later.

        Raises
        ------
        ArgumentError
            The controller refuses, or lacks a variable of the mapping.
        """
        try:
            async with connected(self.url, self.mapping, self.password) as controller:
                for action in self.served.service.stored.policy.actions:
                    controller.typed("action", self.mapping.code_of(action))
        except OSError as error:
            self.tell(f"{self.url}: no answer ({error or type(error).__name__}); retrying until it answers")
        except LOST as error:
            raise ArgumentError(f"--opcua {self.url}: the controller refuses ({error})") from error

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Answer the controller within this context."""
        task = asyncio.create_task(self.run())
        try:
            yield
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    async def run(self) -> None:
        """Answer the controller until cancelled; reconnect after a lost session."""
        self.resume()
        while True:
            try:
                async with connected(self.url, self.mapping, self.password) as controller:
                    while True:
                        await self.look(controller)
                        await controller.news(TRIED_AGAIN_AFTER_S if self.facts.error else LOOKED_AFTER_S)
            except Exception as error:
                if not isinstance(error, (*LOST, HalfseenError)):
                    traceback.print_exc(file=sys.stderr)
                self._note("Preoperational", ": ".join(filter(None, (type(error).__name__, str(error)))))
            except asyncio.CancelledError:
                # asyncua also raises this for a lost session.
                task = asyncio.current_task()
                if task is None or task.cancelling():
                    raise
                self._note("Preoperational", "the session is lost")
            await asyncio.sleep(BEGUN_AGAIN_AFTER_S)

    async def look(self, controller: Controller) -> None:
        """Read the controller once, and answer it or give the reason why not; raises the errors in `LOST`."""
        before = self.facts
        seen = await controller.read()
        try:
            await self._answer(controller, seen)
            self._note(
                "ResultReady" if self.served.recording.facts.waits_for == "reward" else "Ready", None, seen["request"]
            )
        except Refusal as refusal:
            self._note("Error", refusal.answer.error)
        except HalfseenError as error:
            self._note("Error", str(error))
        except LOST:
            raise
        except Exception as error:
            # The next request is still answered.
            traceback.print_exc(file=sys.stderr)
            self._note("Error", f"unexpected error in halfseen ({type(error).__name__})")
        if self.facts != before:
            await controller.write({"state": self.facts.state, "error": self.facts.error or ""})

    def _note(self, state: Any, error: str | None, request: int | None = None) -> None:
        """Update the facts, and report a change of the error."""
        if error != self.facts.error:
            self.tell(
                f"{self.url}: {'decisions are written again' if error is None else f'no decision is written: {error}'}"
            )
        self.facts = Wired(self.url, state, error, self.facts.request if request is None else request)

    async def _answer(self, controller: Controller, seen: Snapshot) -> None:
        """Answer a request unless it is already answered."""
        request = seen.whole("request")
        if request in (0, seen.values["decision"]):
            if self._written is not None and request > self._written:
                raise Refusal(409, "a request was answered by somebody else; let one halfseen answer a controller")
            self._written = request
            return
        action = self._decided_before(request, seen)
        if action is None:
            await self._take_outcome(request, seen)
            action = None if seen.ending else await self._decide(request, seen)
        if action is not None:
            await controller.write({"action": self.mapping.code_of(action)})
        self._written = request
        await controller.write({"decision": request})

    def _last_decision(self) -> int | None:
        """Number of the last decision of the trajectory in progress; None if there is none."""
        first = self.served.recording.columns.get(REQUEST)
        return None if first is None else first + self.served.recording.facts.stage - 1

    def _decided_before(self, request: int, seen: Snapshot) -> Any:
        """Logged action for this same request; None if there is none."""
        facts, last = self.served.recording.facts, self.served.recording.last
        if request != self._last_decision() or facts.waits_for != "reward" or seen.ending or last is None:
            return None
        # What was missing, as null or NaN, is filled in in the log; what the log never had is left out of it.
        known = {name: value for name, value in seen.covariates.items() if name in last}
        given = {name: value for name, value in known.items() if value is not None and value == value}
        is_same = facts.stage == seen.whole("stage") and given.items() <= last.items()
        return facts.action if is_same else None

    async def _take_outcome(self, request: int, seen: Snapshot) -> None:
        """Record the outcome of the previous decision, and the end of its trajectory."""
        last, ending, facts = self._last_decision(), seen.ending, self.served.recording.facts
        if facts.trajectory is None:
            return
        if last is None or request != last + 1 or not (ending or seen.whole("stage") == facts.stage + 1):
            await self.served.ended(REQUESTS_LOST)
            return
        is_cut = ending not in ("", FINISHED)
        elapsed_s = seen.number("elapsed_s")
        if facts.waits_for == "reward" and not is_cut:
            await self.served.rewarded(seen.number("reward"), elapsed_s)
        if ending:
            try:
                await self.served.ended(ending if is_cut else None, elapsed_s)
            except LogError:
                if not is_cut:
                    raise
                # A clock that went back keeps no trajectory open.
                await self.served.ended(ending)

    async def _decide(self, request: int, seen: Snapshot) -> int | str:
        """Decide and record the next stage."""
        stage, next_stage = seen.whole("stage"), self.served.recording.next_stage()
        if stage != next_stage:
            raise Refusal(409, f"stage is {stage}, but the log expects stage {next_stage}; end the trajectory")
        state = {**seen.covariates, "stage": stage}
        return (await self.served.decide(partial(self._seen, request, state))).action

    def _seen(self, request: int, state: dict[str, Any], service: InService) -> AskedState:
        seen = seen_in_state(service, state, self.served.recording)
        return replace(seen, begun=replace(seen.begun, columns={**seen.begun.columns, REQUEST: request}))
