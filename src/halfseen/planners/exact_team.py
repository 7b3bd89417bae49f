"""The actions of K robots at a small table, and their possible outcomes.

The state of a robot is its action, the occlusion of its object when it began, its elapsed time, and the endings of its
attempt that are still possible: it has not ended yet, and at the last look the object was in the air or not. (This is
observed, as that look gives labels of held objects and of the objects that they no longer hide.)

With a single robot, no other event intervenes, so only the mean duration of an attempt matters. Several robots need a
law of grasping with durations on a grid (`GridGrasping`), so that events can be ordered in time.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.planners.exact_labels import Grid
from halfseen.planners.exact_table import NOTHING, Counts, GridGrasping, GridWorld, Held, Tally
from halfseen.world.actions import FINISH, WAIT, ActionSpace, Verb, wait_of
from halfseen.world.config import WorldConfig
from halfseen.world.state import Workspace

FREE, PARKED = -1, -2
"""Verbs of an idle robot."""
_LEAVING = (PARKED, int(Verb.FINISH))
_DIGITS = 6
_MAX_CACHED = 8192


class AttemptEnd(NamedTuple):
    """One possible ending of an attempt of a robot in a team."""

    is_held: bool
    duration_s: float
    """Total duration [s]."""
    share: float
    """Probability of this duration, given `is_held`."""


class Doing(NamedTuple):
    """What one robot is doing."""

    verb: int = FREE
    target: int = 0
    level: int = 0
    """Index of the occlusion of its object when it began."""
    since_s: float = 0.0
    ends: tuple[AttemptEnd, ...] = ()
    """Endings that are still possible; none if it does not end by itself."""


IDLE = Doing()


class Work(NamedTuple):
    """What all robots are doing, robot 0 first."""

    doings: tuple[Doing, ...]
    to_go: tuple[int, ...]
    """Decisions that each may still make."""

    @property
    def decider(self) -> int | None:
        """The deciding robot: the lowest-numbered free robot; None if none is free."""
        for robot, (doing, to_go) in enumerate(zip(*self, strict=True)):
            if doing.verb == FREE and to_go > 0:
                return robot
        return None

    @property
    def is_watched(self) -> bool:
        """Whether any robot that is not leaving still has a decision to make."""
        return any(to_go and doing.verb not in _LEAVING for doing, to_go in zip(*self, strict=True))

    @property
    def is_done(self) -> bool:
        """Whether all robots are done for good."""
        return not any(doing.verb >= 0 or (doing.verb == FREE and to_go) for doing, to_go in zip(*self, strict=True))


class ActionEnding(NamedTuple):
    """One possible ending of a robot's action, given the statistics of its object."""

    end: AttemptEnd
    probability: float
    left_s: float
    """Time until then [s]."""
    paid: float
    """Reward with the price of the seconds, but without that of having washed an object."""


class NextEvent(NamedTuple):
    """One possible next event."""

    probability: float
    reward: Grid | float
    """On the grid before the look, with the price of the seconds until then."""
    tally: Tally
    work: Work
    held: Held | None
    """Objects in the air at the look that follows; None if no decision follows, so that the look is irrelevant."""


class Meanwhile(NamedTuple):
    """One possible state of a robot when another is done."""

    probability: float
    doing: Doing
    held: Held = NOTHING


@dataclass(frozen=True, eq=False)
class TeamActions:
    """The actions of robots at one table, and their possible outcomes.

    `workspace` is None for one robot that reaches everything.

    Raises
    ------
    ArgumentError
        Robots have their own laws or may drop out; or there are several, and their law of grasping is not on a grid.
    """

    world: GridWorld
    workspace: Workspace | None

    def __post_init__(self) -> None:
        law = self.config.grasping
        if self.workspace is not None and self.config.has_own_laws:
            raise ArgumentError(
                "each robot has its own law of grasping; an exact solution needs one law for all robots"
            )
        if not self.is_alone and not isinstance(law, GridGrasping):
            raise ArgumentError(
                f"grasping is {type(law).__name__}, whose attempts may take any time; solve a team under GridGrasping"
            )
        if self.workspace is not None and self.config.drop_out_rate is not None:
            raise ArgumentError("drop_out_rate is given; an exact solution needs robots that do not drop out")

    @property
    def config(self) -> WorldConfig:
        """Config of `world`."""
        return self.world.config

    @cached_property
    def is_alone(self) -> bool:
        """Whether there is only one robot."""
        return self.config.num_robots == 1

    @cached_property
    def _transport_s(self) -> list[float]:
        return [round(float(self.config.transport_s) / float(speed), _DIGITS) for speed in self.config.speed]

    @cached_property
    def _leaving(self) -> list[Doing]:
        return [Doing(Verb.FINISH, ends=(AttemptEnd(False, seconds, 1.0),)) for seconds in self._transport_s]

    @cached_property
    def _ends(self) -> list[tuple[AttemptEnd, ...]]:
        """Possible endings of an attempt of each robot; for a single robot, only success matters."""
        law, transport_s = self.config.grasping, float(self.config.transport_s)
        if not isinstance(law, GridGrasping) or self.is_alone:
            return [(AttemptEnd(False, np.nan, 1.0), AttemptEnd(True, np.nan, 1.0))]
        times = [(True, time, share) for time, share in zip(law.held_s, law.held_share, strict=True)]
        return [
            tuple(
                AttemptEnd(is_held, round((transport_s + float(time)) / float(speed), _DIGITS), float(share))
                for is_held, time, share in ((False, law.limit_s, 1.0), *times)
            )
            for speed in self.config.speed
        ]

    @cached_property
    def _actions(self) -> list[list[tuple[Verb, int]]]:
        """For each object, the verbs of an attempt with their action numbers."""
        space = ActionSpace(self.world.num_objects)
        verbs = (Verb.LIFT, Verb.WASH)
        return [[(verb, int(space.encode(int(verb), cup))) for verb in verbs] for cup in range(space.num_objects)]

    def decisions(self, tally: Tally, work: Work) -> Iterator[tuple[int, Work]]:
        """Iterate over the possible actions of the deciding robot, as in `possible_actions`, and the resulting work."""
        robot, levels = work.decider, self.world.levels(tally)
        assert robot is not None, "some robot is free"
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
        space = self.workspace
        return space is None or bool(space.is_in_reach[robot, cup] and not space.is_near[at, cup].any())

    def outcomes(self, tally: Tally, work: Work) -> Iterator[NextEvent]:
        """Iterate over the possible next events while no robot is free."""
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
                    yield NextEvent(probability, reward, after, then, in_the_air if is_watched else None)

    def _endings(self, robot: int, doing: Doing, tally: Tally) -> list[ActionEnding]:
        """Possible endings of a robot's action."""
        counted = tally[doing.target]
        if doing.verb in (Verb.WASH, Verb.LIFT):
            assert counted is not None, "no robot takes an object that another is acting on"
            return self._endings_of_attempt(robot, doing, counted.failures, counted.successes)
        price = float(self.config.reward_per_s)
        left_s = [_left_s(doing, end.duration_s) for end in doing.ends]
        return [ActionEnding(end, 1.0, left, price * left) for end, left in zip(doing.ends, left_s, strict=True)]

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019 bounded, and the entries are small
    def _endings_of_attempt(self, robot: int, doing: Doing, failures: Counts, successes: Counts) -> list[ActionEnding]:
        config, is_lift = self.config, doing.verb == Verb.LIFT
        held, mean_s = self.world.attempt(doing.target, failures, successes, doing.level)
        mean_s /= float(config.speed[robot])
        weights = [end.share * (held if end.is_held else 1.0 - held) for end in doing.ends]
        # Ends that the law rules out are never reached, but their values must be finite.
        weights = weights if any(weights) else [end.share for end in doing.ends]
        endings = []
        for end, weight in zip(doing.ends, weights, strict=True):
            duration_s = mean_s if self.is_alone else end.duration_s
            left_s = _left_s(doing, duration_s)
            of_wash = 0.0 if end.is_held else float(config.reward_wash_failed)
            paid = float(config.reward_lift_per_s) * duration_s if is_lift else of_wash
            endings.append(ActionEnding(end, weight / sum(weights), left_s, paid + float(config.reward_per_s) * left_s))
        return endings

    def _ended(self, tally: Tally, doing: Doing, ending: ActionEnding) -> tuple[Grid | float, Tally, Doing, Held]:
        """Result of a robot's ended action: reward, tally, next state of the robot, and the objects that it holds."""
        verb, target, counted = doing.verb, doing.target, tally[doing.target]
        if verb == Verb.FINISH:
            return ending.paid, tally, Doing(PARKED), NOTHING
        assert counted is not None, "no robot takes an object that another is acting on"
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
        """Possible states of a robot when another is done first."""
        if not doing.ends:
            return [Meanwhile(1.0, IDLE if doing.verb == WAIT else doing)]
        open_ends: dict[bool, list[ActionEnding]] = {}
        for each in self._endings(robot, doing, tally):
            rest_s = each.left_s - passed_s
            # If two actions end at the same time, that of the lower-numbered robot ends first.
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
