"""Rules of thumb: wash what promises most now, stop when nothing promises anything. They never lift to look."""

from dataclasses import field
from typing import ClassVar

import numpy as np

from halfseen.arrays import STATIC, Array, expit, library_of, record
from halfseen.errors import ArgumentError
from halfseen.planners.belief import grasp_probability, grip_posterior, prior_grip
from halfseen.shapes import Bool, Float
from halfseen.world.actions import FINISH, ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, GraspModel, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState, occlusion


def wash_worth(
    config: WorldConfig,
    is_dirty: Float[Array, "*#S"],
    probability: Float[Array, "*#S"],
    counts_penalty: bool | Bool[Array, ""],
) -> Float[Array, "*S"]:
    """Expected reward of one attempt to WASH an object that is dirty with probability `is_dirty`.

    With `counts_penalty` the price of a dirty object left behind, which a success avoids, counts too.
    """
    reward_dirty = config.reward_wash_dirty - counts_penalty * config.reward_dirty_left
    washed = is_dirty * reward_dirty + (1.0 - is_dirty) * config.reward_wash_clean
    return probability * washed + (1.0 - probability) * config.reward_wash_failed


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
        worth = wash_worth(self.config, expit(state.log_odds), grasp.probability(state), self.counts_penalty)
        return library_of(worth).where(state.is_on_table, worth, np.float32(-np.inf))

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table; nothing is drawn."""
        worth = self.worth(state)
        xp = library_of(worth)
        wash = ActionSpace(state.num_objects).encode(Verb.WASH, xp.argmax(worth, axis=-1))
        return surely(xp.where(xp.max(worth, axis=-1) > 0.0, wash, FINISH))
