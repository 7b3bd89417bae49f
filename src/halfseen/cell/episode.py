"""One table, from the first look to its end, by one robot: what came of it, and its trajectory in a log."""

from collections.abc import Callable

import numpy as np

from halfseen.cell.account import Account, Run
from halfseen.cell.clearing import PAUSE_S, Chosen, Moment, Row, Shift, Told, chances_of, cleared
from halfseen.cell.table_state import Belief, rows_of, state_of
from halfseen.cell.workcell import Workcell
from halfseen.logs.trajectory_recorder import TrajectoryRecorder
from halfseen.shapes import Bool
from halfseen.world.actions import Verb
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.state import TableState


def play(
    cell: Workcell,
    is_dirty: Bool[np.ndarray, " N"],
    policy: Policy,
    belief: Belief,
    trajectory: TrajectoryRecorder,
    key: Key,
    *,
    tells_truth: bool = False,
    on_decision: Callable[[Moment], None] = lambda _: None,
) -> Run:
    """Let a policy clear a table, and record it.

    Parameters
    ----------
    cell
        The cell, before its first look.
    is_dirty
        The truth of each cup.
    policy
        What decides.
    belief
        What the robot believes of the world; its rewards are those that are earned.
    trajectory
        What is recorded; it is ended, finished or cut.
    key
        What the policy draws from.
    tells_truth
        Record which objects are dirty, as whoever calibrates a cell knows.
    on_decision
        Called with each decision, before it is carried out.

    Returns
    -------
    Run
        What came of it.
    """
    account = Account(Run(), cell, is_dirty, belief.config)
    shift = _OneRobot(cell, account, belief)
    return cleared(shift, policy, trajectory, key, tells_truth=tells_truth, on_decision=on_decision)


class _OneRobot(Shift):
    """A robot that has the table for itself."""

    def __init__(self, cell: Workcell, account: Account, belief: Belief) -> None:
        super().__init__(cell, account, belief.config.horizon)
        self._belief = belief
        self._verb, self._target, self._chance = Verb.FINISH, 0, 0.0

    def look(self, step: int) -> None:
        self.cell.cell.wait(PAUSE_S)
        self.cell.look()

    def known(self, step: int) -> tuple[TableState, list[Row]]:
        memory = self.cell.memory
        return state_of(memory, self._belief, self.num_decisions - step), rows_of(memory, self._belief)

    @property
    def decider(self) -> None:
        return None

    def covariates(self) -> Row:
        return {}

    def begin(self, chosen: Chosen, rows: list[Row]) -> Told:
        self._verb, self._target = Verb(chosen.verb), chosen.target
        if self._verb is Verb.FINISH:
            return Told("FINISH: nothing is worth another step")
        self._chance, hidden = float(chances_of(rows)[self._target]), rows[self._target]["occlusion"]
        what = f"{self._verb.name} object {self._target}"
        return Told(f"{what}: dirty with probability {self._chance:.2f}, {hidden:.0%} hidden")

    def go_on(self) -> bool:
        cell, begin_s = self.cell, self.cell.cell.time_s
        if self._verb is Verb.FINISH:
            cell.cell.wait(float(self._belief.config.transport_s))
            return True
        attempt = cell.wash(self._target) if self._verb is Verb.WASH else cell.lift(self._target)
        self.account.end(attempt, self._verb, self._chance, cell.cell.time_s - begin_s)
        return self.account.truth.is_cleared(cell)
