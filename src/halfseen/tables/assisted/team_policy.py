"""What is learned of a team with the help of fitted laws, as a policy."""

import numpy as np

from halfseen.arrays import Array, at, library_of, record
from halfseen.planners.myopic import MyopicPolicy
from halfseen.shapes import Float
from halfseen.tables.assisted.team_features import NUM_TEAM_FEATURES, team_described
from halfseen.world.config import WorldConfig
from halfseen.world.number import Number
from halfseen.world.policy import Decision, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState

CAUTION = 0.1


@record
class TeamExcess:
    """E of a team, linear: by how much an action is worth more beside the myopic one than the myopic look says."""

    coefficients: Float[np.ndarray, " F"]
    low: Number
    high: Number
    """E is kept within these."""
    caution: Number = CAUTION
    """By how much an action must be better than the myopic one."""

    @classmethod
    def none(cls) -> "TeamExcess":
        """E ≡ 0."""
        return cls(np.zeros(NUM_TEAM_FEATURES, dtype=np.float32), 0.0, 0.0)

    def __call__(self, state: TableState, q: Float[Array, "*B A"]) -> Float[Array, "*B A"]:
        """E of every action, less the caution; 0 of the best one by `q`, which is what the myopic look makes of each.

        WAIT, which is asked again after each event, is never made more of: errors would add up.
        """
        xp = library_of(q, self.coefficients)
        values, best = team_described(state, q) @ self.coefficients, xp.argmax(q, axis=-1)[..., None]
        beside = xp.clip(values - at(values, best[..., 0])[..., None], self.low, self.high)
        beside = xp.concatenate([beside[..., :-1], xp.minimum(beside[..., -1:], np.float32(0.0))], axis=-1)
        is_best = xp.arange(q.shape[-1]) == best
        return xp.where(is_best, np.float32(0.0), beside - self.caution).astype(np.float32)


@record
class AssistedTeamPolicy:
    """Decides one robot at a time: argmax of the myopic look under fitted laws and E, what it misses.

    Parameters
    ----------
    config
        The team with its fitted laws, and the price at which a second is counted.
    excess
        E; None for the myopic look alone.
    """

    config: WorldConfig
    excess: TeamExcess | None = None

    @property
    def num_robots(self) -> int:
        """K."""
        return self.config.num_robots

    @property
    def num_stages(self) -> int:
        """Decisions of all robots together, for which it was learned."""
        return self.config.num_stages

    @property
    def horizon(self) -> int:
        """The same."""
        return self.config.num_stages

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose; deterministic."""
        return surely(library_of(state.log_odds).argmax(self.q_values(state), axis=-1))

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Worth of every action above leaving all as it is, WAIT last; −∞ where it is impossible."""
        q = MyopicPolicy(self.config).q_values(state)
        return q if self.excess is None else q + self.excess(state, q)
