"""Rules of thumb: wash the most promising object now, and stop when none is worth it. They never LIFT.

`GreedyPolicy` is the rule for one robot. In a team, the target of a robot is reserved: no other robot may take it, nor
an object near it (`actions`). `ReservingPolicy` is the strongest simple rule that we know. `TeamOfRules` ignores the
price of time, and `RoundRobin` and `OneAtATime` coordinate less; a team's policy should beat them all.

If the model of a rule has a law of grasping for each robot (`TableWorld.played_config`), the value of an attempt
follows the law of the deciding robot, and the evidence of a past attempt that of the robot that made it.
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
from halfseen.world.policy import GraspModel, PolicyDraw, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState, occlusion


@record
class TrueGrasp:
    """A `GraspModel` with the world's true success probability, with the hidden grip offset integrated out.

    Parameters
    ----------
    config
        The world.
    uses_history
        Whether to use the posterior of the grip offset given the object's past attempts, or the prior.
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
        Its model of the world.
    uses_history
        Whether the success probability is updated by the object's past attempts, or is that of the prior.
    counts_penalty
        Whether to count the FINISH penalty that a successful WASH avoids; this makes the rule much stronger.
    grasp
        Grasp model that replaces the true one; it needs `uses_history`.

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
            raise ArgumentError("grasp is given but uses_history is False; a grasp model uses the history")

    def worth(self, state: TableState) -> Float[Array, "*B N"]:
        """Expected reward of an attempt to WASH each object; −∞ if it is not on the table."""
        grasp = TrueGrasp(self.config, self.uses_history) if self.grasp is None else self.grasp
        config, is_dirty, probability = self.config, expit(state.log_odds), grasp.probability(state)
        reward_dirty = config.reward_wash_dirty - self.counts_penalty * config.reward_dirty_left
        washed = is_dirty * reward_dirty + (1.0 - is_dirty) * config.reward_wash_clean
        worth = probability * washed + (1.0 - probability) * config.reward_wash_failed
        return library_of(worth).where(state.is_on_table, worth, np.float32(-np.inf))

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose for each table; deterministic."""
        worth = self.worth(state)
        xp = library_of(worth)
        wash = ActionSpace(state.num_objects).encode(Verb.WASH, xp.argmax(worth, axis=-1))
        return surely(xp.where(xp.max(worth, axis=-1) > 0.0, wash, FINISH))


@record
class _OfTeam:
    """A rule for a team, built on the `rule` of thumb for one robot."""

    rule: GreedyPolicy


@record
class TeamOfRules(_OfTeam):
    """Every robot washes its most promising free object; else it waits for a promising blocked one, or finishes.

    Parameters
    ----------
    rule
        The rule of thumb for one robot.
    """

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose for each table; deterministic."""
        gain = _worth(self.rule, state)
        return _chosen(state, gain, gain)


@record
class ReservingPolicy:
    """Every robot washes objects that gain more than their time costs, preferably those that only it reaches.

    Robots share the table's time: an attempt costs its expected seconds divided by the number of robots that go on. An
    object that others reach too may be left to them: its time counts against washing it first, but not against washing
    it at all. If no free object is worth it, a robot waits for a worthwhile object that another robot blocks, and
    finishes otherwise.

    Parameters
    ----------
    config
        Its model of the team, with the price of time.
    rule
        The rule of thumb for one robot, which values an attempt.
    """

    config: WorldConfig
    rule: GreedyPolicy

    @property
    def num_robots(self) -> int:
        """K."""
        return self.config.num_robots

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose for each table; deterministic."""
        others, worth, world = others_of(state), _worth(self.rule, state), self.config.as_robot(state.decider)
        xp, grip = library_of(worth), prior_grip(state.grip)
        if self.rule.uses_history:
            grip = grip_posterior(world, state)
        speed = xp.asarray(self.config.speed, dtype=np.float32)[state.decider]
        # Price of the expected time for each object, if no other robot shares it.
        price = -(self.config.reward_per_s * expected_attempt_s(world, occlusion(state), grip) / speed[..., None])
        gain = worth - price / (1 + xp.sum(others.goes_on, axis=-1)).astype(np.float32)[..., None]
        preferred = xp.where(others.reached, gain - price, gain)
        return _chosen(state, gain, preferred)


@record
class RoundRobin(_OfTeam):
    """Objects are dealt to the robots in turn: each clears its own as if alone, without help.

    Of the robots that reach object i and go on, the (i modulo their number)-th gets it.

    Parameters
    ----------
    rule
        The rule of thumb for one robot.
    """

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose for each table; deterministic."""
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
    """One robot works while the others wait: the lowest-numbered that goes on, until no object is worth it.

    It keeps its turn, because a robot can only wait for one that is at work. Waiting costs decisions, so a robot may
    have none left at its turn.

    Parameters
    ----------
    rule
        The rule of thumb for one robot.
    """

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose for each table; deterministic."""
        gain, wait = _worth(self.rule, state), wait_of(state.num_objects)
        of_turn = _chosen(state, gain, gain)
        return surely(library_of(gain).where(possible_actions(state)[..., wait], wait, of_turn.action))


def _worth(rule: GreedyPolicy, state: TableState) -> Float[Array, "*B N"]:
    """Expected reward of the deciding robot's attempt at each object; −∞ if out of its reach."""
    assert state.workspace is not None
    worth = replace(rule, config=rule.config.as_robot(state.decider)).worth(state)
    is_reached = of_robot(state.workspace.is_in_reach, state.decider)
    return library_of(worth).where(is_reached, worth, np.float32(-np.inf))


def _chosen(state: TableState, gain: Float[Array, "*B N"], preferred: Float[Array, "*B N"]) -> PolicyDraw:
    """WASH the preferred free object with a gain; else WAIT if a blocked object has a gain; else FINISH."""
    xp, is_possible, actions = library_of(gain), possible_actions(state), ActionSpace(state.num_objects)
    wait = wait_of(state.num_objects)
    is_worth_it = is_possible[..., actions.of(Verb.WASH)] & (gain > 0.0)
    best = xp.argmax(xp.where(is_worth_it, preferred, np.float32(-np.inf)), axis=-1)
    otherwise = xp.where(is_possible[..., wait] & xp.any(gain > 0.0, axis=-1), wait, FINISH)
    return surely(xp.where(xp.any(is_worth_it, axis=-1), actions.encode(Verb.WASH, best), otherwise))
