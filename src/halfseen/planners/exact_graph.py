"""A small table before K robots as a decision process, and all that may become of it as a graph.

Of the table, what must be known is a tally of looks and attempts (`exact_table`). Of each robot it is what it is at,
how far its object was hidden when it began, for how long it has been at it, and which of the ways in which its attempt
may end are still open: it has not ended yet, and at the last look the object was in the air, or it was not. (That look
tells labels of what is held up and of what it no longer hides, so anyone who knows the labels knows that.)

While one robot alone is in motion, nothing else happens, and of how long an attempt takes only the mean counts. Several
need a law of grasping whose times lie on a grid (`grid_grasping`), so that they may be held against one another.

A node of the graph holds all states that differ in their labels alone: its values lie on the grid of their labels. The
layers of the graph are the nodes in which a robot decides, by the number of decisions that were made before.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, reduce
from itertools import product
from math import prod
from typing import NamedTuple, TypeAlias

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.planners.exact_table import (
    NOTHING,
    Counts,
    Grid,
    GridWorld,
    Held,
    Look,
    Looks,
    Tally,
    expected_over_labels,
)
from halfseen.planners.grid_grasping import GridGrasping
from halfseen.world.actions import FINISH, WAIT, ActionSpace, Verb, wait_of
from halfseen.world.config import WorldConfig
from halfseen.world.state import Workspace

FREE, PARKED = -1, -2
"""Verbs of a robot that is at nothing."""
_LEAVING = (PARKED, int(Verb.FINISH))
_DIGITS = 6
_MAX_CACHED = 8192


class End(NamedTuple):
    """One way in which an attempt of one of several robots may end."""

    is_held: bool
    duration_s: float
    """From begin to end [s]."""
    share: float
    """Of this duration, given whether it is held."""


class Doing(NamedTuple):
    """What one robot is at."""

    verb: int = FREE
    target: int = 0
    level: int = 0
    """Index of the occlusion that its object had as it began."""
    since_s: float = 0.0
    ends: tuple[End, ...] = ()
    """Ways in which it may still end by itself."""


IDLE = Doing()


class Work(NamedTuple):
    """What all robots are at, robot 0 first."""

    doings: tuple[Doing, ...]
    to_go: tuple[int, ...]
    """Decisions that each may still make."""

    @property
    def decider(self) -> int | None:
        """The robot that decides: of those that are free, the lowest; None where none is."""
        for robot, (doing, to_go) in enumerate(zip(*self, strict=True)):
            if doing.verb == FREE and to_go > 0:
                return robot
        return None

    @property
    def is_watched(self) -> bool:
        """Whether anybody is still to decide, who does not leave."""
        return any(to_go and doing.verb not in _LEAVING for doing, to_go in zip(*self, strict=True))

    @property
    def is_done(self) -> bool:
        """Whether no robot will do anything more."""
        return not any(doing.verb >= 0 or (doing.verb == FREE and to_go) for doing, to_go in zip(*self, strict=True))


class Ending(NamedTuple):
    """One way in which what a robot is at may end, as long as its object is as it is."""

    end: End
    probability: float
    left_s: float
    """Time until then [s]."""
    paid: float
    """Without what it pays to have washed an object; the price of the seconds included."""


class Outcome(NamedTuple):
    """One way in which the first thing that ends may end."""

    probability: float
    reward: Grid | float
    """On the grid before the look, the price of the seconds until then included."""
    tally: Tally
    work: Work
    held: Held | None
    """What is in the air at the look that follows; None where nobody decides any more, and it tells nothing of use."""


class Meanwhile(NamedTuple):
    """What may be known of a robot once another is done."""

    probability: float
    doing: Doing
    held: Held = NOTHING
    """What it holds up in the air."""


@dataclass(frozen=True, eq=False)
class Team:
    """What robots may do at one table, and what may come of it.

    Parameters
    ----------
    world
        The table, and the numbers of its robots.
    workspace
        Who reaches what; None for one robot that reaches everything.

    Raises
    ------
    ArgumentError
        Robots have laws of their own, or may drop out; or there are several, and their law of grasping is none on a
        grid.
    """

    world: GridWorld
    workspace: Workspace | None

    def __post_init__(self) -> None:
        law = self.config.grasping
        if self.workspace is not None and self.config.has_own_laws:
            raise ArgumentError("robots have laws of grasping of their own; a team is solved whose robots have one law")
        if not self.is_alone and not isinstance(law, GridGrasping):
            raise ArgumentError(
                f"grasping is {type(law).__name__}, whose attempts may take any time; a team is solved under "
                "GridGrasping"
            )
        if self.workspace is not None and self.config.drop_out_rate is not None:
            raise ArgumentError("drop_out_rate is given; a team is solved whose robots do not drop out")

    @property
    def config(self) -> WorldConfig:
        """Of `world`."""
        return self.world.config

    @cached_property
    def is_alone(self) -> bool:
        """Whether nobody else is ever in motion."""
        return self.config.num_robots == 1

    @cached_property
    def _transport_s(self) -> list[float]:
        return [round(float(self.config.transport_s) / float(speed), _DIGITS) for speed in self.config.speed]

    @cached_property
    def _leaving(self) -> list[Doing]:
        return [Doing(Verb.FINISH, ends=(End(False, seconds, 1.0),)) for seconds in self._transport_s]

    @cached_property
    def _ends(self) -> list[tuple[End, ...]]:
        """Ways in which an attempt of each robot may end; of one alone, only that it holds or not matters."""
        law, transport_s = self.config.grasping, float(self.config.transport_s)
        if not isinstance(law, GridGrasping) or self.is_alone:
            return [(End(False, np.nan, 1.0), End(True, np.nan, 1.0))]
        times = [(True, time, share) for time, share in zip(law.held_s, law.held_share, strict=True)]
        return [
            tuple(
                End(is_held, round((transport_s + float(time)) / float(speed), _DIGITS), float(share))
                for is_held, time, share in ((False, law.limit_s, 1.0), *times)
            )
            for speed in self.config.speed
        ]

    @cached_property
    def _actions(self) -> list[list[tuple[Verb, int]]]:
        """Verbs of an attempt on each object, and the action."""
        space = ActionSpace(self.world.num_objects)
        verbs = (Verb.LIFT, Verb.WASH)
        return [[(verb, int(space.encode(int(verb), cup))) for verb in verbs] for cup in range(space.num_objects)]

    def decisions(self, tally: Tally, work: Work) -> Iterator[tuple[int, Work]]:
        """Go through what the robot that decides may begin, as `possible_actions` has it; and what all are at then."""
        robot, levels = work.decider, self.world.levels(tally)
        assert robot is not None, "somebody is free"
        before, behind = work.doings[:robot], work.doings[robot + 1 :]
        to_go = (*work.to_go[:robot], work.to_go[robot] - 1, *work.to_go[robot + 1 :])
        yield FINISH, Work((*before, self._leaving[robot], *behind), to_go)
        at = [doing.target for doing in work.doings if doing.verb in (Verb.WASH, Verb.LIFT)]
        for cup, counted in enumerate(tally):
            if counted is not None and self._is_free(robot, cup, at):
                for verb, action in self._actions[cup]:
                    doing = Doing(verb, cup, levels[cup], 0.0, self._ends[robot])
                    yield action, Work((*before, doing, *behind), to_go)
        if any(doing.ends for doing in work.doings):
            yield wait_of(len(tally)), Work((*before, Doing(WAIT), *behind), to_go)

    def _is_free(self, robot: int, cup: int, at: list[int]) -> bool:
        if self.workspace is None:
            return True
        is_near = self.workspace.is_near
        return bool(self.workspace.is_in_reach[robot, cup]) and not any(is_near[target, cup] for target in at)

    def outcomes(self, tally: Tally, work: Work) -> Iterator[Outcome]:
        """Go through all that may happen next, while no robot is free."""
        is_watched = work.is_watched
        for robot, doing in enumerate(work.doings):
            for ending in self._endings(robot, doing, tally):
                reward, after, done, held = self._ended(tally, doing, ending)
                others = [
                    self._meanwhile(tally, r, other, robot, ending.left_s, is_watched)
                    for r, other in enumerate(work.doings)
                    if r != robot
                ]
                for known in product(*others):
                    probability, in_the_air = ending.probability, held
                    for each in known:
                        probability, in_the_air = probability * each.probability, in_the_air | each.held
                    doings = [each.doing for each in known]
                    doings.insert(robot, done)
                    then = Work(tuple(doings), work.to_go)
                    yield Outcome(probability, reward, after, then, in_the_air if is_watched else None)

    def _endings(self, robot: int, doing: Doing, tally: Tally) -> list[Ending]:
        """Ways in which what a robot is at may end by itself."""
        counted = tally[doing.target]
        if doing.verb in (Verb.WASH, Verb.LIFT):
            assert counted is not None, "nobody takes what another is at"
            return self._endings_of_attempt(robot, doing, counted.failures, counted.successes)
        price = float(self.config.reward_per_s)
        left_s = [_left_s(doing, end.duration_s) for end in doing.ends]
        return [Ending(end, 1.0, left, price * left) for end, left in zip(doing.ends, left_s, strict=True)]

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019 bounded, and the entries are small
    def _endings_of_attempt(self, robot: int, doing: Doing, failures: Counts, successes: Counts) -> list[Ending]:
        config, is_lift = self.config, doing.verb == Verb.LIFT
        held, mean_s = self.world.attempt(doing.target, failures, successes, doing.level)
        mean_s /= float(config.speed[robot])
        weights = [end.share * (held if end.is_held else 1.0 - held) for end in doing.ends]
        endings = []
        for end, weight in zip(doing.ends, weights, strict=True):
            duration_s = mean_s if self.is_alone else end.duration_s
            left_s = _left_s(doing, duration_s)
            of_wash = 0.0 if end.is_held else float(config.reward_wash_failed)
            paid = float(config.reward_lift_per_s) * duration_s if is_lift else of_wash
            endings.append(Ending(end, weight / sum(weights), left_s, paid + float(config.reward_per_s) * left_s))
        return endings

    def _ended(self, tally: Tally, doing: Doing, ending: Ending) -> tuple[Grid | float, Tally, Doing, Held]:
        """What comes of what a robot was at: what it pays, the tally, what the robot is at then, and what it holds."""
        verb, target, counted = doing.verb, doing.target, tally[doing.target]
        if verb == Verb.FINISH:
            return ending.paid, tally, Doing(PARKED), NOTHING
        assert counted is not None, "nobody takes what another is at"
        is_held, paid, after = ending.end.is_held, ending.paid, None
        if is_held and verb == Verb.WASH:
            paid = paid + self.world.washed(target, counted.looks)
        else:
            after = self.world.tried(counted, doing.level, is_held)
        held = frozenset([target]) if is_held and verb == Verb.LIFT else NOTHING
        return paid, (*tally[:target], after, *tally[target + 1 :]), IDLE, held

    def _meanwhile(
        self, tally: Tally, robot: int, doing: Doing, ended: int, passed_s: float, is_watched: bool
    ) -> list[Meanwhile]:
        """What may be known of a robot when another is done first."""
        if not doing.ends:
            return [Meanwhile(1.0, IDLE if doing.verb == WAIT else doing)]
        open_ends: dict[bool, list[Ending]] = {}
        for each in self._endings(robot, doing, tally):
            rest_s = each.left_s - passed_s
            # Of two things that end at once, that of the lower robot ends first.
            if rest_s > 0.0 or (rest_s == 0.0 and robot > ended):
                is_up = is_watched and each.end.is_held and rest_s <= self._transport_s[robot]
                open_ends.setdefault(is_up, []).append(each)
        since_s = round(doing.since_s + passed_s, _DIGITS)
        return [
            Meanwhile(
                sum(each.probability for each in still),
                doing._replace(since_s=since_s, ends=tuple(each.end for each in still)),
                frozenset([doing.target]) if is_up else NOTHING,
            )
            for is_up, still in open_ends.items()
        ]


def _left_s(doing: Doing, duration_s: float) -> float:
    return round(duration_s - doing.since_s, _DIGITS) if doing.since_s else duration_s


GO_ON = -1
"""What is chosen where no robot is to decide."""


@dataclass(eq=False, slots=True)
class Arrival:
    """What the camera sees next, and where that leads."""

    looks: tuple[Look | None, ...]
    """What the look does to each axis of the grid."""
    node: "Node | None"
    """None where the trajectory is over."""
    left: tuple[Looks | None, ...] = ()
    """What was kept then of the looks at each object that is left."""


class Choice(NamedTuple):
    """What may come of an action."""

    reward: Grid | float
    """Expected until the next node, but for the price of what is left at the end."""
    ways: dict[Arrival, float]
    """What may come next, and how likely that is."""


@dataclass(eq=False, slots=True)
class Node:
    """All states that differ in their labels alone."""

    tally: Tally
    work: Work
    shape: tuple[int, ...]
    """Of its grid."""
    place: int | None
    """In its layer; None where no robot is to decide."""
    choices: dict[int, Choice] = field(default_factory=dict)
    """By action; the only one is `GO_ON` where no robot is to decide."""
    value: Grid | None = None
    """Of the best that can be done from here on, once it was asked for."""


Key: TypeAlias = tuple[Tally, Work]


@dataclass(eq=False)
class Graph:
    """What may become of a table: each node once, layer by layer.

    Raises
    ------
    ArgumentError
        The states are more than `max_states`.
    """

    team: Team
    max_states: int
    num_states: int = 0
    root: Arrival = field(init=False)
    """The first look."""
    layers: list[dict[Key, Node]] = field(default_factory=list)

    def __post_init__(self) -> None:
        config = self.team.config
        self._begin_layer()
        work = Work((IDLE,) * config.num_robots, (config.horizon,) * config.num_robots)
        self.root = self._arrival(self.world.first, work, NOTHING)
        for _ in range(config.num_stages - 1):
            self.layers.append(self._following)
            self._begin_layer()
            for node in self.layers[-1].values():
                node.choices = self.choices(node)
        self.layers.append(self._following)
        self._begin_layer()

    @property
    def world(self) -> GridWorld:
        """The table."""
        return self.team.world

    def _begin_layer(self) -> None:
        self._following: dict[Key, Node] = {}
        self._between: dict[Key, Node] = {}
        self._arrivals: dict[tuple[Tally, Work, Held | None], Arrival] = {}
        self._ends: dict[tuple[Looks | None, ...], Arrival] = {}

    def choices(self, node: Node) -> dict[int, Choice]:
        """What may be done; it is not kept where it leads to no decision any more, as that is most of what there is."""
        if node.choices:
            return node.choices
        if node.place is None:
            return {GO_ON: self._outcome(node.tally, node.work)}
        return {action: self._choice(node.tally, work) for action, work in self.team.decisions(node.tally, node.work)}

    def _choice(self, tally: Tally, work: Work) -> Choice:
        """What may come of it; of one robot alone that is the next decision, and nobody needs a node between."""
        if self.team.is_alone:
            return self._outcome(tally, work)
        return Choice(0.0, {self._arrival(tally, work, None): 1.0})

    def _outcome(self, tally: Tally, work: Work) -> Choice:
        reward: Grid | float = 0.0
        ways: dict[Arrival, float] = {}
        for probability, paid, after, then, held in self.team.outcomes(tally, work):
            reward = reward + probability * paid
            arrival = self._arrival(after, then, held)
            ways[arrival] = ways.get(arrival, 0.0) + probability
        return Choice(reward, ways)

    def _arrival(self, tally: Tally, work: Work, held: Held | None) -> Arrival:
        """Where a look leads, or none if nothing is `held` for it."""
        if not any(tally) or (held is None and (self.team.is_alone or work.is_done)):
            left = tuple([counted and counted.looks for counted in tally])
            found = self._ends.get(left)
            if found is None:
                found = self._ends[left] = Arrival((), None, left)
            return found
        key = tally, work, held
        found = self._arrivals.get(key)
        if found is None:
            after, looks = (tally, ()) if held is None else self.world.looked(tally, held)
            found = self._arrivals[key] = Arrival(looks, self._node(after, work))
        return found

    def _node(self, tally: Tally, work: Work) -> Node:
        is_asked = work.decider is not None
        known = self._following if is_asked else self._between
        node = known.get((tally, work))
        if node is None:
            shape = self.world.shape(tally)
            node = known[tally, work] = Node(tally, work, shape, len(self._following) if is_asked else None)
            self._count(prod(shape))
            if not is_asked:
                node.choices = self.choices(node)
        return node

    def _count(self, num_cells: int) -> None:
        self.num_states += num_cells
        if self.num_states > self.max_states:
            config, num_done = self.team.config, len(self.layers)
            raise ArgumentError(
                f"{self.world.num_objects} objects over {config.num_stages} steps have more than {self.max_states:,} "
                f"states (so many after {num_done} of them); shorten the horizon or take fewer objects"
            )

    def q(self, node: Node) -> dict[int, Grid]:
        """Q(n, a) = R(n, a) + Σ P(event | n, a) E_labels V(n') of each possible action."""
        choices = self.choices(node)
        # A WASH and a LIFT that fail lead to the same.
        arrivals = dict.fromkeys(arrival for choice in choices.values() for arrival in choice.ways)
        worth = {arrival: self.worth(arrival) for arrival in arrivals}
        return {action: self._q(choice, worth) for action, choice in choices.items()}

    def _q(self, choice: Choice, worth: dict[Arrival, Grid]) -> Grid:
        total = np.asarray(choice.reward)
        for arrival, probability in choice.ways.items():
            total = total + probability * worth[arrival]
        return total

    def value(self, node: Node) -> Grid:
        """V(n) = max_a Q(n, a)."""
        if node.value is None:
            best = reduce(np.maximum, self.q(node).values())
            node.value = best if best.shape == node.shape else np.broadcast_to(best, node.shape)
        return node.value

    def worth(self, arrival: Arrival) -> Grid:
        """Value before a look."""
        if arrival.node is None:
            return self.world.price_of_left(arrival.left)
        return expected_over_labels(self.value(arrival.node), arrival.looks)
