"""A small table before a team whose attempts take times on a grid, and all that must be known of a path to solve it.

Of the table that is what is known for one robot (`exact_model`): a tally of looks and attempts, and a grid
of labels. Of each robot it is what it is at, how far its object was hidden when it began, for how long it has
been at it, and which of the ways in which its attempt may end are still open: it has not ended yet, and at the last
look the object was in the air, or it was not. (That look tells labels of what is held up and of what it no
longer hides, so whoever knows the labels knows that.)

What may happen next to a team that is at work: who is done first, when, and what the camera sees then.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool

from halfseen.errors import ArgumentError
from halfseen.planners.exact_bellman import Grid, along
from halfseen.planners.exact_labels import Look
from halfseen.planners.exact_model import (
    NOTHING,
    GridWorld,
    Held,
    Result,
    Tally,
    after_attempt_at,
    after_look,
    current_levels,
    is_there,
    looks_of,
)
from halfseen.planners.grid_grasping import GridGrasping
from halfseen.world.actions import FINISH, WAIT, ActionSpace, Verb, wait_of
from halfseen.world.config import WorldConfig

FREE, PARKED = -1, -2
"""Verbs of a robot that is at nothing."""
_DIGITS = 6


class End(NamedTuple):
    """One way in which what a robot is at may end."""

    is_held: bool
    duration_s: float
    """From begin to end; infinite for WAIT [s]."""


class Doing(NamedTuple):
    """What one robot is at."""

    to_go: int
    """Decisions that it may still make."""
    verb: int = FREE
    target: int = 0
    level: int = 0
    """Index of the occlusion that its object had as it began."""
    since_s: float = 0.0
    ends: tuple[End, ...] = ()
    """Ways in which it may still end."""

    @property
    def is_undecided(self) -> bool:
        """Whether it is free to decide."""
        return self.verb == FREE and self.to_go > 0

    @property
    def is_done(self) -> bool:
        """Whether it will do nothing more."""
        return self.verb == PARKED or (self.verb == FREE and self.to_go == 0)

    @property
    def is_at_object(self) -> bool:
        """Whether it is at an object."""
        return self.verb in (Verb.WASH, Verb.LIFT)

    @property
    def is_at_work(self) -> bool:
        """Whether what it is at ends by itself."""
        return self.is_at_object or self.verb == Verb.FINISH


Doings: TypeAlias = tuple[Doing, ...]
"""What each robot is at, robot 0 first."""


class TeamNode(NamedTuple):
    """All states that differ in their labels alone."""

    tally: Tally
    doings: Doings

    @property
    def decider(self) -> int:
        """The robot that decides: of those that are free, the lowest."""
        return next(r for r, doing in enumerate(self.doings) if doing.is_undecided)

    @property
    def is_asked(self) -> bool:
        """Whether a robot is to decide."""
        return any(doing.is_undecided for doing in self.doings)

    @property
    def is_over(self) -> bool:
        """Whether all robots are done for good, or the table is clear."""
        return all(doing.is_done for doing in self.doings) or not is_there(self.tally)

    @property
    def num_decisions(self) -> int:
        """Decisions that may still be made; none counts of a robot that leaves."""
        return sum(doing.to_go for doing in self.doings if doing.verb not in (PARKED, Verb.FINISH))


@dataclass(frozen=True, eq=False)
class GridTeam:
    """A table of the world before a team, on grids.

    Parameters
    ----------
    world
        The table, and the numbers of its robots.
    is_in_reach, is_near
        As in `Workspace`.

    Raises
    ------
    ArgumentError
        The law of grasping is none on a grid, or not one for all robots, or robots may drop out.
    """

    world: GridWorld
    is_in_reach: Bool[np.ndarray, "K N"]
    is_near: Bool[np.ndarray, "N N"]

    def __post_init__(self) -> None:
        law = self.config.grasping
        if self.config.has_own_laws:
            raise ArgumentError("robots have laws of grasping of their own; a team is solved whose robots have one law")
        if not isinstance(law, GridGrasping):
            raise ArgumentError(
                f"grasping is {type(law).__name__}, whose attempts may take any time; a team is solved under "
                "GridGrasping"
            )
        if self.config.drop_out_rate is not None:
            raise ArgumentError("drop_out_rate is given; a team is solved whose robots do not drop out")

    @property
    def config(self) -> WorldConfig:
        """Of `world`."""
        return self.world.config

    @property
    def law(self) -> GridGrasping:
        """How attempts go."""
        law = self.config.grasping
        assert isinstance(law, GridGrasping), "no other is taken"
        return law

    @cached_property
    def transport_s(self) -> tuple[float, ...]:
        """Of each robot [s]."""
        return tuple(round(float(self.config.transport_s) / float(speed), _DIGITS) for speed in self.config.speed)

    @cached_property
    def _attempt_ends(self) -> tuple[tuple[End, ...], ...]:
        law, transport_s = self.law, float(self.config.transport_s)
        times = [*((True, float(time)) for time in law.held_s), (False, float(law.limit_s))]
        return tuple(
            tuple(End(is_held, round((transport_s + time) / float(speed), _DIGITS)) for is_held, time in times)
            for speed in self.config.speed
        )

    @cached_property
    def _share_of_end(self) -> tuple[dict[End, float], ...]:
        """Probability of each end, given whether it holds."""
        shares = [*map(float, self.law.held_share), 1.0]
        return tuple(dict(zip(ends, shares, strict=True)) for ends in self._attempt_ends)

    def shares(self, tally: Tally, robot: int, doing: Doing) -> list[float]:
        """Probability of each way in which a robot may still end what it is at."""
        if not doing.is_at_object:
            return [1.0]
        told = tally[doing.target]
        assert told is not None, "nobody takes what another is at"
        held, _ = self.world.attempt(doing.target, told.failures, told.successes, doing.level)
        of_end = self._share_of_end[robot]
        weights = [of_end[end] * (held if end.is_held else 1.0 - held) for end in doing.ends]
        return [weight / sum(weights) for weight in weights]

    def possible(self, node: TeamNode) -> list[int]:
        """Actions of the robot that decides, as `possible_actions` has them."""
        actions, decider = ActionSpace(self.world.num_objects), node.decider
        others = [doing for r, doing in enumerate(node.doings) if r != decider]
        at = [doing.target for doing in others if doing.is_at_object]
        free = [cup for cup in is_there(node.tally) if self.is_in_reach[decider, cup]]
        free = [cup for cup in free if not any(self.is_near[target, cup] for target in at)]
        attempts = [int(actions.encode(int(verb), cup)) for verb in (Verb.WASH, Verb.LIFT) for cup in free]
        waits = [wait_of(self.world.num_objects)] if any(doing.is_at_work for doing in others) else []
        return [FINISH, *attempts, *waits]

    def begun(self, node: TeamNode, action: int) -> TeamNode:
        """Let the robot that decides begin an action."""
        actions, robot = ActionSpace(self.world.num_objects), node.decider
        verb, target = int(actions.verb(action)), int(actions.target(action))
        to_go = node.doings[robot].to_go - 1
        if verb == WAIT:
            doing = Doing(to_go, verb, ends=(End(False, np.inf),))
        elif verb == Verb.FINISH:
            doing = Doing(to_go, verb, ends=(End(False, self.transport_s[robot]),))
        else:
            level = current_levels(self.world, node.tally)[target]
            doing = Doing(to_go, verb, target, level, ends=self._attempt_ends[robot])
        return node._replace(doings=(*node.doings[:robot], doing, *node.doings[robot + 1 :]))


def after_s(doing: Doing, passed_s: float, ends: tuple[End, ...]) -> Doing:
    """What a robot is at after some time, of which it is known how it may still end."""
    return doing._replace(since_s=round(doing.since_s + passed_s, _DIGITS), ends=ends)


def left_s(doing: Doing, end: End) -> float:
    """Time until an end [s]."""
    return round(end.duration_s - doing.since_s, _DIGITS)


class Event(NamedTuple):
    """One way in which the first thing that ends may end."""

    probability: float
    reward: Grid
    """On the grid before the look, the price of the seconds until then included."""
    looks: tuple[Look | None, ...] | None
    """What the look does to each axis; None where nobody decides any more, and looks tell nothing of use."""
    gone: int | None
    """Object that has left the table."""
    after: TeamNode


class _Known(NamedTuple):
    """What is known of a robot once another is done."""

    probability: float
    doing: Doing
    is_up: bool
    """Whether it holds its object in the air."""


def events_of(model: GridTeam, node: TeamNode) -> Iterator[Event]:
    """Go through all that may happen next, while no robot is free."""
    for robot, doing in enumerate(node.doings):
        if not doing.is_at_work:
            continue
        for end, share in zip(doing.ends, model.shares(node.tally, robot, doing), strict=True):
            passed_s = left_s(doing, end)
            others = [_known_of(model, node, other, robot, passed_s) for other in range(len(node.doings))]
            for joint in product(*others):
                probability = share * float(np.prod([known.probability for known in joint]))
                yield _event(model, node, robot, end, passed_s, joint)._replace(probability=probability)


def _known_of(model: GridTeam, node: TeamNode, robot: int, ended: int, passed_s: float) -> list[_Known]:
    """What may be known of a robot when another is done first."""
    doing = node.doings[robot]
    if robot == ended or not doing.is_at_work:
        return [_Known(1.0, doing, False)]
    told: dict[bool, list[tuple[End, float]]] = {}
    for end, share in zip(doing.ends, model.shares(node.tally, robot, doing), strict=True):
        rest_s = left_s(doing, end) - passed_s
        # Of two things that end at once, that of the lower robot ends first.
        if rest_s > 0.0 or (rest_s == 0.0 and robot > ended):
            is_up = node.num_decisions > 0 and end.is_held and rest_s <= model.transport_s[robot]
            told.setdefault(is_up, []).append((end, share))
    return [
        _Known(sum(share for _, share in ends), after_s(doing, passed_s, tuple(end for end, _ in ends)), is_up)
        for is_up, ends in told.items()
    ]


def _event(model: GridTeam, node: TeamNode, robot: int, end: End, passed_s: float, joint: tuple[_Known, ...]) -> Event:
    """What comes of it; its probability is left open."""
    doing = node.doings[robot]
    reward: Grid = np.full((1,) * len(node.tally), float(model.config.reward_per_s) * passed_s)
    tally, gone, held = node.tally, None, NOTHING
    if doing.is_at_object:
        result = Result.FAILED if not end.is_held else Result.WASHED if doing.verb == Verb.WASH else Result.LIFTED
        tally = after_attempt_at(node.tally, doing.target, result, doing.level)
        gone = doing.target if result is Result.WASHED else None
        held = frozenset([doing.target]) if result is Result.LIFTED else NOTHING
        reward = reward + _paid(model, node.tally, doing, end)
    after = TeamNode(tally, _freed(joint, robot))
    if after.is_over or node.num_decisions == 0:
        return Event(0.0, reward, None, gone, after)
    held = held | {known.doing.target for known in joint if known.is_up}
    return Event(0.0, reward, looks_of(model.world, tally, held), gone, _looked_at(model, after, held))


def _looked_at(model: GridTeam, node: TeamNode, held: Held) -> TeamNode:
    return node._replace(tally=after_look(model.world, node.tally, held))


def _freed(joint: tuple[_Known, ...], ended: int) -> Doings:
    """What robots are at once one is done, and with it all that waited."""
    return tuple(
        Doing(doing.to_go, PARKED if r == ended and doing.verb == Verb.FINISH else FREE)
        if r == ended or doing.verb == WAIT
        else doing
        for r, (_, doing, _) in enumerate(joint)
    )


def _paid(model: GridTeam, tally: Tally, doing: Doing, end: End) -> Grid | float:
    """What an attempt pays that ends so."""
    config, told = model.config, tally[doing.target]
    if doing.verb == Verb.LIFT:
        return float(config.reward_lift_per_s) * end.duration_s
    if not end.is_held:
        return float(config.reward_wash_failed)
    assert told is not None, "nobody takes what another is at"
    dirty = along(model.world.dirty(doing.target, told.looks), doing.target, len(tally))
    return dirty * float(config.reward_wash_dirty) + (1.0 - dirty) * float(config.reward_wash_clean)
