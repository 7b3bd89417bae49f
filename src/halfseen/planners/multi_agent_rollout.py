"""Multi-agent rollout: one robot looks for something better than the rule that all follow ever after.

Each action of the robot that decides is tried in futures drawn from what is known (`planners.futures`), in which all
robots, this one included, go on by the rule; the others' turns to deviate come when they decide. To improve a rule one
robot at a time costs as many tries as the robots have actions, added up and not multiplied [Bertsekas2021]_.
"""

from dataclasses import field

import numpy as np

from halfseen.arrays import STATIC, Array, at, library_of, record
from halfseen.errors import ArgumentError
from halfseen.planners.futures import future_rewards
from halfseen.world import random
from halfseen.world.actions import possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, Policy
from halfseen.world.random import Key
from halfseen.world.state import TableState

NUM_FUTURES = 32


@record
class RolloutPolicy:
    """Takes the action that a rule of all robots, followed ever after, makes worth most.

    It leaves the rule's own action only for one that did better over the same futures by `caution` standard errors.

    Parameters
    ----------
    config
        The world and the robots that it believes in.
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

    config: WorldConfig
    rule: Policy
    num_futures: int = field(default=NUM_FUTURES, metadata=STATIC)
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

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table; the futures draw from `key` (the probability of a choice is not known)."""
        future_key, rule_key = random.split(key)
        by_rule = self.rule.decide(state, rule_key).action
        rewards = future_rewards(self.config, state, self.rule, future_key, self.num_futures)
        xp, is_possible = library_of(rewards), possible_actions(state)
        # What is impossible is worth −∞ in every future, which no mean is to be made of.
        rewards = xp.where(is_possible[..., None, :], rewards, np.float32(0.0))
        gained = rewards - at(rewards, by_rule[..., None])[..., None]
        error = xp.std(gained, axis=-2) / np.float32(np.sqrt(self.num_futures - 1.0))
        gain = xp.mean(gained, axis=-2) - self.caution * error
        promise = xp.where(is_possible, gain, np.float32(-np.inf))
        best = xp.argmax(promise, axis=-1)
        action = xp.where(at(promise, best) > 0.0, best, by_rule).astype(np.int32)
        return Decision(action, xp.full(action.shape, np.nan, dtype=np.float32))
