"""A question, an answer: what `halfseen act --json` says, with the probability of what is done."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from halfseen.policies.exploration_table import ExplorationTable
from halfseen.serving.exploring import taken, uniform_shares
from halfseen.serving.in_service import InService
from halfseen.serving.seen import Seen
from halfseen.serving.trajectories import RecordedTrajectories


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
