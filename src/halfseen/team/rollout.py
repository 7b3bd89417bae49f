"""Multi-agent rollout: one robot looks for something better than the rule that all follow ever after.

Each action of the robot that decides is tried in futures drawn from what is known (`planners.futures`), in which all
robots, this one included, go on by the rule; the others' turns to deviate come when they decide. To improve a rule one
robot at a time costs as many tries as the robots have actions, added up and not multiplied [Bertsekas2021]_.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.futures import KnownRewards, foreseen, future_rewards, imagined
from halfseen.team.actions import WAIT, possible_actions
from halfseen.team.config import TeamConfig
from halfseen.team.dynamics import TEAM, until_out_s
from halfseen.team.policy import TeamPolicy
from halfseen.team.state import Pending, TeamHidden, TeamState
from halfseen.world.action_space import Verb
from halfseen.world.dynamics import attempted
from halfseen.world.policy import Decision
from halfseen.world.state import occlusion

NUM_FUTURES = 32
NUM_PROPOSALS = 16
"""Attempts drawn for each robot that is at work; one of those that have not yet ended is taken."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RolloutTeam:
    """Takes the action that a rule of all robots, followed ever after, makes worth most.

    It leaves the rule's own action only for one that did better over the same futures by `caution` standard errors.

    Parameters
    ----------
    config
        The team that it believes in.
    rule
        What all robots follow afterwards.
    num_futures
        Futures in which each action is tried, ≥ 2.
    caution
        Standard errors by which another action must be better than the rule's.

    Raises
    ------
    ArgumentError
        `num_futures` is below 2.
    """

    config: TeamConfig
    rule: TeamPolicy
    num_futures: int = field(default=NUM_FUTURES, metadata={"static": True})
    caution: float | Array = 1.0

    def __post_init__(self) -> None:
        if self.num_futures < 2:
            raise ArgumentError(
                f"num_futures is {self.num_futures}; give at least 2, as their scatter tells how sure a gain is"
            )

    @property
    def num_robots(self) -> int:
        """K."""
        return self.config.num_robots

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; the futures draw from `key` (the probability of a choice is not known)."""
        future_key, rule_key = jax.random.split(key)
        by_rule = self.rule.decide(state, rule_key).action
        rewards = team_future_rewards(self.config, state, self.rule, future_key, self.num_futures)
        gained = rewards - rewards[:, by_rule][:, None]
        error = jnp.std(gained, axis=0) / jnp.sqrt(self.num_futures - 1.0)
        promise = jnp.where(possible_actions(state), jnp.mean(gained, axis=0) - self.caution * error, -jnp.inf)
        best = jnp.argmax(promise)
        action = jnp.where(promise[best] > 0.0, best, by_rule).astype(jnp.int32)
        return Decision(action, jnp.full((), jnp.nan, dtype=jnp.float32))


def team_future_rewards(
    config: TeamConfig, state: TeamState, rule: TeamPolicy, key: Array, num_futures: int
) -> Float[Array, "S A"]:
    """Reward of each action of the robot that decides, all following a rule, in each of S futures; −∞ if impossible."""
    foreseeing = replace(config, world=foreseen(config.world))

    def imagine(key: Array) -> TeamHidden:
        return imagined_team(config, state, key)

    is_possible, rewards = possible_actions(state), KnownRewards(config.world, lambda each: each.table)
    return future_rewards(TEAM, foreseeing, state, is_possible, imagine, rule, key, num_futures, rewards)


def imagined_team(config: TeamConfig, state: TeamState, key: Array) -> TeamHidden:
    """Draw what no robot sees, given what all see: attributes and grips, and how what the others are at will end.

    For each robot `NUM_PROPOSALS` attempts are drawn, grip and all, as if begun on the table as it is now; one of those
    that last longer than the robot has been at it is taken (rejection sampling). If none does, the longest is, and ends
    at once. Whether a robot will drop out is drawn afresh, as a constant hazard remembers nothing.
    """
    table_key, robots_key = jax.random.split(key)
    table = imagined(config.world, state.table, table_key)
    robots = jnp.arange(config.num_robots)
    keys = jax.random.split(robots_key, config.num_robots)
    *of_pending, offset = jax.vmap(lambda robot, key: _pending(config, state, robot, key))(robots, keys)
    is_at_object = state.robots.is_busy & (state.robots.verb > 0) & (state.robots.verb != WAIT)
    # What nobody is at is out of the table's range, and dropped.
    target = jnp.where(is_at_object, state.robots.target, state.table.num_objects)
    trait = jax.tree.map(lambda all_of, own: all_of.at[target].set(own, mode="drop"), table.grasp_trait, offset)
    table = replace(table, grasp_trait=trait)
    return TeamHidden(
        table, Pending(*of_pending), until_out_s(config, jax.random.fold_in(robots_key, config.num_robots))
    )


def _pending(config: TeamConfig, state: TeamState, robot: Int[Array, ""], key: Array) -> tuple[Any, ...]:
    """How what one robot carries out will end (the fields of `Pending`), and the grip offset of its object."""
    world, robots, speed = config.world.as_robot(robot), state.robots, jnp.asarray(config.speed)[robot]
    is_wait, target, since_s = robots.verb[robot] == WAIT, robots.target[robot], robots.since_s[robot]
    verb = jnp.where(is_wait, Verb.FINISH, robots.verb[robot])

    def proposal(key: Array) -> tuple[Array, Array, Array, Any]:
        grip_key, attempt_key = jax.random.split(key)
        drawn = imagined(world, state.table, grip_key)
        tried = attempted(world, state.table, drawn, verb, target, attempt_key)
        duration_s = (world.transport_s + tried.duration_s) / speed
        return duration_s, tried.is_held, tried.hides, jax.tree.map(lambda offset: offset[target], drawn.grasp_trait)

    duration_s, is_held, hides, offset = jax.vmap(proposal)(jax.random.split(key, NUM_PROPOSALS))
    # Of two that end at once the lower robot ends first, so that a higher one may be at its end.
    goes_on = (duration_s > since_s) | ((duration_s == since_s) & (robot > state.decider))
    # They are alike before they are looked at: the first that goes on is as good as any.
    chosen = jnp.where(jnp.any(goes_on), jnp.argmax(goes_on), jnp.argmax(duration_s))
    left_s = jnp.where(is_wait, jnp.inf, jnp.maximum(duration_s[chosen] - since_s, 0.0))
    return (
        jnp.where(robots.is_busy[robot], left_s, jnp.inf),
        duration_s[chosen],
        is_held[chosen],
        occlusion(state.table)[target],
        hides[chosen],
        hides[chosen] != state.table.hides,
        jax.tree.map(lambda drawn: drawn[chosen], offset),
    )
