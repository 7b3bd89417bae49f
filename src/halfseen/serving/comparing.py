"""A comparison in the cell: each trajectory is dealt to the policy or the rule of today, and the log records the arm.

The columns `ARM`, `CHANCE` and `COMPARISON` of a trajectory hold the whole state: a restarted server reads the log and
continues to deal as before. The logged probability of an action is that of the mixture of both arms:
P(a | so far) = π P₁(a) + (1 − π) P₀(a), with π the probability of the policy's arm given the actions so far. So the
propensities of the log describe one behaviour policy, and learning and evaluation from it stay valid.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import ArgumentError, NothingRecordedError
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.logs import Logs, read_logs
from halfseen.logs.columns import ARM, FINISHED, RULE
from halfseen.logs.recorded import STILL_RUNNING, followed
from halfseen.monitoring.comparison import ComparisonCache, Courses, counted
from halfseen.monitoring.dealing import POLICY, Standing, Terms, standing
from halfseen.policies.rule_files import FallBack, fall_back_of
from halfseen.reading import read_bytes, reason_of
from halfseen.serving.models import Compared
from halfseen.shapes import Float

if TYPE_CHECKING:
    from halfseen.serving.in_service import InService

CHANCE, COMPARISON = "policy_chance", "comparison"


@dataclass
class Deal:
    """A trajectory in progress.

    Parameters
    ----------
    is_policys
        Whether it was dealt to the policy.
    chance
        Probability with which it was dealt to the policy.
    belief
        Probability of the policy's arm given the actions so far.
    """

    is_policys: bool
    chance: float
    belief: float

    after: float = 1.0
    """The belief after the next action."""

    def probability(self, by_policy: float, by_rule: float) -> float:
        """Probability of the next action given earlier ones, from its probabilities under the two arms."""
        likely = self.belief * by_policy + (1.0 - self.belief) * by_rule
        self.after = self.belief * by_policy / likely
        return likely

    def took(self) -> None:
        """Update the belief after the action was recorded."""
        self.belief = self.after


@dataclass(eq=False)
class LiveComparison:
    """Deals the trajectories of a cell, and tracks the state of the comparison.

    Parameters
    ----------
    service
        The policy.
    file
        The rule of today, as .csv or .toml.
    folder
        Folder of the recorded trajectories.
    terms
        Settings of the comparison.
    seed
        Seed of the deals.
    say
        Receives a sentence when the verdict changes.
    """

    service: "InService"
    file: Path
    folder: Path
    terms: Terms = field(default_factory=Terms)
    seed: int = 0
    say: Callable[[str], object] = field(default_factory=lambda: print)

    def __post_init__(self) -> None:
        found = fall_back_of(self.service.stored, self.file)
        assert found is not None, "a rule file says what decides"
        self.rule: FallBack = found
        self.name = name_of(self.service, self.file)
        self.deal: Deal | None = None
        self.courses = self._recorded()
        self.kept = ComparisonCache()
        self.counted = counted(self.courses, kept=self.kept)
        self.standing: Standing = standing(self.courses, self.terms, self.counted, self.kept)

    @property
    def policy(self) -> DiscretePolicy:
        """The policy."""
        return self.service.stored.policy

    def dealt(self) -> Deal:
        """Deal the next trajectory unless it is already dealt; the same seed and log give the same deal."""
        if self.deal is None:
            share, luck = self.standing.share, np.random.default_rng([self.seed, self.courses.num]).random()
            self.deal = Deal(bool(luck < share), share, share)
        return self.deal

    def columns(self) -> dict[str, Any]:
        """Columns to record for the trajectory."""
        deal = self.dealt()
        return {ARM: POLICY if deal.is_policys else RULE, CHANCE: deal.chance, COMPARISON: self.name}

    def resumed(self, events: Sequence[dict[str, Any]]) -> bool:
        """Resume the logged trajectory in progress; False if this comparison did not deal it."""
        columns = events[0]["columns"]
        if columns.get(COMPARISON) != self.name:
            return False
        self.deal = Deal(columns[ARM] == POLICY, columns[CHANCE], columns[CHANCE])
        for event in (each for each in events if each["event"] == "stage"):
            action, _ = self.rule.action(event["covariates"], event["stage"])
            by_rule = 1.0 if event["action"] == action else 0.0
            self.deal.belief = 1.0 - (1.0 - self.deal.belief) * by_rule / event["probability"]
        return True

    def ended(self, events: Sequence[dict[str, Any]]) -> None:
        """Count a logged trajectory that has ended."""
        self.deal = None
        rows = followed(events).rows
        if rows["trajectories"][0].get(COMPARISON) != self.name or num_until_decided(self.courses) < self.courses.num:
            return
        before, course = self.standing.verdict, courses_in(rows["trajectories"], rows["stages"], self.policy)
        self.courses = joined(self.courses, course)
        self.counted = counted(self.courses, self.counted, self.kept)
        self.standing = standing(self.courses, self.terms, self.counted, self.kept)
        if self.standing.verdict != before:
            self.say(f"{self.standing}.")

    def of(self, service: "InService") -> "LiveComparison":
        """Comparison of another policy or rule in this log."""
        return self if name_of(service, self.file) == self.name else replace(self, service=service)

    @property
    def facts(self) -> Compared:
        """Answer of `/comparison`."""
        return Compared(sentence=str(self.standing), **vars(self.standing), most_loss=self.terms.most_loss)

    def _recorded(self) -> Courses:
        if not self.folder.exists():
            return courses_of(None, self.policy, self.name)
        try:
            courses = courses_of(read_logs(self.folder), self.policy, self.name)
        except NothingRecordedError:
            return courses_of(None, self.policy, self.name)
        return courses.part(0, min(courses.num, num_until_decided(courses) + 1))


def name_of(service: "InService", file: Path) -> str:
    """Identifier that distinguishes comparisons of other policies or rules in the same log."""
    try:
        content = read_bytes(file)
    except OSError as error:
        raise ArgumentError(f"{file}: it cannot be read ({reason_of(error)})") from error
    return f"{service.digest}:{hashlib.sha256(content).hexdigest()[:12]}"


def courses_of(logs: Logs | None, policy: DiscretePolicy, name: str) -> Courses:
    """Extract the trajectories of a comparison from a log; none if the log is None.

    Parameters
    ----------
    logs
        The log.
    policy
        Policy whose covariates are used.
    name
        Value of `COMPARISON` for these trajectories.
    """
    if logs is None or COMPARISON not in logs.trajectories.columns:
        return courses_in([], [], policy)
    is_its = logs.trajectories[COMPARISON].eq(name).fillna(False) & logs.trajectories["cause"].ne(STILL_RUNNING)
    its: Any = logs.trajectories[is_its]
    stages: Any = logs.stages[logs.stages["trajectory"].isin(its["trajectory"])]

    def recorded_at(row: Mapping[str, Any]) -> tuple[int, str]:
        """Place in the order of recording, even if names are text."""
        return len(str(row["trajectory"])), str(row["trajectory"])

    trajectories, begun = (sorted(rows.to_dict("records"), key=recorded_at) for rows in (its, stages))
    return courses_in(trajectories, begun, policy)


def courses_in(
    trajectories: Sequence[Mapping[str, Any]], stages: Sequence[Mapping[str, Any]], policy: DiscretePolicy
) -> Courses:
    """Convert rows of trajectories, and of their stages in the same order."""
    number = {row["trajectory"]: k for k, row in enumerate(trajectories)}
    looks_at, first = policy.looks_at, {text: known[0] for text, known in policy.categories.items()}
    seen = [
        {**row, **{text: known for text, known in first.items() if not looks_at.is_known(text, row.get(text))}}
        for row in stages
    ]

    def numbers(rows: Sequence[Mapping[str, Any]], name: str) -> Float[np.ndarray, " m"]:
        return np.array([row[name] for row in rows], dtype=np.float64)

    return Courses(
        is_policy=np.array([row[ARM] == POLICY for row in trajectories], dtype=bool),
        chance=numbers(trajectories, CHANCE),
        end_s=numbers(trajectories, "end_s"),
        is_finished=np.array([row["ending"] == FINISHED for row in trajectories], dtype=bool),
        trajectory=np.array([number[row["trajectory"]] for row in stages], dtype=np.int64),
        state=looks_at.encode_known(seen) if seen else np.zeros((0, looks_at.num_features)),
        reward=numbers(stages, "reward"),
        clock_s=numbers(stages, "elapsed_s"),
    )


def num_until_decided(courses: Courses) -> int:
    """Number of trajectories before the first that was not randomised. It shows the verdict; later ones add nothing."""
    is_decided = (courses.chance == 0.0) | (courses.chance == 1.0)
    return int(np.argmax(is_decided)) if is_decided.any() else courses.num


def joined(one: Courses, other: Courses) -> Courses:
    """Append trajectories to others."""
    later = other._replace(trajectory=other.trajectory + one.num)
    return Courses(*(np.concatenate(each) for each in zip(one, later, strict=True)))
