"""From what is known in a cell of several arms to the state that a team decides in, and to what its log adds."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from halfseen.cell.attempt import Attempt
from halfseen.cell.memory import Known
from halfseen.cell.table_state import Belief, state_of
from halfseen.cell.workcell import Workcell
from halfseen.perception.clouds import Vector
from halfseen.shapes import Bool
from halfseen.world.actions import TARGETED, VERB_NAMES
from halfseen.world.log_checks import ATTEMPT_BY
from halfseen.world.log_rows import FREE, PARKED
from halfseen.world.robots import CLEARANCE_M
from halfseen.world.state import Robots, TableState, Workspace

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
