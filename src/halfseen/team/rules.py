"""Rules of thumb of a team: wash what is worth its time, and leave alone what another robot is at.

Whatever a robot begins is reserved: nobody else touches it, nor what is near it (`actions`). `ReservingTeam` is as
strong a plain rule as we know. `TeamOfRules` knows no price of time, and `RoundRobin` and `OneAtATime` coordinate
less; a team's policy is to beat them all.

Where the world that a rule believes in has a law of grasping for each robot (`TeamWorld.team_config.world`), an attempt
is worth what it is by the law of the robot that decides, and a past attempt tells of a grip what the law of the robot
says that made it.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.planners.belief import expected_attempt_s, grip_posterior, prior_grip
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team.actions import possible_actions, wait_of
from halfseen.team.config import TeamConfig
from halfseen.team.others import others_of
from halfseen.team.state import TeamState
from halfseen.world.action_space import FINISH, ActionSpace, Verb
from halfseen.world.policy import Decision, surely
from halfseen.world.state import occlusion


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TeamOfRules:
    """Every robot washes what promises most of what nobody else is at; it waits where that may change, or finishes.

    Parameters
    ----------
    rule
        The rule of thumb of one robot.
    """

    rule: GreedyPolicy

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; nothing is drawn."""
        gain = _worth(self.rule, state)
        return _chosen(state, gain, gain)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ReservingTeam:
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

    config: TeamConfig
    rule: GreedyPolicy

    @property
    def num_robots(self) -> int:
        """K."""
        return self.config.num_robots

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; nothing is drawn."""
        others, worth, price = others_of(state), _worth(self.rule, state), -self._price_of_attempts(state)
        gain = worth - price / (1 + jnp.sum(others.goes_on))
        preferred = jnp.where(others.reached, gain - price, gain)
        return _chosen(state, gain, preferred)

    def _price_of_attempts(self, state: TeamState) -> Float[Array, " N"]:
        """Price of the time that the robot that decides is expected to take for each object, if nobody shares it."""
        world, table = self.config.world.as_robot(state.decider), state.table
        grip = grip_posterior(world, table) if self.rule.uses_history else prior_grip(table.grip)
        attempt_s = expected_attempt_s(world, occlusion(table), grip) / jnp.asarray(self.config.speed)[state.decider]
        return self.config.reward_per_s * attempt_s


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RoundRobin:
    """Objects are dealt to the robots in turn: each clears its own as if alone, and nobody helps.

    Object i falls to the (i modulo their number)-th of the robots that reach it and go on.

    Parameters
    ----------
    rule
        The rule of thumb of one robot.
    """

    rule: GreedyPolicy

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; nothing is drawn."""
        is_me = jnp.arange(state.robots.num_robots) == state.decider
        reach = state.workspace.is_in_reach & (is_me | others_of(state).goes_on)[:, None]
        place = jnp.arange(reach.shape[1]) % jnp.maximum(jnp.sum(reach, axis=0), 1)
        is_dealt = reach & (jnp.cumsum(reach, axis=0) - 1 == place)
        gain = jnp.where(is_dealt[state.decider], _worth(self.rule, state), -jnp.inf)
        return _chosen(state, gain, gain)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class OneAtATime:
    """One robot works while the others wait: the lowest of those that go on, until nothing promises anything to it.

    It keeps its turn, as nobody can wait for who is not yet at work. Waiting costs decisions, so that a robot may have
    none left when its turn comes.

    Parameters
    ----------
    rule
        The rule of thumb of one robot.
    """

    rule: GreedyPolicy

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; nothing is drawn."""
        gain, wait = _worth(self.rule, state), wait_of(state.table.num_objects)
        of_turn = _chosen(state, gain, gain)
        return surely(jnp.where(possible_actions(state)[wait], wait, of_turn.action).astype(jnp.int32))


def _worth(rule: GreedyPolicy, state: TeamState) -> Float[Array, " N"]:
    """What an attempt at each object is worth by the robot that decides; −∞ where it does not reach it."""
    own = replace(rule, config=rule.config.as_robot(state.decider))
    return jnp.where(state.workspace.is_in_reach[state.decider], own.worth(state.table), -jnp.inf)


def _chosen(state: TeamState, gain: Float[Array, " N"], preferred: Float[Array, " N"]) -> Decision:
    """WASH the preferred of what is free and gains; else WAIT where something gains that is not free; else FINISH."""
    is_possible, actions = possible_actions(state), ActionSpace(state.table.num_objects)
    wait = wait_of(state.table.num_objects)
    is_worth_it: Bool[Array, " N"] = is_possible[actions.of(Verb.WASH)] & (gain > 0.0)
    best = jnp.argmax(jnp.where(is_worth_it, preferred, -jnp.inf))
    otherwise = jnp.where(is_possible[wait] & jnp.any(gain > 0.0), wait, FINISH)
    wash = actions.encode(Verb.WASH, best)
    return surely(jnp.where(jnp.any(is_worth_it), wash, otherwise).astype(jnp.int32))
