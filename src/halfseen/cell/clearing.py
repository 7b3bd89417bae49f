"""A table from the first look to its end, whoever works at it: look, decide, record, carry out, and book.

`episode` lets one robot work, `several.team_episode` several.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit

from halfseen.arrays import Rows
from halfseen.cell.account import Account, Run
from halfseen.cell.stops import StoppedError
from halfseen.cell.workcell import Workcell
from halfseen.logs.trajectory_recorder import TrajectoryRecorder
from halfseen.world import random
from halfseen.world.actions import TARGETED, VERB_NAMES, ActionSpace
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.state import TableState

PAUSE_S = 0.5
"""What a look and a decision take on the cell's clock [s]."""
NOTHING_SEEN = "nothing-seen"
"""Cause of a cut: no object is in view, so that there is nothing to decide."""
Row = dict[str, Any]
"""What a log holds of an object in a stage."""


class Moment(NamedTuple):
    """A decision, and what it was made from."""

    stage: int
    """From 1."""
    state: TableState
    """The table as the robot knows it."""
    action: int
    """What is done, as `ActionSpace` has it."""
    words: str
    """The same, for people."""
    key: Key
    """What the policy drew from."""
    arm: int = 0
    """Number of the robot that does it."""
    of_team: str | None = None
    """Which robot does what, where there are several."""


class Chosen(NamedTuple):
    """An action."""

    action: int
    """As `ActionSpace` has it; one beyond it is WAIT."""
    verb: int
    target: int

    @property
    def acted_on(self) -> int | None:
        """Its object; None where it has none."""
        return self.target if self.verb in TARGETED else None

    @property
    def name(self) -> str:
        """Of its verb."""
        return VERB_NAMES[self.verb]


class Told(NamedTuple):
    """A decision in words, as `Moment` has it."""

    words: str
    arm: int = 0
    of_team: str | None = None


class Shift(ABC):
    """Who works at a table.

    Parameters
    ----------
    cell
        The cell, before its first look.
    account
        What books what is earned.
    num_decisions
        How many may be made.
    """

    def __init__(self, cell: Workcell, account: Account, num_decisions: int) -> None:
        self.cell, self.account, self.num_decisions = cell, account, num_decisions

    @abstractmethod
    def look(self, step: int) -> None:
        """Look at the table before a decision, the first of which is number 0."""

    @abstractmethod
    def known(self, step: int) -> tuple[TableState, list[Row]]:
        """Give the state that is decided in, and its objects as a log has them."""

    @property
    @abstractmethod
    def decider(self) -> int | None:
        """Of several robots, the number of the one that decides next; None of one."""

    @abstractmethod
    def covariates(self) -> Row:
        """Give what else a log has of the stage that begins."""

    @abstractmethod
    def begin(self, chosen: Chosen, rows: list[Row]) -> Told:
        """Take up what was chosen, before any time passes."""

    @abstractmethod
    def go_on(self) -> bool:
        """Carry it out until somebody decides again; whether the table is over instead."""


def cleared(
    shift: Shift,
    policy: Policy,
    trajectory: TrajectoryRecorder,
    key: Key,
    *,
    tells_truth: bool,
    on_decision: Callable[[Moment], None],
) -> Run:
    """Let a policy clear a table, and record it.

    Parameters
    ----------
    shift
        Who works at it.
    policy
        What decides.
    trajectory, key, tells_truth, on_decision
        As for `halfseen.cell.episode.play`.

    Returns
    -------
    Run
        What came of it: that of the account, with its end.
    """
    cell, account = shift.cell, shift.account
    begin_s = cell.cell.time_s
    try:
        for step in range(shift.num_decisions):
            shift.look(step)
            if not cell.memory.objects:
                raise StoppedError(NOTHING_SEEN)
            state, rows = shift.known(step)
            if step == 0:
                account.see(chances_of(rows))
            if tells_truth:
                account.truth.add_to(rows, cell)
            drawn_from = random.fold_in(key, step)
            chosen, chance = _chosen(policy, state, drawn_from)
            trajectory.begin_stage(shift.covariates(), rows, chosen.name, chosen.acted_on, chance, shift.decider)
            account.decide(chosen.name)
            on_decision(_moment(step, state, chosen, shift.begin(chosen, rows), drawn_from))
            is_over = shift.go_on() or step + 1 == shift.num_decisions
            paid, elapsed_s = account.pay(is_over=is_over), cell.cell.time_s - begin_s
            trajectory.complete_stage(paid.reward, elapsed_s=elapsed_s, own_rewards=paid.of_robots)
            if is_over:
                break
        trajectory.finish(elapsed_s=cell.cell.time_s - begin_s)
    except StoppedError as stopped:
        account.run.cause = str(stopped)
        trajectory.cut(account.run.cause, elapsed_s=cell.cell.time_s - begin_s)
    account.run.seconds = cell.cell.time_s - begin_s
    return replace(account.run, **account.truth.counts(cell))


def _moment(step: int, table: TableState, chosen: Chosen, told: Told, key: Key) -> Moment:
    return Moment(step + 1, table, chosen.action, told.words, key, told.arm, told.of_team)


def _chosen(policy: Policy, state: TableState, key: Key) -> tuple[Chosen, float | None]:
    """Decide; how likely that was, too, where the policy can say it: a planner cannot."""
    decision, actions = policy.decide(state, key), ActionSpace(state.num_objects)
    action = int(decision.action)
    chance = None if np.isnan(decision.probability) else float(decision.probability)
    return Chosen(action, int(actions.verb(action)), int(actions.target(action))), chance


def chances_of(rows: list[Row]) -> Rows:
    """P(DIRTY) of the objects of a stage.

    Parameters
    ----------
    rows
        As a log has them.
    """
    return expit(np.array([row["log_odds"] for row in rows], dtype=float))
