"""Decisions at a table: of a learned policy, a planner or a heuristic."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from halfseen.policies.decision import Decision
from halfseen.policies.ranges import RangesOfStage, beyond, everything
from halfseen.policies.reasons import table_reason, values_by_name
from halfseen.tables.present import Present
from halfseen.tables.reasons import table_grounds
from halfseen.world.action_space import ActionSpace
from halfseen.world.policy import Policy
from halfseen.world.state import TableState


@dataclass(frozen=True)
class TableDecider:
    """Asks any `halfseen.world.Policy` (a `Decider`).

    Parameters
    ----------
    policy
        The policy.
    ranges
        What the logs showed where it was learned; nothing is outside for a policy that was not.
    seed
        Of a policy that draws, such as a planner; the same seed gives the same decision.
    """

    policy: Policy
    ranges: RangesOfStage = everything
    seed: int = 0

    def decide(self, observation: Present) -> Decision:
        """Decide where the path stands now."""
        state, names = observation.state, ActionSpace(observation.state.num_objects).names
        warnings = (*observation.notes, *beyond(self.ranges(observation.stage), observed_values(state)))
        key = jax.random.key(self.seed)
        if not hasattr(self.policy, "q_values"):
            action = int(jax.jit(type(self.policy).decide)(self.policy, state, key).action)
            rule = type(self.policy).__name__
            return Decision(names[action], {}, f"{names[action]}: by {rule}; {table_grounds(state, action)}.", warnings)
        q = _q_values(self.policy, state, key)
        return Decision(names[int(np.argmax(q))], values_by_name(names, q), table_reason(state, q), warnings)


def observed_values(state: TableState) -> dict[str, dict[str, float]]:
    """What the ranges of a policy of tables are of, and whose value each is."""
    tried = np.asarray(state.attempt_object)[:, None] == np.arange(state.num_objects)
    each = {
        "occlusion": 1.0 - np.prod(1.0 - np.asarray(state.hides, dtype=np.float64), axis=1),
        "log_odds": np.asarray(state.log_odds, dtype=np.float64),
        "num_attempts": tried.sum(axis=0),
    }
    by_object = {name: {f"{name} of object {k}": float(v) for k, v in enumerate(each[name])} for name in each}
    return {"num_objects": {"num_objects": float(state.num_objects)}, **by_object}


def _q_values(policy: Any, state: TableState, key: jax.Array) -> Float[np.ndarray, " A"]:
    values = jax.jit(type(policy).q_values)(policy, state, key)
    return np.asarray(jnp.asarray(values), dtype=np.float64)
