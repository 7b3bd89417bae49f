"""Conversion of the knowledge in a cell of K arms into a policy's state and into the rows of a log."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.cell.facts import Facts
from halfseen.cell.fetching import ObservedAttempt
from halfseen.cell.memory import KnownObject, Memory
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
"""States are padded to at least this many objects; exploration draws among all of them."""
_MOVED_M = 0.03


class Belief(NamedTuple):
    """The robot's model of the world, which turns looks and attempts into probabilities.

    `config` has the prior, the model of seeing and the horizon. `grip` predicts from its facts how well an object can
    be gripped.
    """

    config: WorldConfig
    grip: Callable[[Facts], float]


def no_grip(facts: Facts) -> float:
    """Return 0: there is no model of what makes objects hard to grip."""
    return 0.0


def state_of(memory: Memory, belief: Belief, steps_to_go: int) -> TableState:
    """State of the table as one robot knows it."""
    objects, horizon = memory.objects, belief.config.horizon
    num_more = max(MOST_OBJECTS - len(objects), 0)
    tried = [(k, trial.occlusion, trial.is_held) for k, known in enumerate(objects) for trial in known.trials]
    empty = [(NO_ATTEMPT, 0.0, False)] * (horizon - len(tried))
    target, occluded, succeeded = zip(*tried[:horizon], *empty, strict=True)
    evidence = [_evidence(known, belief.config) for known in objects]

    def padded(values: list[Any], kind: Any) -> np.ndarray:
        return np.pad(np.array(values, dtype=kind), (0, num_more))

    return TableState(
        hides=np.pad(memory.hides.astype(np.float32), (0, num_more)),
        is_object=padded([True] * len(objects), bool),
        grip=padded([belief.grip(known.facts) for known in objects], np.float32),
        is_on_table=padded([not known.is_gone for known in objects], bool),
        log_odds=padded([log_odds for log_odds, _ in evidence], np.float32),
        seen=padded([seen for _, seen in evidence], np.float32),
        lifts=padded([known.lifts for known in objects], np.int32),
        attempt_object=np.array(target, dtype=np.int32),
        attempt_occlusion=np.array(occluded, dtype=np.float32),
        attempt_succeeded=np.array(succeeded, dtype=bool),
        steps_to_go=np.int32(steps_to_go),
    )


def _evidence(known: KnownObject, config: WorldConfig) -> tuple[float, float]:
    """Log-odds of DIRTY given all labels, and the share of the object that counts as seen."""
    law, seen = known_seeing(config), 0.0
    log_odds = float(np.log(config.dirty_share) - np.log1p(-config.dirty_share))
    for glance in known.glances:
        chances = law.positive(np.float64(glance.occlusion), seen, glance.is_held)
        if not any(chances):
            continue  # a look that shows nothing new is no evidence
        log_odds += float(label_evidence(*chances, glance.says_dirty))
        seen = float(law.after(np.float64(glance.occlusion), seen, glance.says_dirty, glance.is_held))
    return log_odds, seen


def rows_of(memory: Memory, belief: Belief) -> list[dict[str, Any]]:
    """Log rows of the objects: the policy's inputs, the results of looks and attempts, and the facts for grasping."""
    places = [dict(zip(PLACE_COLUMNS, place, strict=True)) for place in memory.places_m().tolist()]
    return [{**_row(number, known, memory, belief), **places[number]} for number, known in enumerate(memory.objects)]


def _row(number: int, known: KnownObject, memory: Memory, belief: Belief) -> dict[str, Any]:
    held = [trial.is_held for trial in known.trials]
    log_odds, seen = _evidence(known, belief.config)
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
        "hidden_by": memory.hides[number].tolist(),
        "attempt_occlusions": [trial.occlusion for trial in known.trials],
        "attempt_succeeded": held,
        "attempt_s": [trial.duration_s for trial in known.trials],
        "glance_occlusions": [glance.occlusion for glance in known.glances],
        "glance_held": [glance.is_held for glance in known.glances],
        "glance_dirty": [glance.says_dirty for glance in known.glances],
        **asdict(known.facts),
    }


@dataclass
class ArmStatus:
    """Current activity of one arm.

    Attributes
    ----------
    decisions_to_go
        Number of decisions left.
    verb, target
        Current action; `verb` is None if the arm is free.
    begun_s
        Start of the action on the cell's clock [s].
    is_parked
        Whether the arm has finished for good.
    chance
        P(DIRTY) of the target at the decision.
    """

    decisions_to_go: int
    verb: int | None = None
    target: int = 0
    begun_s: float = 0.0
    is_parked: bool = False
    chance: float = 0.0

    @property
    def is_free(self) -> bool:
        """Whether it may decide now."""
        return self.verb is None and not self.is_parked and self.decisions_to_go > 0

    @property
    def is_done(self) -> bool:
        """Whether it has reached its own end."""
        return self.verb is None and (self.is_parked or self.decisions_to_go == 0)

    @property
    def words(self) -> str:
        """Current action, as written in a log."""
        if self.verb is None:
            return PARKED if self.is_parked else FREE
        return VERB_NAMES[self.verb] + (f" {self.target}" if self.verb in TARGETED else "")


class CellState:
    """The table and arms of a cell, in the form of states and log rows; `arms` has the activity of each arm.

    The horizon of the belief counts the decisions of each arm.
    """

    def __init__(self, cell: Workcell, belief: Belief) -> None:
        horizon, num_arms = belief.config.horizon, len(cell.stations)
        self.cell, self.arms = cell, [ArmStatus(horizon) for _ in range(num_arms)]
        # A state has room for the attempts of all arms.
        self._belief = belief._replace(config=replace(belief.config, horizon=horizon * num_arms))
        self._too_far: dict[tuple[int, int], Vector] = {}

    def learn(self, arm: int, number: int, attempt: ObservedAttempt) -> None:
        """Learn from an attempt which objects an arm cannot reach.

        A failure for lack of reach is remembered as long as the object stays in place and nothing changes on the table.
        After another attempt, the obstacle may be gone: it may have been an arm that has left, or a moved object.
        """
        if attempt.kind is not None:
            self._too_far.clear()
        if attempt.is_too_far:
            self._too_far[arm, number] = self.cell.memory.objects[number].middle_m

    def state(self, decider: int, decisions_to_go: int) -> TableState:
        """State for the decision of an arm."""
        table = state_of(self.cell.memory, self._belief, decisions_to_go)
        if len(self.arms) == 1:
            return table
        num_more = table.num_objects - len(self.cell.memory.objects)
        reached, near = np.pad(self.is_in_reach(), ((0, 0), (0, num_more))), np.pad(self.is_near(), (0, num_more))
        return replace(table, robots=self._robots(), workspace=Workspace(reached, near), decider=np.int32(decider))

    def rows(self) -> list[dict[str, Any]]:
        """Log rows of the objects; with several arms, also the arms that reach or tried them, and objects nearby."""
        rows = rows_of(self.cell.memory, self._belief)
        if len(self.arms) > 1:
            reached, near = self.is_in_reach(), self.is_near()
            for number, (row, known) in enumerate(zip(rows, self.cell.memory.objects, strict=True)):
                row["reached_by"] = np.flatnonzero(reached[:, number]).tolist()
                row["near"] = np.flatnonzero(near[number]).tolist()
                row[ATTEMPT_BY] = [trial.arm for trial in known.trials]
        return rows

    def columns(self) -> dict[str, Any]:
        """Columns of a stage in the log of several arms, as in `halfseen.world.logs`."""
        columns: dict[str, Any] = {}
        for number, arm in enumerate(self.arms if len(self.arms) > 1 else ()):
            columns |= {f"{number}_does": arm.words, f"{number}_since_s": self._since_s(arm)}
            columns[f"{number}_decisions_to_go"] = arm.decisions_to_go
        return columns

    def is_in_reach(self) -> Bool[np.ndarray, "K N"]:
        """Mask of the objects within each arm's reach."""
        bases_m = np.array([station.robot.base_m[:2] for station in self.cell.stations])
        apart_m = np.linalg.norm(self._places_m()[None] - bases_m[:, None], axis=-1)
        reached = apart_m <= np.array([station.reach_m for station in self.cell.stations])[:, None]
        for (arm, number), place_m in self._too_far.items():
            if np.linalg.norm(self.cell.memory.objects[number].middle_m - place_m) < _MOVED_M:
                reached[arm, number] = False
        return reached

    def is_near(self) -> Bool[np.ndarray, "N N"]:
        """Mask of the object pairs too close together for two arms at once."""
        places_m = self._places_m()
        return np.linalg.norm(places_m[:, None] - places_m[None], axis=-1) < CLEARANCE_M

    def _places_m(self) -> np.ndarray:
        return np.array([known.middle_m[:2] for known in self.cell.memory.objects]).reshape(-1, 2)

    def _robots(self) -> Robots:
        arms = self.arms
        return Robots(
            is_busy=np.array([arm.verb is not None for arm in arms]),
            is_parked=np.array([arm.is_parked for arm in arms]),
            verb=np.array([arm.verb or 0 for arm in arms], dtype=np.int32),
            target=np.array([arm.target for arm in arms], dtype=np.int32),
            since_s=np.array([self._since_s(arm) for arm in arms], dtype=np.float32),
            decisions_to_go=np.array([arm.decisions_to_go for arm in arms], dtype=np.int32),
        )

    def _since_s(self, arm: ArmStatus) -> float:
        return 0.0 if arm.verb is None else self.cell.cell.time_s - arm.begun_s

    def in_words(self) -> str:
        """Description of the current actions of all arms."""
        names = [station.robot.name for station in self.cell.stations]
        return "; ".join(f"{name}: {arm.words}" for name, arm in zip(names, self.arms, strict=True))
