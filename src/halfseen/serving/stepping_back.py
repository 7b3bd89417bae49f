"""Where the policy does not decide: out of its logs' range, beyond its horizon, where it fails, or too late.

Then the rule decides, with probability 1: which of them decides depends on the state alone, so that the log stays one
that can be learned from.
"""

import sys
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from halfseen.errors import OutOfRangeError
from halfseen.policies.decision import Decision
from halfseen.policies.fall_back import FallBack
from halfseen.serving.models import StepBacks, Why


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


def late(limit_s: float) -> SteppedBack:
    """Say that the policy did not answer in time [s]."""
    return SteppedBack("late", f"the policy gave no answer within {limit_s:g} s")


def decided_by_rule(back: SteppedBack, rule: FallBack, covariates: Mapping[str, Any], stage: int) -> Decision:
    """Let the rule decide, and say why."""
    action, name = rule.action(covariates, stage)
    return Decision(action, {}, f"{action}: {name}, in the policy's place: {back.detail}.")
