"""Rules of thumb: wash what promises most now, stop when nothing promises anything. They never lift to look.

`GreedyPolicy` is the rule of one robot. Of several, whatever a robot begins is reserved: nobody else touches it, nor
what is near it (`actions`). `ReservingPolicy` is as strong a plain rule as we know. `TeamOfRules` knows no price of
time, and `RoundRobin` and `OneAtATime` coordinate less; a team's policy is to beat them all.

Where the world that a rule believes in has a law of grasping for each robot (`TableWorld.played_config`), an attempt
is worth what it is by the law of the robot that decides, and a past attempt tells of a grip what the law of the robot
says that made it.
"""

from dataclasses import field, replace
from typing import ClassVar

import numpy as np

from halfseen.arrays import STATIC, Array, expit, library_of, record
from halfseen.errors import ArgumentError
from halfseen.planners.belief import expected_attempt_s, grasp_probability, grip_posterior, prior_grip
from halfseen.shapes import Float
from halfseen.world.actions import FINISH, ActionSpace, Verb, is_decider, of_robot, others_of, possible_actions, wait_of
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, GraspModel, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState, occlusion


@record
class TrueGrasp:
    """The true probability of a grasp, the hidden grip offset integrated out: a `GraspModel` that knows the world.

    Parameters
    ----------
    config
        The world.
    uses_history
        Whether the grip offset's distribution is the posterior given the object's past attempts, or the prior.
    """

    config: WorldConfig
    uses_history: bool = field(default=True, metadata=STATIC)

    def probability(self, state: TableState) -> Float[Array, "*B N"]:
        """P(an attempt succeeds) for each object."""
        grip = grip_posterior(self.config, state) if self.uses_history else prior_grip(state.grip)
        return grasp_probability(self.config, occlusion(state), grip)


@record
class GreedyPolicy:
    """WASH the object with the largest expected reward; FINISH when none is positive.

    Parameters
    ----------
    config
        The world that it believes in.
    uses_history
        Whether the probability of a grasp is updated by the object's past attempts, or is the prior's at its occlusion.
    counts_penalty
        Whether the FINISH penalty that a successful WASH avoids is counted; that makes the rule much stronger.
    grasp
        What tells the probability of a grasp in place of the true model; it needs `uses_history`.

    Raises
    ------
    ArgumentError
        `grasp` is given and `uses_history` is False.
    """

    config: WorldConfig
    uses_history: bool = field(default=False, metadata=STATIC)
    counts_penalty: bool | Array = False
    grasp: GraspModel | None = None

    num_robots: ClassVar[int] = 1

    def __post_init__(self) -> None:
        if self.grasp is not None and not self.uses_history:
            raise ArgumentError("grasp is given and uses_history is False; a grasp model looks at the history")

    def worth(self, state: TableState) -> Float[Array, "*B N"]:
        """Expected reward of an attempt to WASH each object; −∞ where it does not stand on the table."""
        grasp = TrueGrasp(self.config, self.uses_history) if self.grasp is None else self.grasp
        config, is_dirty, probability = self.config, expit(state.log_odds), grasp.probability(state)
        reward_dirty = config.reward_wash_dirty - self.counts_penalty * config.reward_dirty_left
        washed = is_dirty * reward_dirty + (1.0 - is_dirty) * config.reward_wash_clean
        worth = probability * washed + (1.0 - probability) * config.reward_wash_failed
        return library_of(worth).where(state.is_on_table, worth, np.float32(-np.inf))

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table; nothing is drawn."""
        worth = self.worth(state)
        xp = library_of(worth)
        wash = ActionSpace(state.num_objects).encode(Verb.WASH, xp.argmax(worth, axis=-1))
        return surely(xp.where(xp.max(worth, axis=-1) > 0.0, wash, FINISH))


@record
class _OfTeam:
    """A rule of a team that builds on the `rule` of thumb of one robot."""

    rule: GreedyPolicy


@record
class TeamOfRules(_OfTeam):
    """Every robot washes what promises most of what nobody else is at; it waits where that may change, or finishes.

    Parameters
    ----------
    rule
        The rule of thumb of one robot.
    """

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table; nothing is drawn."""
        gain = _worth(self.rule, state)
        return _chosen(state, gain, gain)


@record
class ReservingPolicy:
    """Every robot washes what gains more than its time costs, by preference what it alone reaches.

    A table's second is shared by the robots that go on: an attempt costs its expected seconds divided by their number.
    What others reach too, they may spare the robot: its own time for it counts against beginning with it, but not
    against doing it at all. A robot to which nothing is free that is worth it waits if something in another's hands or
    way is, and finishes otherwise.

    Parameters
    ----------
    config
        The team that it believes in, with the price of time.
    rule
        The rule of thumb of one robot, which tells what an attempt is worth.
    """

    config: WorldConfig
    rule: GreedyPolicy

    @property
    def num_robots(self) -> int:
        """K."""
        return self.config.num_robots

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table; nothing is drawn."""
        others, worth, world = others_of(state), _worth(self.rule, state), self.config.as_robot(state.decider)
        xp, grip = library_of(worth), prior_grip(state.grip)
        if self.rule.uses_history:
            grip = grip_posterior(world, state)
        speed = xp.asarray(self.config.speed, dtype=np.float32)[state.decider]
        # Of the time that it is expected to take for each object, if nobody shares it.
        price = -(self.config.reward_per_s * expected_attempt_s(world, occlusion(state), grip) / speed[..., None])
        gain = worth - price / (1 + xp.sum(others.goes_on, axis=-1)).astype(np.float32)[..., None]
        preferred = xp.where(others.reached, gain - price, gain)
        return _chosen(state, gain, preferred)


@record
class RoundRobin(_OfTeam):
    """Objects are dealt to the robots in turn: each clears its own as if alone, and nobody helps.

    Object i falls to the (i modulo their number)-th of the robots that reach it and go on.

    Parameters
    ----------
    rule
        The rule of thumb of one robot.
    """

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table; nothing is drawn."""
        assert state.workspace is not None
        xp = library_of(state.is_on_table)
        goes_on = is_decider(state) | others_of(state).goes_on
        reach = state.workspace.is_in_reach & goes_on[..., None]
        place = xp.arange(reach.shape[-1]) % xp.maximum(xp.sum(reach, axis=-2), 1)
        is_dealt = reach & (xp.cumsum(reach, axis=-2) - 1 == place[..., None, :])
        gain = xp.where(of_robot(is_dealt, state.decider), _worth(self.rule, state), np.float32(-np.inf))
        return _chosen(state, gain, gain)


@record
class OneAtATime(_OfTeam):
    """One robot works while the others wait: the lowest of those that go on, until nothing promises anything to it.

    It keeps its turn, as nobody can wait for who is not yet at work. Waiting costs decisions, so that a robot may have
    none left when its turn comes.

    Parameters
    ----------
    rule
        The rule of thumb of one robot.
    """

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table; nothing is drawn."""
        gain, wait = _worth(self.rule, state), wait_of(state.num_objects)
        of_turn = _chosen(state, gain, gain)
        return surely(library_of(gain).where(possible_actions(state)[..., wait], wait, of_turn.action))


def _worth(rule: GreedyPolicy, state: TableState) -> Float[Array, "*B N"]:
    """What an attempt at each object is worth by the robot that decides; −∞ where it does not reach it."""
    assert state.workspace is not None
    worth = replace(rule, config=rule.config.as_robot(state.decider)).worth(state)
    is_reached = of_robot(state.workspace.is_in_reach, state.decider)
    return library_of(worth).where(is_reached, worth, np.float32(-np.inf))


def _chosen(state: TableState, gain: Float[Array, "*B N"], preferred: Float[Array, "*B N"]) -> Decision:
    """WASH the preferred of what is free and gains; else WAIT where something gains that is not free; else FINISH."""
    xp, is_possible, actions = library_of(gain), possible_actions(state), ActionSpace(state.num_objects)
    wait = wait_of(state.num_objects)
    is_worth_it = is_possible[..., actions.of(Verb.WASH)] & (gain > 0.0)
    best = xp.argmax(xp.where(is_worth_it, preferred, np.float32(-np.inf)), axis=-1)
    otherwise = xp.where(is_possible[..., wait] & xp.any(gain > 0.0, axis=-1), wait, FINISH)
    return surely(xp.where(xp.any(is_worth_it, axis=-1), actions.encode(Verb.WASH, best), otherwise))
