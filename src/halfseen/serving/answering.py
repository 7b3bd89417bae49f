"""A question, an answer: what `halfseen act --json` says, with the probability of what is done."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from halfseen.serving.exploring import Taken, taken
from halfseen.serving.in_service import InService
from halfseen.serving.paths import RecordedPaths
from halfseen.serving.seen import Seen


@dataclass(frozen=True, eq=False)
class Answering:
    """How decisions are taken and kept.

    Parameters
    ----------
    epsilon
        Share of decisions that are drawn at random, in [0, 1).
    rng
        What they are drawn with.
    paths
        Where they are recorded; None if they are not.
    """

    epsilon: float = 0.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    paths: RecordedPaths | None = None

    def answer(self, service: InService, seen: Seen) -> dict[str, Any]:
        """Decide, record it, and say so.

        Raises
        ------
        HalfseenError
            The policy cannot decide from this.
        Refusal
            It cannot be recorded; then nothing was decided.
        """
        made = taken(seen.decide(), self.epsilon, self.rng)
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
        verb, target = _acted_on(made, seen)
        if seen.names:
            told |= {"verb": verb, "object": target}
        if self.paths is not None:
            told["path"] = self.paths.decided(seen.covariates, verb, made.probability, target, seen.objects)
        return told


def _acted_on(made: Taken, seen: Seen) -> tuple[Any, Any]:
    """Take the name of an action at a table apart: what is done, and to which object."""
    if not seen.names:
        return made.decision.action, None
    verb, _, number = made.decision.action.partition(" ")
    return verb, seen.names[int(number)] if number else None
