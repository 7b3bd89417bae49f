"""A comparison in the cell: each trajectory is dealt to the policy or to the rule of today, and the log says which.

The columns `ARM`, `CHANCE` and `COMPARISON` of a trajectory are the whole state: a server that begins again reads the
log, and deals on as the one before would have. The probability of an action is that of the whole, whichever arm it is
of: P(a | so far) = π P₁(a) + (1 − π) P₀(a), π the chance of the policy given the actions so far. So the product over
stages is that of a log of both arms, and learning and evaluation by it stay right.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import NothingRecordedError
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.logs import Logs, read_logs
from halfseen.logs.columns import FINISHED
from halfseen.logs.recorded import STILL_RUNNING, followed
from halfseen.monitoring.comparison import Courses, Kept, counted
from halfseen.monitoring.dealing import ARM, POLICY, RULE, Standing, Terms, standing
from halfseen.policies.rule_files import FallBack, fall_back_of
from halfseen.reading import read_bytes
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
        Its arm.
    chance
        With which it was dealt to the policy.
    belief
        Chance of the policy given the actions so far.
    """

    is_policys: bool
    chance: float
    belief: float

    after: float = 1.0
    """The belief once the next action is taken."""

    def probability(self, by_policy: float, by_rule: float) -> float:
        """Of the next action, which each arm takes with these, given those before it."""
        likely = self.belief * by_policy + (1.0 - self.belief) * by_rule
        self.after = self.belief * by_policy / likely
        return likely

    def took(self) -> None:
        """Take that action into account, now that it is recorded."""
        self.belief = self.after


@dataclass(eq=False)
class Comparison:
    """Deals the trajectories of a cell, and says how the comparison stands.

    Parameters
    ----------
    service
        The policy.
    file
        The rule of today, as .csv or .toml.
    folder
        Where trajectories are recorded.
    terms
        How it is held.
    seed
        Of the deals.
    say
        Is given a sentence where the verdict changes.
    """

    service: "InService"
    file: Path
    folder: Path
    terms: Terms = field(default_factory=Terms)
    seed: int = 0
    say: Callable[[str], object] = field(default_factory=lambda: print)

    def __post_init__(self) -> None:
        self.deal: Deal | None = None
        self.courses = self._recorded()
        self.kept = Kept()
        self.counted = counted(self.courses, kept=self.kept)
        self.standing: Standing = standing(self.courses, self.terms, self.counted, self.kept)

    @cached_property
    def rule(self) -> FallBack:
        """What decides in the rule's trajectories."""
        found = fall_back_of(self.service.stored, self.file)
        assert found is not None, "a rule file says what decides"
        return found

    @cached_property
    def name(self) -> str:
        """Tells it from comparisons of other policies or rules in the same log."""
        return f"{self.service.digest}:{hashlib.sha256(read_bytes(self.file)).hexdigest()[:12]}"

    @property
    def policy(self) -> DiscretePolicy:
        """The policy."""
        return self.service.stored.policy

    def dealt(self) -> Deal:
        """Deal the next trajectory, unless it is; the same seed and log give the same deal."""
        if self.deal is None:
            share, luck = self.standing.share, np.random.default_rng([self.seed, self.courses.num]).random()
            self.deal = Deal(bool(luck < share), share, share)
        return self.deal

    def columns(self) -> dict[str, Any]:
        """What is recorded of the trajectory."""
        deal = self.dealt()
        return {ARM: POLICY if deal.is_policys else RULE, CHANCE: deal.chance, COMPARISON: self.name}

    def resumed(self, events: Sequence[dict[str, Any]]) -> bool:
        """Go on with a trajectory in progress, as the log has it; False where it was not dealt by this comparison."""
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
        """Count a trajectory that is over, as the log has it."""
        self.deal = None
        rows = followed(events).rows
        if rows["trajectories"][0].get(COMPARISON) != self.name or num_until_decided(self.courses) < self.courses.num:
            return
        before, self.courses = self.standing.verdict, joined(self.courses, course_of(rows, self.policy))
        self.counted = counted(self.courses, self.counted, self.kept)
        self.standing = standing(self.courses, self.terms, self.counted, self.kept)
        if self.standing.verdict != before:
            self.say(f"the policy is {self.standing}")

    def of(self, service: "InService", *, is_in_progress: bool) -> "Comparison":
        """That of another policy, in the same log; a trajectory in progress goes on, and counts for neither."""
        if service.digest == self.service.digest:
            return self
        other = replace(self, service=service)
        other.deal = self.deal if is_in_progress else None
        return other

    @property
    def facts(self) -> Compared:
        """What `/comparison` says."""
        return Compared(sentence=str(self.standing), **vars(self.standing))

    def _recorded(self) -> Courses:
        if not self.folder.exists():
            return courses_of(None, self.policy, self.name)
        try:
            courses = courses_of(read_logs(self.folder), self.policy, self.name)
        except NothingRecordedError:
            return courses_of(None, self.policy, self.name)
        return courses.part(0, min(courses.num, num_until_decided(courses) + 1))


def courses_of(logs: Logs | None, policy: DiscretePolicy, name: str) -> Courses:
    """Take the trajectories of a comparison from a log; none from None.

    Parameters
    ----------
    logs
        The log.
    policy
        Whose covariates count.
    name
        What `COMPARISON` holds for them.
    """
    num_features = policy.looks_at.num_features
    if logs is None or COMPARISON not in logs.trajectories.columns:
        none = np.zeros(0)
        is_one = np.zeros(0, dtype=bool)
        return Courses(is_one, none, none, is_one, none.astype(np.int64), np.zeros((0, num_features)), none, none)
    is_its = logs.trajectories[COMPARISON].eq(name).fillna(False) & logs.trajectories["cause"].ne(STILL_RUNNING)
    trajectories: Any = logs.trajectories[is_its]
    stages: Any = logs.stages[logs.stages["trajectory"].isin(trajectories["trajectory"])]
    # In the order in which they were recorded, also where names are text.
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
    # Laid out as they are where trajectories come one by one: else products of matrices differ in the last bit.
    return Courses(*map(np.ascontiguousarray, courses))


def num_until_decided(courses: Courses) -> int:
    """Trajectories before the first that was not dealt by chance. It says what was decided; later ones add nothing."""
    is_decided = (courses.chance == 0.0) | (courses.chance == 1.0)
    return int(np.argmax(is_decided)) if is_decided.any() else courses.num


def course_of(rows: Mapping[str, Sequence[Mapping[str, Any]]], policy: DiscretePolicy) -> Courses:
    """Take one trajectory from its rows, as `courses_of` does from the log.

    Parameters
    ----------
    rows
        As `halfseen.logs.recorded.RecordedTrajectory` has them.
    policy
        Whose covariates count.
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
    """Put trajectories after others."""
    later = other._replace(trajectory=other.trajectory + one.num)
    return Courses(*(np.concatenate(each) for each in zip(one, later, strict=True)))
