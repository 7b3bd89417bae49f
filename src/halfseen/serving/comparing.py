"""A comparison in the cell: each trajectory is dealt to the policy or the rule of today, and the log records the arm.

The columns `ARM`, `CHANCE` and `COMPARISON` of a trajectory hold the whole state: a restarted server reads the log and
continues to deal as before. The logged probability of an action is that of the mixture of both arms:
P(a | so far) = π P₁(a) + (1 − π) P₀(a), with π the probability of the policy's arm given the actions so far. So the
propensities of the log describe one behaviour policy, and learning and evaluation from it stay valid.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
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
        before, self.courses = self.standing.verdict, joined(self.courses, course_of(rows, self.policy))
        self.counted = counted(self.courses, self.counted, self.kept)
        self.standing = standing(self.courses, self.terms, self.counted, self.kept)
        if self.standing.verdict != before:
            self.say(f"{self.standing}.")

    def of(self, service: "InService", *, is_in_progress: bool) -> "LiveComparison":
        """Comparison of another policy or rule in this log; a trajectory in progress goes on, and does not count."""
        if name_of(service, self.file) == self.name:
            return self
        other = replace(self, service=service)
        other.deal = self.deal if is_in_progress else None
        return other

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
    num_features = policy.looks_at.num_features
    if logs is None or COMPARISON not in logs.trajectories.columns:
        none = np.zeros(0)
        is_one = np.zeros(0, dtype=bool)
        return Courses(is_one, none, none, is_one, none.astype(np.int64), np.zeros((0, num_features)), none, none)
    is_its = logs.trajectories[COMPARISON].eq(name).fillna(False) & logs.trajectories["cause"].ne(STILL_RUNNING)
    trajectories: Any = logs.trajectories[is_its]
    stages: Any = logs.stages[logs.stages["trajectory"].isin(trajectories["trajectory"])]
    # In the order of recording, even if names are text.
    names = sorted(trajectories["trajectory"], key=lambda each: (len(str(each)), str(each)))
    trajectories, number = trajectories.set_index("trajectory").loc[names], dict(zip(names, count(), strict=False))
    stages = stages.iloc[np.argsort(stages["trajectory"].map(number).to_numpy(), kind="stable")]
    for text, known in policy.categories.items():
        stages = stages.assign(**{text: stages[text].where(stages[text].isin(list(known)), known[0])})
    courses = Courses(
        is_policy=trajectories[ARM].eq(POLICY).to_numpy(dtype=bool),
        chance=trajectories[CHANCE].to_numpy(dtype=np.float64),
        end_s=trajectories["end_s"].to_numpy(dtype=np.float64),
        is_finished=trajectories["ending"].eq(FINISHED).to_numpy(dtype=bool),
        trajectory=stages["trajectory"].map(number).to_numpy(dtype=np.int64),
        state=policy.looks_at.encode(stages) if len(stages) else np.zeros((0, num_features)),
        reward=stages["reward"].to_numpy(dtype=np.float64),
        clock_s=stages["elapsed_s"].to_numpy(dtype=np.float64),
    )
    # Same memory layout as for trajectories one by one; otherwise matrix products differ in the last bit.
    return Courses(*map(np.ascontiguousarray, courses))


def num_until_decided(courses: Courses) -> int:
    """Number of trajectories before the first that was not randomised. It shows the verdict; later ones add nothing."""
    is_decided = (courses.chance == 0.0) | (courses.chance == 1.0)
    return int(np.argmax(is_decided)) if is_decided.any() else courses.num


def course_of(rows: Mapping[str, Sequence[Mapping[str, Any]]], policy: DiscretePolicy) -> Courses:
    """Convert the rows of one trajectory, as `courses_of` does for a log.

    Parameters
    ----------
    rows
        As in `halfseen.logs.recorded.RecordedTrajectory`.
    policy
        Policy whose covariates are used.
    """
    (trajectory,), stages = rows["trajectories"], rows["stages"]
    first = {text: known[0] for text, known in policy.categories.items()}
    seen = [
        {**row, **{text: first[text] for text in first if not policy.looks_at.is_known(text, row.get(text))}}
        for row in stages
    ]

    def numbers(name: str) -> Float[np.ndarray, " m"]:
        return np.array([row[name] for row in stages], dtype=np.float64)

    return Courses(
        is_policy=np.array([trajectory[ARM] == POLICY]),
        chance=np.array([trajectory[CHANCE]], dtype=np.float64),
        end_s=np.array([trajectory["end_s"]], dtype=np.float64),
        is_finished=np.array([trajectory["ending"] == FINISHED]),
        trajectory=np.zeros(len(stages), dtype=np.int64),
        state=policy.looks_at.encode_known(seen),
        reward=numbers("reward"),
        clock_s=numbers("elapsed_s"),
    )


def joined(one: Courses, other: Courses) -> Courses:
    """Append trajectories to others."""
    later = other._replace(trajectory=other.trajectory + one.num)
    return Courses(*(np.concatenate(each) for each in zip(one, later, strict=True)))
