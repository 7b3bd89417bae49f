"""The smallest honest model of a team: few objects, attempts whose durations lie on a grid, and what is known of them.

It is the team's world (`dynamics`) with everything hidden summed out: labels, results and durations have few values
each, so that what may come of an action can be listed with its probabilities. One thing is left out: an object hides,
and is hidden, as it stands until the attempt at it has ended, in transport too; and nobody drops out.

What all robots know (`Known`) is enough to decide from, and is the same for all of them. Objects are independent given
it. Of each that stands there: its log-odds of DIRTY, what has been seen of it, and its attempts. Of each robot: what it
is at, since when, and how hidden its object was then.
"""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from math import exp, log, prod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.planners.belief import known_seeing
from halfseen.team.actions import WAIT
from halfseen.team.config import TeamConfig
from halfseen.world.action_space import FINISH, ActionSpace, Verb
from halfseen.world.grasping import Arrangement, Attempt
from halfseen.world.number import Number, namespace
from halfseen.world.seeing import KnownSeeing

_DIGITS = 12


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GridGrasping:
    """An attempt holds with probability expit(a + b·occ + grip + u); its duration is one of a few, all alike.

    `world.fitted_grasping.FittedGrasping` with durations on a grid (a `KnownGrasping`).

    Parameters
    ----------
    log_odds, log_odds_per_occlusion
        a and b.
    offset_std
        Standard deviation of u, hidden of each object.
    held_s, missed_s
        Durations of an attempt that holds, and of one that misses, each equally likely [s].
    """

    log_odds: Number = 2.0
    log_odds_per_occlusion: Number = -3.0
    offset_std: Number = 0.0
    held_s: tuple[Number, ...] = (1.0, 2.0)
    missed_s: tuple[Number, ...] = (3.0,)

    @property
    def limit_s(self) -> Number:
        """Longest duration [s]."""
        return jnp.max(jnp.asarray([*self.held_s, *self.missed_s]))

    def draw_trait(self, num_objects: int, key: Array) -> Float[Array, " N"]:
        """Draw u of each object."""
        return self.offset_std * jax.random.normal(key, (num_objects,))

    def attempt(
        self, table: Arrangement, trait: Float[Array, " N"], verb: Int[Array, ""], target: Int[Array, ""], key: Array
    ) -> Attempt:
        """Draw whether it holds, and then how long it took."""
        held_key, time_key = jax.random.split(key)
        log_failure = self.log_failure(table.occlusion[target], table.grip[target] + trait[target])
        is_held = jnp.log(jax.random.uniform(held_key)) >= log_failure
        held_s, missed_s = (jax.random.choice(time_key, jnp.asarray(each)) for each in (self.held_s, self.missed_s))
        return Attempt(is_held, jnp.where(is_held, held_s, missed_s), table.hides, trait)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log P(an attempt misses | occ, offset)."""
        log_odds = self.log_odds + self.log_odds_per_occlusion * occluded + offset
        xp = namespace(log_odds)
        return -xp.logaddexp(0.0, log_odds)

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Mean duration over both results [s]."""
        log_failure = self.log_failure(occluded, offset)
        held_s, missed_s = (sum(each) / len(each) for each in (self.held_s, self.missed_s))
        return held_s + namespace(log_failure).exp(log_failure) * (missed_s - held_s)


class Cup(NamedTuple):
    """What is known of an object that stands on the table."""

    log_odds: float
    seen: float
    attempts: tuple[tuple[float, bool], ...]
    """Occlusion and result of each, in the order of their values."""


class Task(NamedTuple):
    """What a robot is at."""

    verb: int
    target: int
    occluded: float
    """Occlusion of its object when it began."""
    since_s: float
    is_past: bool
    """Whether it would have ended before, were it to end just now: a robot of a higher number did."""


class Known(NamedTuple):
    """What all robots know when one of them decides."""

    cups: tuple[Cup | None, ...]
    tasks: tuple[Task | None, ...]
    is_parked: tuple[bool, ...]
    to_go: tuple[int, ...]

    @property
    def free(self) -> list[int]:
        """Robots that may decide; the first of them does."""
        of_each = enumerate(zip(self.tasks, self.is_parked, self.to_go, strict=True))
        return [robot for robot, (task, is_parked, to_go) in of_each if task is None and not is_parked and to_go > 0]

    @property
    def there(self) -> list[int]:
        """Objects on the table."""
        return [cup for cup, known in enumerate(self.cups) if known is not None]

    @property
    def is_settled(self) -> bool:
        """Whether nobody will ever decide again."""
        return all(
            is_parked or to_go == 0 or (task is not None and task.verb == Verb.FINISH)
            for task, is_parked, to_go in zip(self.tasks, self.is_parked, self.to_go, strict=True)
        )

    @property
    def is_over(self) -> bool:
        """Whether nothing is left to do, or nobody to do it."""
        return not self.there or (not self.free and not any(self.tasks))


class Branch(NamedTuple):
    """One of the things that may come of an action."""

    probability: float
    reward: float
    """Expected, until then."""
    known: Known


@dataclass(frozen=True, eq=False)
class SmallTeam:
    """A team at one small table.

    Parameters
    ----------
    config
        The team; its law of grasping is `GridGrasping`, its law of seeing a `KnownSeeing`.
    hides
        Share of object i's silhouette that object j alone hides.
    is_in_reach, is_near
        As in `Workspace`.
    num_grip_nodes
        Grip offsets lie on this many Gauss–Hermite nodes.
    """

    config: TeamConfig
    hides: Float[np.ndarray, "N N"]
    is_in_reach: Bool[np.ndarray, "K N"]
    is_near: Bool[np.ndarray, "N N"]
    num_grip_nodes: int = 1

    def first(self) -> list[Branch]:
        """What may be known after the first look."""
        world, size = self.config.world, self.config.num_robots
        prior = log(float(world.dirty_share)) - log(1.0 - float(world.dirty_share))
        cups = (Cup(round(prior, _DIGITS), 0.0, ()),) * len(self.hides)
        known = Known(cups, (None,) * size, (False,) * size, (world.horizon,) * size)
        return [Branch(p, 0.0, seen) for p, seen in self._looks(known, None)]

    def possible(self, known: Known) -> list[int]:
        """Actions of the robot that decides, in their order."""
        decider, actions = known.free[0], self._actions
        at_work = [task for task in known.tasks if task is not None and task.verb != WAIT]
        taken = [task.target for task in at_work if task.verb != Verb.FINISH]
        objects = [cup for cup in known.there if self.is_in_reach[decider, cup] and not self.is_near[cup, taken].any()]
        found = [FINISH, *(int(actions.encode(verb, cup)) for verb in (Verb.WASH, Verb.LIFT) for cup in objects)]
        return found + [actions.num_actions] * bool(at_work)

    def branches(self, known: Known, action: int) -> list[Branch]:
        """What may come of an action until the next decision or the end; alike ends are one."""
        decider, actions = known.free[0], self._actions
        verb, target = int(actions.verb(action)), int(actions.target(action))
        occluded = self.occlusion(known, target) if verb in (Verb.WASH, Verb.LIFT) else 0.0
        known = known._replace(
            tasks=_with(known.tasks, decider, Task(verb, target, occluded, 0.0, False)),
            to_go=_with(known.to_go, decider, known.to_go[decider] - 1),
        )
        total: dict[Known, list[float]] = defaultdict(lambda: [0.0, 0.0])
        for probability, reward, after in self._until_decision(known):
            total[after][0] += probability
            total[after][1] += probability * reward
        return [Branch(p, paid / p, after) for after, (p, paid) in total.items()]

    def left_price(self, known: Known) -> float:
        """Expected price of what is dirty on the table."""
        return float(self.config.world.reward_dirty_left) * sum(self.dirty(known, cup) for cup in known.there)

    def dirty(self, known: Known, cup: int) -> float:
        """P(DIRTY) of an object on the table."""
        return 1.0 / (1.0 + exp(-_there(known, cup).log_odds))

    def occlusion(self, known: Known, cup: int, held: int | None = None) -> float:
        """Hidden share of an object; what is held hides nothing."""
        if cup == held:
            return 0.0
        return round(1.0 - prod(1.0 - float(self.hides[cup, j]) for j in known.there if j != held), _DIGITS)

    @cached_property
    def _actions(self) -> ActionSpace:
        return ActionSpace(len(self.hides))

    @cached_property
    def _world(self) -> Any:
        """Of plain numbers, in double precision."""
        return jax.tree.map(float, self.config.world)

    @cached_property
    def _grasping(self) -> GridGrasping:
        return self._world.grasping

    @cached_property
    def _seeing(self) -> KnownSeeing:
        return known_seeing(self._world)

    @cached_property
    def _grip_nodes(self) -> list[tuple[float, float]]:
        nodes, weights = np.polynomial.hermite_e.hermegauss(self.num_grip_nodes)
        weights = weights / weights.sum()
        return [(float(u * self._grasping.offset_std), float(p)) for u, p in zip(nodes, weights, strict=True)]

    def _until_decision(self, known: Known) -> list[Branch]:
        if known.is_over:
            return [Branch(1.0, self.left_price(known), known)]
        if known.free:
            return [Branch(1.0, 0.0, known)]
        return [
            Branch(p * later.probability, reward + later.reward, later.known)
            for p, reward, after in self._next_event(known)
            for later in self._until_decision(after)
        ]

    def _next_event(self, known: Known) -> list[Branch]:
        """Each way in which the first thing that ends may end, and what is then seen."""
        at_work = [robot for robot, task in enumerate(known.tasks) if task is not None and task.verb != WAIT]
        found: dict[tuple[int, float, bool], float] = defaultdict(float)
        for ends in product(*(self._ends(known, robot) for robot in at_work)):
            first = min(range(len(at_work)), key=lambda k, ends=ends: (ends[k][1], at_work[k]))
            found[(at_work[first], *ends[first][1:])] += prod(p for p, _, _ in ends)
        return [
            Branch(p * p_seen, reward, seen)
            for (robot, passed_s, is_held), p in found.items()
            for reward, after, held in [self._ended(known, robot, passed_s, is_held)]
            for p_seen, seen in self._looks(after, held)
        ]

    def _ends(self, known: Known, robot: int) -> tuple[tuple[float, float, bool], ...]:
        """(Probability, seconds to go, held) of each end of what a robot is at, given that it is still at it."""
        task = known.tasks[robot]
        assert task is not None
        speed = float(self.config.speed[robot])
        if task.verb == Verb.FINISH:
            return ((1.0, round(self._world.transport_s / speed - task.since_s, _DIGITS), False),)
        return self._ends_of(_there(known, task.target).attempts, task, speed)

    @lru_cache(maxsize=65536)  # noqa: B019 bounded, and the entries are small
    def _ends_of(
        self, attempts: tuple[tuple[float, bool], ...], task: Task, speed: float
    ) -> tuple[tuple[float, float, bool], ...]:
        holds = self.holds(attempts, task.occluded)
        ends = []
        for is_held, chance, durations in (
            (True, holds, self._grasping.held_s),
            (False, 1.0 - holds, self._grasping.missed_s),
        ):
            for duration_s in durations:
                left_s = round((self._world.transport_s + duration_s) / speed - task.since_s, _DIGITS)
                if left_s > 0.0 or (left_s == 0.0 and not task.is_past):
                    ends.append((chance / len(durations), left_s, is_held))
        total = sum(p for p, _, _ in ends)
        return tuple((p / total, left_s, is_held) for p, left_s, is_held in ends if p > 0.0)

    def holds(self, attempts: tuple[tuple[float, bool], ...], occluded: float) -> float:
        """P(an attempt holds) given an object's past ones."""
        both, past = 0.0, 0.0
        for offset, weight in self._grip_nodes:
            for at, succeeded in attempts:
                missed = exp(float(self._grasping.log_failure(at, offset)))
                weight *= 1.0 - missed if succeeded else missed
            past += weight
            both += weight * (1.0 - exp(float(self._grasping.log_failure(occluded, offset))))
        return both / past

    def _ended(self, known: Known, robot: int, passed_s: float, is_held: bool) -> tuple[float, Known, int | None]:
        """What is paid, what is known before the look, and what is held up in it."""
        task, world = known.tasks[robot], self._world
        assert task is not None
        reward, cups = float(self.config.reward_per_s) * passed_s, known.cups
        if task.verb != Verb.FINISH:
            cup = _there(known, task.target)
            tried = cup._replace(attempts=tuple(sorted((*cup.attempts, (task.occluded, is_held)))))
            is_gone = is_held and task.verb == Verb.WASH
            cups = _with(cups, task.target, None if is_gone else tried)
        if task.verb == Verb.LIFT:
            reward += world.reward_lift_per_s * (task.since_s + passed_s)
        elif task.verb == Verb.WASH:
            dirty = self.dirty(known, task.target)
            washed = dirty * world.reward_wash_dirty + (1.0 - dirty) * world.reward_wash_clean
            reward += washed if is_held else world.reward_wash_failed
        tasks = tuple(
            None
            if other == robot or of_other is None or of_other.verb == WAIT
            else of_other._replace(
                since_s=round(of_other.since_s + passed_s, _DIGITS),
                is_past=other < robot or (of_other.is_past and passed_s == 0.0),
            )
            for other, of_other in enumerate(known.tasks)
        )
        is_parked = _with(known.is_parked, robot, task.verb == Verb.FINISH)
        held = task.target if is_held and task.verb == Verb.LIFT else None
        return reward, known._replace(cups=cups, tasks=tasks, is_parked=is_parked), held

    def _looks(self, known: Known, held: int | None) -> list[tuple[float, Known]]:
        """(Probability, what is known) of everything that a look at all objects may say."""
        if known.is_settled:
            # What labels say is of no use any more, and by the law of total expectation changes no expected reward.
            return [(1.0, known)]
        told = []
        for cup, of_cup in enumerate(known.cups):
            if of_cup is None:
                told.append([(1.0, None)])
            else:
                told.append(self._labels(of_cup, self.occlusion(known, cup, held), cup == held))
        return [
            (prod(p for p, _ in each), known._replace(cups=tuple(cup for _, cup in each))) for each in product(*told)
        ]

    @lru_cache(maxsize=65536)  # noqa: B019
    def _labels(self, cup: Cup, occluded: float, is_held: bool) -> list[tuple[float, Cup]]:
        if_dirty, if_clean = (float(p) for p in self._seeing.positive(occluded, cup.seen, is_held))
        if if_dirty + if_clean == 0.0:
            return [(1.0, cup)]
        dirty, said = 1.0 / (1.0 + exp(-cup.log_odds)), []
        for says_dirty, on_dirty, on_clean in ((True, if_dirty, if_clean), (False, 1.0 - if_dirty, 1.0 - if_clean)):
            log_odds = round(cup.log_odds + log(on_dirty) - log(on_clean), _DIGITS)
            seen = round(float(self._seeing.after(occluded, cup.seen, says_dirty, is_held)), _DIGITS)
            said.append((dirty * on_dirty + (1.0 - dirty) * on_clean, cup._replace(log_odds=log_odds, seen=seen)))
        return said


def _there(known: Known, cup: int) -> Cup:
    found = known.cups[cup]
    assert found is not None, "only what stands on the table is asked for"
    return found


def _with(each: tuple[Any, ...], place: int, value: Any) -> tuple[Any, ...]:
    return (*each[:place], value, *each[place + 1 :])
