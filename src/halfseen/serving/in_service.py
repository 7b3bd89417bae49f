"""A policy in service: read, checked, warmed up, and with a fallback rule.

The rule decides outside the range of the training log, beyond the horizon, when the policy fails, or when it is too
late. It decides with probability 1: which of the two decides depends on the state only, so the log can be learned from.
"""

import asyncio
import contextlib
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import TypeAlias

import numpy as np

from halfseen.errors import OutOfRangeError
from halfseen.policies import decider_of, read_policy
from halfseen.policies.decision import Decider, Decision
from halfseen.policies.folder.stored import UNDECIDED, StoredPolicy, refuse_team
from halfseen.policies.named_decider import NamedDecider
from halfseen.policies.ranges import middle_of
from halfseen.policies.rule_files import FallBack, fall_back_of
from halfseen.serving.models import Why

MOST_WARMED = 12
"""Number of objects of the largest table that is decided during warm-up."""

MOST_UNANSWERED = 8
"""Number of unanswered questions above which a policy is no longer asked."""


@dataclass(frozen=True, eq=False)
class InService:
    """A policy that answers; immutable.

    Parameters
    ----------
    stored
        The policy.
    decider
        The same policy behind the decision interface.
    digest
        Its identifier, as in `StoredPolicy`.
    fall_back
        Rule that decides where the policy does not; None if unknown.
    """

    stored: StoredPolicy
    decider: Decider
    digest: str
    fall_back: FallBack | None = None


def taken_into_service(
    folder: Path, *, extrapolates: bool = False, stays_within: bool = False, rule: Path | None = None
) -> InService:
    """Read a policy, check it, and warm it up, so that no request waits for lazy loading.

    Parameters
    ----------
    folder
        As in `read_policy`.
    extrapolates, stays_within
        As in `decider_of`.
    rule
        A file for `fall_back_of`; None for the most frequent actions of the log.

    Raises
    ------
    ArgumentError
        The rule does not fit this policy.
    PolicyError
        The policy cannot be read, or decides for a team.
    """
    stored = read_policy(folder)
    refuse_team(stored, UNDECIDED, folder)
    fall_back = fall_back_of(stored, rule)
    decider = decider_of(stored, extrapolates=extrapolates, stays_within=stays_within)
    _warm(stored, decider)
    return InService(stored, decider, stored.digest, fall_back)


def _warm(stored: StoredPolicy, decider: Decider) -> None:
    """Decide once at each stage, or, for tables, for each number of objects in the log."""
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


@dataclass(frozen=True)
class SteppedBack:
    """Reason for which the rule decides.

    Parameters
    ----------
    why
        One word, as in the log.
    detail
        One line.
    """

    why: Why
    detail: str


def asked(decide: Callable[[], Decision], stage: int, horizon: int) -> Decision | SteppedBack:
    """Ask a policy; any failure becomes a step back.

    Parameters
    ----------
    decide
        Asks the policy.
    stage, horizon
        The stage to decide, from 1, and the number of stages that the policy decides.
    """
    if stage > horizon:
        return SteppedBack("beyond-horizon", f"stage {stage} is beyond the policy's horizon, {horizon}")
    try:
        decision = decide()
    except OutOfRangeError as error:
        return SteppedBack("out-of-range", str(error))
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        return SteppedBack("failed", f"the policy fails ({type(error).__name__}: {error})")
    if decision.q_values and decision.q_values.get(str(decision.action)) is None:
        return SteppedBack("failed", f"the policy fails (Q of {decision.action} is not a number)")
    return decision


Worker: TypeAlias = SimpleQueue[Callable[[], None]]
"""The calls that a thread makes, one after the other."""
_IDLE: list[Worker] = []


def _idle_worker() -> Worker:
    """Take an idle worker, or start one; a thread for each question would cost a tenth of a decision."""
    with contextlib.suppress(IndexError):
        return _IDLE.pop()
    calls: Worker = SimpleQueue()

    def work() -> None:
        while True:
            calls.get()()

    threading.Thread(target=work, daemon=True).start()
    return calls


async def asked_in_time(
    ask: Callable[[], Decision | SteppedBack], limit_s: float, unanswered: set[Worker]
) -> Decision | SteppedBack:
    """Ask a policy in a thread; step back after a time limit, and at once while many questions are unanswered.

    A policy that hangs cannot be ended. Its threads do not keep the server from stopping.

    Parameters
    ----------
    ask
        Asks the policy, and never raises.
    limit_s
        Time limit [s].
    unanswered
        Workers of questions without an answer so far; updated.
    """
    if len(unanswered) >= MOST_UNANSWERED:
        return SteppedBack("late", f"the policy has not yet answered {MOST_UNANSWERED} earlier questions")
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[Decision | SteppedBack] = loop.create_future()
    worker = _idle_worker()

    def run() -> None:
        found = ask()
        unanswered.discard(worker)
        _IDLE.append(worker)
        # The loop may be closed by then.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(lambda: answer.done() or answer.set_result(found))

    unanswered.add(worker)
    worker.put(run)
    try:
        return await asyncio.wait_for(answer, limit_s)
    except TimeoutError:
        return SteppedBack("late", f"the policy did not answer within {limit_s:g} s")
