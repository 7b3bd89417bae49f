"""From what is known in a cell to the state that a policy decides in, and to the rows of a log."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.cell.facts import Facts
from halfseen.cell.fetching import Attempt
from halfseen.cell.memory import Known, Memory
from halfseen.cell.workcell import Workcell
from halfseen.perception.clouds import Vector
from halfseen.planners.belief import known_seeing
from halfseen.shapes import Bool
from halfseen.world.actions import TARGETED, VERB_NAMES
from halfseen.world.config import WorldConfig
from halfseen.world.log_checks import ATTEMPT_BY, DISHWASHER, LOST, PLACE_COLUMNS, TABLE
from halfseen.world.log_rows import FREE, PARKED
from halfseen.world.robots import CLEARANCE_M
from halfseen.world.seeing import label_evidence
from halfseen.world.state import NO_ATTEMPT, Robots, TableState, Workspace

MOST_OBJECTS = 12
"""States are padded to so many objects, among which whoever explores draws; tables with more are padded to more."""


class Belief(NamedTuple):
    """What the robot believes of the world: it makes chances of what it was told."""

    config: WorldConfig
    """Prior, law of seeing, horizon."""
    grip: Callable[[Facts], float]
    """How well an object can be gripped, from what is seen of it."""


def no_grip(facts: Facts) -> float:
    """Give 0: nothing is known of what makes objects hard to grip."""
    return 0.0


def state_of(memory: Memory, belief: Belief, steps_to_go: int) -> TableState:
    """Give the state of the table as the robot knows it.

    Parameters
    ----------
    memory
        What it knows.
    belief
        What it believes of the world.
    steps_to_go
        Actions left, the next one included.
    """
    objects, horizon = memory.objects, belief.config.horizon
    size = max(MOST_OBJECTS, len(objects))
    hides = np.zeros((size, size), dtype=np.float32)
    hides[: len(objects), : len(objects)] = memory.hides
    tried = [(k, trial.occlusion, trial.is_held) for k, known in enumerate(objects) for trial in known.trials]
    empty = [(NO_ATTEMPT, 0.0, False)] * (horizon - len(tried))
    target, occluded, succeeded = zip(*tried[:horizon], *empty, strict=True)
    told = [_told(known, belief.config) for known in objects]

    def padded(values: list[Any], kind: Any) -> np.ndarray:
        return np.array([*values, *[0] * (size - len(values))], dtype=kind)

    leaves = {
        "hides": hides,
        "is_object": padded([True] * len(objects), bool),
        "grip": padded([belief.grip(known.facts) for known in objects], np.float32),
        "is_on_table": padded([not known.is_gone for known in objects], bool),
        "log_odds": padded([log_odds for log_odds, _ in told], np.float32),
        "seen": padded([seen for _, seen in told], np.float32),
        "lifts": padded([known.lifts for known in objects], np.int32),
        "attempt_object": np.array(target, dtype=np.int32),
        "attempt_occlusion": np.array(occluded, dtype=np.float32),
        "attempt_succeeded": np.array(succeeded, dtype=bool),
        "steps_to_go": np.int32(steps_to_go),
    }
    return TableState(**leaves)


def _told(known: Known, config: WorldConfig) -> tuple[float, float]:
    """Log-odds of DIRTY given all labels, and how much of the object counts as seen."""
    law, seen = known_seeing(config), 0.0
    log_odds = float(np.log(config.dirty_share) - np.log1p(-config.dirty_share))
    for glance in known.glances:
        chances = law.positive(np.float64(glance.occlusion), seen, glance.is_held)
        if not any(chances):
            continue  # what shows nothing new tells nothing, whatever it says
        log_odds += float(label_evidence(*chances, glance.says_dirty))
        seen = float(law.after(np.float64(glance.occlusion), seen, glance.says_dirty, glance.is_held))
    return log_odds, seen


def rows_of(memory: Memory, belief: Belief) -> list[dict[str, Any]]:
    """Rows of a log for the objects: what a policy saw, what looks and attempts told, and what may make it hard.

    Parameters
    ----------
    memory
        What the robot knows.
    belief
        What it believes of the world.
    """
    places = [dict(zip(PLACE_COLUMNS, place, strict=True)) for place in memory.places_m().tolist()]
    return [{**_row(number, known, memory, belief), **places[number]} for number, known in enumerate(memory.objects)]


def _row(number: int, known: Known, memory: Memory, belief: Belief) -> dict[str, Any]:
    held, hidden_by = [trial.is_held for trial in known.trials], memory.hides[number]
    log_odds, seen = _told(known, belief.config)
    return {
        "object": number,
        "location": DISHWASHER if known.is_racked else LOST if known.is_lost else TABLE,
        "occlusion": memory.occlusion(number),
        "grip": belief.grip(known.facts),
        "log_odds": log_odds,
        "seen": seen,
        "successes": sum(held),
        "failures": len(held) - sum(held),
        "lifts": known.lifts,
        "hidden_by": hidden_by.tolist(),
        "attempt_occlusions": [trial.occlusion for trial in known.trials],
        "attempt_succeeded": held,
        "attempt_s": [trial.duration_s for trial in known.trials],
        "glance_occlusions": [glance.occlusion for glance in known.glances],
        "glance_held": [glance.is_held for glance in known.glances],
        "glance_dirty": [glance.says_dirty for glance in known.glances],
        **asdict(known.facts),
    }


_MOVED_M = 0.03


@dataclass
class Doing:
    """What one arm is at.

    Attributes
    ----------
    verb, target
        Of it; None where it is free.
    begun_s
        When it began, on the cell's clock [s].
    is_parked
        Whether it does nothing more.
    decisions_to_go
        How many it may still make.
    chance
        P(DIRTY) of the target when it was decided.
    """

    decisions_to_go: int
    verb: int | None = None
    target: int = 0
    begun_s: float = 0.0
    is_parked: bool = False
    chance: float = 0.0

    @property
    def is_free(self) -> bool:
        """Whether it is to decide."""
        return self.verb is None and not self.is_parked and self.decisions_to_go > 0

    @property
    def is_done(self) -> bool:
        """Whether it has come to its own end."""
        return self.verb is None and (self.is_parked or self.decisions_to_go == 0)

    @property
    def words(self) -> str:
        """What it is at, as a log has it."""
        if self.verb is None:
            return PARKED if self.is_parked else FREE
        return VERB_NAMES[self.verb] + (f" {self.target}" if self.verb in TARGETED else "")


@dataclass
class TeamTable:
    """The arms of a cell at one table, as its states have them.

    Parameters
    ----------
    cell
        The cell.
    belief
        What is believed of the world; its horizon is counted in decisions of each arm.

    Attributes
    ----------
    doing
        What each arm is at.
    """

    cell: Workcell
    belief: Belief
    doing: list[Doing] = field(init=False)
    _too_far: dict[tuple[int, int], Vector] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.doing = [Doing(self.belief.config.horizon) for _ in self.cell.stations]

    def learn(self, arm: int, number: int, attempt: Attempt) -> None:
        """Learn from an attempt what an arm does not reach.

        That it found no grasp within its reach is remembered for as long as the object stays where it is and nothing
        changes on the table: an arm that was there, and has left, may have been in the way, or has moved what was.

        Parameters
        ----------
        arm
            Whose it was.
        number
            Of its object.
        attempt
            How it went.
        """
        if attempt.kind is not None:
            self._too_far.clear()
        if attempt.is_too_far:
            self._too_far[arm, number] = self._objects[number].middle_m

    @property
    def _objects(self) -> list[Known]:
        return self.cell.memory.objects

    def state(self, decider: int, decisions_to_go: int) -> TableState:
        """Give what an arm decides in.

        Parameters
        ----------
        decider
            Its number.
        decisions_to_go
            Of all arms together, this one included.
        """
        table = state_of(self.cell.memory, self.belief, decisions_to_go)
        size, num = table.num_objects, len(self._objects)
        reached, near = np.zeros((len(self.doing), size), dtype=bool), np.zeros((size, size), dtype=bool)
        reached[:, :num], near[:num, :num] = self.is_in_reach(), self.is_near()
        return replace(table, robots=self._robots(), workspace=Workspace(reached, near), decider=np.int32(decider))

    def is_in_reach(self) -> Bool[np.ndarray, "K N"]:
        """Which objects each arm reaches."""
        bases_m = np.array([station.robot.base_m[:2] for station in self.cell.stations])
        apart_m = np.linalg.norm(self._places_m()[None] - bases_m[:, None], axis=-1)
        reached = apart_m <= np.array([station.reach_m for station in self.cell.stations])[:, None]
        for (arm, number), place_m in self._too_far.items():
            if np.linalg.norm(self._objects[number].middle_m - place_m) < _MOVED_M:
                reached[arm, number] = False
        return reached

    def is_near(self) -> Bool[np.ndarray, "N N"]:
        """Which objects are too near to one another for two arms at once."""
        places_m = self._places_m()
        return np.linalg.norm(places_m[:, None] - places_m[None], axis=-1) < CLEARANCE_M

    def _places_m(self) -> np.ndarray:
        return np.array([known.middle_m[:2] for known in self._objects]).reshape(-1, 2)

    def _robots(self) -> Robots:
        def each(values: list[Any], kind: Any) -> Any:
            return np.array(values, dtype=kind)

        doing = self.doing
        return Robots(
            is_busy=each([one.verb is not None for one in doing], bool),
            is_parked=each([one.is_parked for one in doing], bool),
            verb=each([one.verb or 0 for one in doing], np.int32),
            target=each([one.target for one in doing], np.int32),
            since_s=each([self._since_s(one) for one in doing], np.float32),
            decisions_to_go=each([one.decisions_to_go for one in doing], np.int32),
        )

    def _since_s(self, one: Doing) -> float:
        return 0.0 if one.verb is None else self.cell.cell.time_s - one.begun_s

    def columns(self) -> dict[str, Any]:
        """What a stage of the log holds of the arms, as `halfseen.world.logs` has it."""
        told: dict[str, Any] = {}
        for arm, one in enumerate(self.doing):
            told |= {f"{arm}_does": one.words, f"{arm}_since_s": self._since_s(one)}
            told[f"{arm}_decisions_to_go"] = one.decisions_to_go
        return told

    def add_to(self, rows: list[dict[str, Any]]) -> None:
        """Add to the rows of the objects who reaches them, what is near, and who tried them."""
        reached, near = self.is_in_reach(), self.is_near()
        for number, row in enumerate(rows):
            row["reached_by"] = np.flatnonzero(reached[:, number]).tolist()
            row["near"] = np.flatnonzero(near[number]).tolist()
            row[ATTEMPT_BY] = [trial.arm for trial in self._objects[number].trials]

    def name(self, arm: int) -> str:
        """What an arm is called."""
        return self.cell.stations[arm].robot.name

    def in_words(self) -> str:
        """What all arms are at, for people."""
        return "; ".join(f"{self.name(arm)}: {one.words}" for arm, one in enumerate(self.doing))
