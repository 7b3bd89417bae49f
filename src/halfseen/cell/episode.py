"""One table, from the first look to its end, decided by a policy: what came of it, and its path in a log."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.special import expit

from halfseen.arrays import Points, Rows
from halfseen.cell.luck import luck_of_table, luck_of_washing
from halfseen.cell.stops import StoppedError
from halfseen.cell.table_state import Belief, rows_of, state_of
from halfseen.cell.workcell import Attempt, Workcell
from halfseen.logs.recorder import PathRecorder
from halfseen.scene.table import TABLE_TOP_M
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.state import TableState

PAUSE_S = 0.5
"""What a look and a decision take on the cell's clock [s]."""
NOTHING_SEEN = "nothing-seen"
"""Cause of a cut: no object is in view, so that there is nothing to decide."""
_TOPPLED_COSINE = 0.5
_ON_TABLE_M = 0.05  # a cup's origin is not lower than this below the top of the table it stands on


@dataclass
class Run:
    """What came of one table, by the truth.

    Attributes
    ----------
    reward
        Sum of the rewards [-].
    luck
        Part of it that was the luck of which cups were dirty (`luck`) [-].
    seconds
        On the cell's clock [s].
    verbs, failures
        How often each verb was tried; and why attempts did not hold.
    num_cups, num_racked, num_toppled, num_fallen
        Cups; those in the rack; those left on the table that stood and lie now; those that are neither on the table
        nor in the rack.
    num_dirty, num_washed
        Dirty cups, and those of them in the rack.
    cause
        What cut it; None where it came to its own end.
    """

    reward: float = 0.0
    luck: float = 0.0
    seconds: float = 0.0
    verbs: dict[str, int] = field(default_factory=dict)
    failures: dict[str, int] = field(default_factory=dict)
    num_cups: int = 0
    num_racked: int = 0
    num_toppled: int = 0
    num_fallen: int = 0
    num_dirty: int = 0
    num_washed: int = 0
    cause: str | None = None

    @property
    def is_seen(self) -> bool:
        """Whether anything was decided; else it was cut before, and no log holds it."""
        return bool(self.verbs)


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
    key: Array
    """What the policy drew from."""
    arm: int = 0
    """Number of the robot that does it."""
    of_team: str | None = None
    """Which robot does what, where there are several."""


def play(
    cell: Workcell,
    is_dirty: Bool[np.ndarray, " N"],
    policy: Policy,
    belief: Belief,
    path: PathRecorder,
    key: Array,
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
    path
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
    run, truth, config = Run(), Truth(cell, is_dirty), belief.config
    begin_s = cell.cell.time_s
    try:
        for step in range(config.horizon):
            _look(cell)
            if not cell.memory.objects:
                raise StoppedError(NOTHING_SEEN)
            state, rows = state_of(cell.memory, belief, config.horizon - step), rows_of(cell.memory, belief)
            chances = _chances_of(rows)
            if step == 0:
                run.luck = luck_of_table(int(is_dirty.sum()), len(is_dirty), chances, config)
            if tells_truth:
                truth.add_to(rows, cell)
            drawn_from = jax.random.fold_in(key, step)
            verb, target = _decided(policy, state, rows, path, drawn_from)
            _count(run.verbs, verb.name)
            action = int(ActionSpace(state.num_objects).encode(int(verb), target))
            on_decision(Moment(step + 1, state, action, _in_words(verb, target, rows), drawn_from))
            reward = _acted(cell, truth, verb, target, chances, config, run)
            is_over = verb is Verb.FINISH or step + 1 == config.horizon or truth.is_cleared(cell)
            if is_over:
                reward += float(config.reward_dirty_left) * truth.num_dirty_left
            run.reward += reward
            path.complete_stage(reward, elapsed_s=cell.cell.time_s - begin_s)
            if is_over:
                break
        path.finish(elapsed_s=cell.cell.time_s - begin_s)
    except StoppedError as stopped:
        run.cause = str(stopped)
        path.cut(run.cause, elapsed_s=cell.cell.time_s - begin_s)
    run.seconds = cell.cell.time_s - begin_s
    return replace(run, **truth.counts(cell))


def _look(cell: Workcell) -> None:
    cell.cell.wait(PAUSE_S)
    cell.look()


def _decided(policy: Policy, state: TableState, rows: list, path: PathRecorder, key: Array) -> tuple[Verb, int]:
    """Decide, and write down what was seen and what is done."""
    decision = _decide(policy, state, key)
    actions, action = ActionSpace(state.num_objects), int(decision.action)
    verb, target = Verb(int(actions.verb(action))), int(actions.target(action))
    acted_on = None if verb is Verb.FINISH else target
    # A planner cannot say how likely it was to choose so.
    chance = None if jnp.isnan(decision.probability) else float(decision.probability)
    path.begin_stage(objects=rows, action=verb.name, object=acted_on, probability=chance)
    return verb, target


@jax.jit
def _decide(policy: Policy, state: TableState, key: Array):
    return policy.decide(state, key)


def _chances_of(rows: list[dict[str, Any]]) -> Rows:
    """P(DIRTY) of the objects of a stage."""
    return expit(np.array([row["log_odds"] for row in rows], dtype=float))


def _in_words(verb: Verb, target: int, rows: list[dict[str, Any]]) -> str:
    if verb is Verb.FINISH:
        return "FINISH: nothing is worth another step"
    chance = _chances_of(rows)[target]
    return f"{verb.name} object {target}: dirty with probability {chance:.2f}, {rows[target]['occlusion']:.0%} hidden"


def _acted(
    cell: Workcell, truth: "Truth", verb: Verb, target: int, chances: Rows, config: WorldConfig, run: Run
) -> float:
    """Do it, and say what it earned."""
    begin_s = cell.cell.time_s
    if verb is Verb.FINISH:
        cell.cell.wait(float(config.transport_s))
        return 0.0
    attempt: Attempt = cell.wash(target) if verb is Verb.WASH else cell.lift(target)
    if not attempt.is_held:
        _count(run.failures, attempt.reason.split(":")[0].split(";")[0])
    if verb is Verb.LIFT:
        return float(config.reward_lift_per_s) * (cell.cell.time_s - begin_s)
    washed = truth.newly_racked(cell)
    run.luck += luck_of_washing(washed, float(chances[target]), config)
    earned = [float(config.reward_wash_dirty if dirty else config.reward_wash_clean) for dirty in washed]
    return sum(earned) if earned else float(config.reward_wash_failed)


def _count(counts: dict[str, int], name: str) -> None:
    counts[name] = counts.get(name, 0) + 1


class Truth:
    """Which cups are dirty, and where they are: what no decision looks at.

    Parameters
    ----------
    cell
        Before anything happened.
    is_dirty
        Of each cup.
    """

    def __init__(self, cell: Workcell, is_dirty: Bool[np.ndarray, " N"]) -> None:
        self.is_dirty, self.is_racked = is_dirty, np.zeros(len(is_dirty), dtype=bool)
        self._stood = self._upright(cell) > _TOPPLED_COSINE

    @property
    def num_dirty_left(self) -> int:
        """Dirty cups that are not in the rack."""
        return int((self.is_dirty & ~self.is_racked).sum())

    def newly_racked(self, cell: Workcell, arm: int | None = None) -> list[bool]:
        """Of the cups that came into the rack since it was asked last, whether each is dirty.

        Parameters
        ----------
        cell
            The cell.
        arm
            Whose rack is looked at; None for all.
        """
        stations = cell.stations if arm is None else (cell.stations[arm],)
        places_m = self._places_m(cell)
        now = np.array([any(each.rack.holds(place) for each in stations) for place in places_m], dtype=bool)
        if arm is not None:
            now |= self.is_racked
        new = now & ~self.is_racked
        self.is_racked = now
        return self.is_dirty[new].tolist()

    def add_to(self, rows: list[dict[str, Any]], cell: Workcell) -> None:
        """Add the truth to the rows of a log: of each object that of the cup that is nearest to it."""
        places_m = self._places_m(cell)
        for row, known in zip(rows, cell.memory.objects, strict=True):
            row["is_dirty"] = bool(self.is_dirty[np.linalg.norm(places_m - known.middle_m, axis=1).argmin()])

    def is_cleared(self, cell: Workcell) -> bool:
        """Whether no cup is on the table."""
        return not self._on_table(cell).any()

    def counts(self, cell: Workcell) -> dict[str, int]:
        """Count cups, as `Run` has them."""
        self.newly_racked(cell)
        on_table = self._on_table(cell)
        marked = {
            "num_racked": self.is_racked,
            "num_toppled": on_table & self._stood & (self._upright(cell) < _TOPPLED_COSINE),
            "num_fallen": ~on_table & ~self.is_racked,
            "num_dirty": self.is_dirty,
            "num_washed": self.is_dirty & self.is_racked,
        }
        return {"num_cups": len(self.is_dirty), **{name: int(mask.sum()) for name, mask in marked.items()}}

    def _on_table(self, cell: Workcell) -> Bool[np.ndarray, " N"]:
        return (self._places_m(cell)[:, 2] > TABLE_TOP_M - _ON_TABLE_M) & ~self.is_racked

    def _places_m(self, cell: Workcell) -> Points:
        return np.array([cell.cell.cup(index).position_m for index in range(len(self.is_dirty))])

    def _upright(self, cell: Workcell) -> Float[np.ndarray, " N"]:
        return np.array([cell.cell.cup(index).rotation[2, 2] for index in range(len(self.is_dirty))])
