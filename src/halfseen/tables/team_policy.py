"""A learned Q of a team as a policy: what is best by it, or where it is sure to improve on what each does alone."""

from dataclasses import field

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import STATIC, Array, at, library_of, record
from halfseen.learning.choice import leaning, seen_among
from halfseen.learning.rows import q_values
from halfseen.tables.margins import margins
from halfseen.tables.team_features import team_features
from halfseen.world.actions import WAIT, ActionSpace, worthwhile_actions
from halfseen.world.policy import Decision, GraspModel, Policy, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState


@record
class LinearTeamPolicy:
    """argmax over what the robot that decides may do of Q̂_h, with h the decisions to go of all robots together.

    Where Q̂ is that of a base policy, the base decides unless that maximum is worth more than the base's own action by
    more than `caution`: one step of policy iteration, one robot at a time, that Q̂'s errors are not to undo.

    Parameters
    ----------
    coefficients
        Of Q_1 … Q_T, by decisions to go, for all verbs alike (K = 1), the offset first.
    grasp
        What tells the probability of a grasp in the features; None for the rule of succession.
    is_seen
        Which verbs have a value, by decisions to go; None for all.
    margin
        M by decisions to go; None without pessimism.
    behaviour
        Coefficients of the behaviour policy, which waives margins; None if not known.
    num_robots
        For how many robots it was learned; None if nobody said so.
    base
        The policy of a team whose Q this is; None if it is that of the best.
    caution
        By how much another action must be better than that of `base`, in units of reward.
    """

    coefficients: Float[Array, "T K F"]
    grasp: GraspModel | None = None
    is_seen: Bool[Array, "T V"] | None = None
    margin: Float[Array, "T K F F"] | None = None
    behaviour: Float[Array, "K G"] | None = None
    num_robots: int | None = field(default=None, metadata=STATIC)
    base: Policy | None = None
    caution: float | Array = 0.0

    @property
    def num_stages(self) -> int:
        """Decisions of all robots together, for which it was learned."""
        return len(self.coefficients)

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Q of every action, less its margin, measured from leaving the table; −∞ where it is not chosen from."""
        features, allowed = team_features(state, self.grasp), worthwhile_actions(state)
        xp, one_block = library_of(features), np.zeros(allowed.shape[-1], dtype=np.int32)
        to_go = self._to_go(state)
        q = q_values(xp.take(self.coefficients, to_go, axis=0), features, one_block)
        if self.is_seen is not None:
            verbs = np.append(ActionSpace(state.num_objects).verbs, WAIT)
            allowed = seen_among(allowed, xp.take(self.is_seen, to_go, axis=0)[..., verbs])
        if self.margin is not None:
            margin = margins(self.margin, features, to_go, [slice(None)])
            if self.behaviour is not None:
                lean = leaning(q_values(self.behaviour, features, one_block), allowed)
                margin = (1.0 - lean).astype(margin.dtype) * margin
            q = q - margin
        return xp.where(allowed, q, np.float32(-np.inf))

    def _to_go(self, state: TableState) -> Int[Array, "*B"]:
        assert state.robots is not None
        xp = library_of(state.robots.decisions_to_go)
        return xp.clip(xp.sum(state.robots.decisions_to_go, axis=-1), 1, len(self.coefficients)) - 1

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose; deterministic."""
        q = self.q_values(state)
        xp = library_of(q)
        best = xp.argmax(q, axis=-1)
        if self.base is None:
            return surely(best)
        of_base = self.base.decide(state, key).action
        return surely(xp.where(at(q, best) - at(q, of_base) > self.caution, best, of_base))
