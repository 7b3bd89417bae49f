"""What policy.json says of the log that a policy was learned from, gathered in one pass over its parts."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from halfseen.logs import Logs, LogsSummary
from halfseen.logs.summary import SummaryTally
from halfseen.policies.folder.digest import LogDigest
from halfseen.policies.folder.kinds import PolicyKind
from halfseen.policies.folder.seen import joined_seen
from halfseen.policies.folder.stages_left import stage_counts, stages_left


@dataclass(frozen=True)
class LogFacts:
    """What is kept of a log.

    Parameters
    ----------
    summary
        Its counts.
    sha256
        Its digest.
    schema
        What the policy looks at and chooses from.
    seen
        What states looked like.
    stages_left
        Mean number of stages from each to the end of a trajectory.
    reward_spread
        Standard deviation of the rewards of completed stages.
    """

    summary: LogsSummary
    sha256: str
    schema: dict[str, Any]
    seen: list[dict[str, Any]]
    stages_left: list[float]
    reward_spread: float


def log_facts(parts: Iterable[Logs], kind: PolicyKind, policy: Any, is_by_stage: bool) -> LogFacts:
    """Gather what is kept of a log.

    Parameters
    ----------
    parts
        The log, whole or in parts of whole trajectories, in their order.
    kind
        Of the policy.
    policy
        What was learned.
    is_by_stage
        Whether each stage has a Q of its own.
    """
    digest, summary, facts = LogDigest(), SummaryTally(), []
    seen, counts, spread = [], None, _Spread(0, 0.0, 0.0)
    for part in parts:
        digest.add(part)
        summary.add(part.trajectories, part.stages, part.objects)
        facts.append(kind.facts(part))
        seen = joined_seen(seen, kind.seen(part, policy, is_by_stage))
        here = stage_counts(part)
        counts = here if counts is None else counts.plus(here)
        spread = spread.plus(_spread_of(part))
    assert counts is not None
    schema = kind.schema(policy, facts)
    return LogFacts(summary.summary(), digest.hexdigest(), schema, seen, stages_left(counts), spread.deviation)


class _Spread(NamedTuple):
    count: int
    mean: float
    squares: float
    """Σ (reward − mean)²."""

    def plus(self, other: "_Spread") -> "_Spread":
        if not (self.count and other.count):
            return self if self.count else other
        count, apart = self.count + other.count, other.mean - self.mean
        squares = self.squares + other.squares + apart**2 * self.count * other.count / count
        return _Spread(count, self.mean + apart * other.count / count, squares)

    @property
    def deviation(self) -> float:
        return float(np.sqrt(self.squares / self.count)) if self.count else float("nan")


def _spread_of(part: Logs) -> _Spread:
    rewards = part.stages["reward"].to_numpy(dtype=np.float64, na_value=np.nan)
    rewards = rewards[~np.isnan(rewards)]
    if not len(rewards):
        return _Spread(0, 0.0, 0.0)
    return _Spread(len(rewards), float(rewards.mean()), float(((rewards - rewards.mean()) ** 2).sum()))
