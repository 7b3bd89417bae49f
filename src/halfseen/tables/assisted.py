"""Policies of tables that use fitted laws, for one robot and for a team.

*Mending.* A recorder may compute wrong log-odds; they are then recomputed from its labels under the fitted law. But a
policy sees log-odds, not labels. The log holds both, so a rising map from the recorder's log-odds to those of the
fitted law is learned from it: means between quantiles, with linear interpolation. Where a look that shows nothing new
is no news, and nothing was found, the seen share of an object determines its log-odds: the fitted law gives them.
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from halfseen.arrays import Array, Number, at, library_of, record
from halfseen.planners.heuristics import GreedyPolicy, TrueGrasp
from halfseen.planners.myopic import MyopicPolicy
from halfseen.planners.one_step import laid_out, left_price, table_of
from halfseen.shapes import Bool, Float, Int
from halfseen.tables import look_ahead
from halfseen.tables.look_ahead import NUM_TABLE, Ahead
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import ByValue, GraspModel
from halfseen.world.random import Key
from halfseen.world.seeing import PersistentSeeing
from halfseen.world.state import TableState


@record
class Mending:
    """Log-odds under a law, computed from recorded log-odds and seen shares.

    Parameters
    ----------
    recorded, mended
        Knots of a rising, piecewise linear function from recorded to recomputed log-odds.
    prior
        Log-odds before any label; a recorded value below it means that a look found nothing.
    law
        Law for objects in which looks found nothing; None where each look is news, and the function covers all.
    """

    recorded: Float[np.ndarray, " k"]
    mended: Float[np.ndarray, " k"]
    prior: Number
    law: PersistentSeeing | None = None

    def __call__(self, state: TableState) -> TableState:
        """The same state with recomputed log-odds."""
        xp = library_of(state.log_odds)
        log_odds = xp.interp(state.log_odds, self.recorded, self.mended)
        if self.law is not None:
            # Evidence of having found nothing in the seen share.
            missed = (1.0 - found for found in self.law.found_by(state.seen))
            if_dirty, if_clean = (xp.log(xp.maximum(each, 1e-6)) for each in missed)
            log_odds = xp.where(state.log_odds < self.prior, self.prior + (if_dirty - if_clean), log_odds)
        return replace(state, log_odds=log_odds.astype(np.float32))


@record
class Excess:
    """E, linear by verb and steps to go; 0 for FINISH and with one step to go."""

    coefficients: Float[np.ndarray, "T 2 F"]
    """Offset first."""
    low: Float[np.ndarray, "T 2"]
    high: Float[np.ndarray, "T 2"]

    @classmethod
    def none(cls, horizon: int) -> "Excess":
        """E ≡ 0."""
        low, high = np.zeros((2, horizon, 2), dtype=np.float32)
        return cls(np.zeros((horizon, 2, 1 + look_ahead.NUM_EXCESS_FEATURES), dtype=np.float32), low, high)

    def __call__(self, ahead: Ahead) -> Float[Array, " C *B"]:
        """E of WASH and LIFT of each object."""
        xp, to_go = library_of(ahead.own, self.coefficients), ahead.table.steps_to_go - 1
        weights, low, high = (_by_steps(each, to_go) for each in (self.coefficients, self.low, self.high))
        of_table = weights[:, 0] + (weights[:, 1 : 1 + NUM_TABLE] * ahead.of_table).sum(axis=1)
        own = xp.einsum("vf...,fvn...->vn...", weights[:, 1 + NUM_TABLE :], ahead.own)
        values = xp.clip(of_table[:, None] + own, low[:, None], high[:, None])
        return values.reshape(-1, *values.shape[2:])


def _by_steps(each: Float[Array, "T ..."], to_go: Int[Array, "*B"]) -> Float[Array, "..."]:
    """Entries for the steps to go of each table, batch axes last."""
    xp, num_axes = library_of(each, to_go), np.ndim(to_go)
    return xp.moveaxis(xp.take(each, to_go, axis=0), range(num_axes), range(-num_axes, 0))


@record
class LawPolicy(ByValue):
    """Decides by fitted laws: argmax of `q_values`.

    Parameters
    ----------
    config
        The world with its fitted laws.
    mending
        Recomputes log-odds where the recorder's are wrong; None where they are right.
    """

    config: WorldConfig
    mending: Mending | None = None

    num_robots: ClassVar[int] = 1

    @property
    def horizon(self) -> int:
        """T, the stages of a trajectory."""
        return self.config.horizon

    def mended(self, state: TableState) -> TableState:
        """The state with log-odds under the laws."""
        return state if self.mending is None else self.mending(state)


@record
class AssistedPolicy(LawPolicy):
    """Q_1 + E_h: the one-step look-ahead plus its learned error (`halfseen.tables.excess`).

    Parameters
    ----------
    config, mending
        As in `LawPolicy`.
    excess
        E; None for the look-ahead alone.
    is_seen
        Which verbs were completed in the log; the others are never taken. None for all.
    """

    excess: Excess | None = None
    is_seen: Bool[Array, " V"] | None = None

    @property
    def grasp(self) -> GraspModel:
        """P(an attempt succeeds) under the fitted law."""
        return TrueGrasp(self.config)

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Q of every action; −∞ where it is impossible."""
        ahead = look_ahead.ahead_of(self.config, table_of(self.config, self.mended(state)))
        left = left_price(self.config, ahead.table)
        above = ahead.one_step if self.excess is None else ahead.one_step + self.excess(ahead)
        q = laid_out(left, left + above)
        if self.is_seen is None:
            return q
        xp, verbs = library_of(q, self.is_seen), ActionSpace(state.num_objects).verbs
        return xp.where(xp.asarray(self.is_seen)[verbs], q, np.float32(-np.inf))


@record
class RulePolicy(LawPolicy):
    """The heuristic that counts history and penalty; it relies least on the laws where the log contradicts them.

    Parameters
    ----------
    config, mending
        As in `LawPolicy`.
    grasp
        Model of the probability of a grasp; None for the fitted law.
    """

    grasp: GraspModel | None = None

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Value of a WASH above leaving all as it is; 0 for FINISH, −∞ for LIFT."""
        rule = GreedyPolicy(self.config, uses_history=True, counts_penalty=True, grasp=self.grasp)
        worth = rule.worth(self.mended(state))
        zero = library_of(worth).zeros_like(worth[..., 0])
        return ActionSpace(state.num_objects).join(zero, {Verb.WASH: worth})


EXCESS_CAUTION = 0.1


@record
class TeamExcess:
    """E of a team, linear: the error of the myopic look in the difference between an action and the myopic one."""

    coefficients: Float[np.ndarray, " F"]
    low: Number
    high: Number
    """E is clipped to [low, high]."""
    caution: Number = EXCESS_CAUTION
    """Least gain over the myopic action that another action must have."""

    @classmethod
    def none(cls) -> "TeamExcess":
        """E ≡ 0."""
        return cls(np.zeros(look_ahead.NUM_TEAM_EXCESS_FEATURES, dtype=np.float32), 0.0, 0.0)

    def __call__(self, state: TableState, q: Float[Array, "*B A"]) -> Float[Array, "*B A"]:
        """E of every action minus the caution; 0 for the best one by `q`, the values of the myopic look.

        E of WAIT is never positive: WAIT is decided again after each event, so that errors would add up.
        """
        xp = library_of(q, self.coefficients)
        values, best = look_ahead.team_described(state, q) @ self.coefficients, xp.argmax(q, axis=-1)[..., None]
        beside = xp.clip(values - at(values, best[..., 0])[..., None], self.low, self.high)
        beside = xp.concatenate([beside[..., :-1], xp.minimum(beside[..., -1:], np.float32(0.0))], axis=-1)
        is_best = xp.arange(q.shape[-1]) == best
        return xp.where(is_best, np.float32(0.0), beside - self.caution).astype(np.float32)


@record
class AssistedTeamPolicy(ByValue):
    """Decides one robot at a time: argmax of the myopic look under fitted laws plus E, its learned error.

    Parameters
    ----------
    config
        The team with its fitted laws, and the price of a second.
    excess
        E; None for the myopic look alone.
    """

    config: WorldConfig
    excess: TeamExcess | None = None

    @property
    def num_robots(self) -> int:
        """K, the robots of the team."""
        return self.config.num_robots

    @property
    def num_stages(self) -> int:
        """Number of decisions of all robots together for which it was learned."""
        return self.config.num_stages

    @property
    def horizon(self) -> int:
        """The same as `num_stages`."""
        return self.config.num_stages

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Value of every action above leaving all as it is, WAIT last; −∞ where it is impossible."""
        q = MyopicPolicy(self.config).q_values(state)
        return q if self.excess is None else q + self.excess(state, q)
