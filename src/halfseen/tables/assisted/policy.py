"""What is learned of tables with the help of fitted laws, as policies."""

from typing import ClassVar

import numpy as np

from halfseen.arrays import Array, library_of, record
from halfseen.planners.belief import belief_of
from halfseen.planners.heuristics import GreedyPolicy, TrueGrasp
from halfseen.planners.one_step import laid_out, left_price, table_of
from halfseen.shapes import Bool, Float
from halfseen.tables.assisted.features import ahead_of
from halfseen.tables.assisted.mending import Mending
from halfseen.tables.assisted.synthetic import Excess
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, GraspModel, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState


@record
class LawPolicy:
    """Decides by fitted laws: argmax of `q_values`.

    Parameters
    ----------
    config
        The world with its fitted laws.
    mending
        Makes log-odds anew where the recorder got them wrong; None where it did not.
    """

    config: WorldConfig
    mending: Mending | None = None

    num_robots: ClassVar[int] = 1

    @property
    def horizon(self) -> int:
        """T."""
        return self.config.horizon

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose; deterministic."""
        return surely(library_of(state.log_odds).argmax(self.q_values(state), axis=-1))

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Q of every action; −∞ where an action is impossible, or never taken."""
        raise NotImplementedError

    def mended(self, state: TableState) -> TableState:
        """The state, with log-odds as the laws have them."""
        return state if self.mending is None else self.mending(state)


@record
class AssistedPolicy(LawPolicy):
    """Q_1 + E_h: the look one step ahead, and what it misses (`synthetic`).

    Parameters
    ----------
    config, mending
        As of `LawPolicy`.
    excess
        E; None for the look alone.
    is_seen
        Which verbs the log has seen completed, the others are never taken; None for all.
    """

    excess: Excess | None = None
    is_seen: Bool[Array, " V"] | None = None

    @property
    def grasp(self) -> GraspModel:
        """P(an attempt succeeds), as the fitted law has it."""
        return TrueGrasp(self.config)

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Q of every action; −∞ where an action is impossible."""
        ahead = ahead_of(self.config, table_of(belief_of(self.config, self.mended(state))))
        left = left_price(self.config, ahead.table)
        above = ahead.one_step if self.excess is None else ahead.one_step + self.excess(ahead)
        q = laid_out(left, left + above)
        if self.is_seen is None:
            return q
        xp, verbs = library_of(q, self.is_seen), ActionSpace(state.num_objects).verbs
        return xp.where(xp.asarray(self.is_seen)[verbs], q, np.float32(-np.inf))


@record
class RulePolicy(LawPolicy):
    """The rule of thumb that counts history and penalty: where the log contradicts the laws, it relies on them least.

    Parameters
    ----------
    config, mending
        As of `LawPolicy`.
    grasp
        What tells the probability of a grasp; None for the fitted law.
    """

    grasp: GraspModel | None = None

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """What a WASH is worth above leaving all; 0 of FINISH, −∞ of LIFT."""
        rule = GreedyPolicy(self.config, uses_history=True, counts_penalty=True, grasp=self.grasp)
        worth = rule.worth(self.mended(state))
        zero = library_of(worth).zeros_like(worth[..., 0])
        return ActionSpace(state.num_objects).join(zero, {Verb.WASH: worth})
