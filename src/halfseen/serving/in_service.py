"""A policy that was taken into service: read, checked, warm, and with a rule that decides where it does not.

That is out of its logs' range, beyond its horizon, where it fails, or too late. Then the rule decides, with probability
1: which of them decides depends on the state alone, so that the log stays one that can be learned from.
"""

import hashlib
import sys
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from halfseen.errors import OutOfRangeError
from halfseen.policies import decider_of, read_policy
from halfseen.policies.decision import Decider, Decision
from halfseen.policies.folder.record import as_json
from halfseen.policies.folder.stored import UNDECIDED, StoredPolicy, kind_named, refuse_team
from halfseen.policies.named_decider import NamedDecider
from halfseen.policies.ranges import middle_of
from halfseen.policies.rule_files import FallBack, fall_back_of
from halfseen.serving.models import StepBacks, Why

MOST_WARMED = 12
"""Objects of the largest table that is decided on before the first request."""


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
    fall_back
        What decides where the policy does not; None if nobody knows.
    """

    stored: StoredPolicy
    decider: Decider
    digest: str
    fall_back: FallBack | None = None


def taken_into_service(
    folder: Path, *, extrapolates: bool = False, stays_within: bool = False, rule: Path | None = None
) -> InService:
    """Read a policy, check all of it, and let it decide once, so that no request waits for what loads late.

    Parameters
    ----------
    folder
        As `read_policy` takes it.
    extrapolates, stays_within
        As `decider_of` takes them.
    rule
        A file that `fall_back_of` takes; None for what the log did most.

    Raises
    ------
    ArgumentError
        The rule is none for this policy.
    PolicyError
        It cannot be read, or decides for a team.
    """
    stored = read_policy(folder)
    refuse_team(stored, UNDECIDED, folder)
    fall_back = fall_back_of(stored, rule)
    decider = decider_of(stored, extrapolates=extrapolates, stays_within=stays_within)
    _warm(stored, decider)
    return InService(stored, decider, _digest(stored), fall_back)


def _warm(stored: StoredPolicy, decider: Decider) -> None:
    """Decide once at each stage, or, of tables, for each number of objects in the logs."""
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


@dataclass(frozen=True)
class SteppedBack:
    """Why the rule decides.

    Parameters
    ----------
    why
        In a word, as the log has it.
    detail
        In one line.
    """

    why: Why
    detail: str


@dataclass
class Tally:
    """Counts since a server began."""

    decisions: int = 0
    by: Counter[str] = field(default_factory=Counter)
    last: str | None = None

    def add(self, back: SteppedBack | None) -> None:
        """Count a decision."""
        self.decisions += 1
        if back is not None:
            self.by[back.why] += 1
            self.last = back.detail

    @property
    def facts(self) -> StepBacks:
        """What `/health` says of it."""
        return StepBacks(self.decisions, self.by.total(), dict(self.by), self.last)


def asked(decide: Callable[[], Decision], stage: int, horizon: int) -> Decision | SteppedBack:
    """Ask a policy; whatever it lets fall is taken up.

    Parameters
    ----------
    decide
        Asks it.
    stage, horizon
        The stage to decide, from 1, and how many the policy decides.
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
        return SteppedBack("failed", f"the policy fails (Q of {decision.action} is no number)")
    return decision
