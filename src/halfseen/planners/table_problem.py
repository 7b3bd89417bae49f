"""The table as a problem that can be drawn from.

A state is what is seen (`TableState`) and what is not (`HiddenState`); the belief in the hidden part given the seen is
exact: attributes by their log-odds, and each grip offset by its posterior, on a fine grid. What an action lets the
policy observe is which labels said DIRTY and whether the grasp held.

The rule is the closed look one step ahead of `one_step`, and so is the control.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.belief import belief_of, known_grasping, known_seeing
from halfseen.planners.generative import Control, Step
from halfseen.planners.one_step import control_value, one_step_q, rule_and_control
from halfseen.world.action_space import Verb, num_actions, possible_actions, target_of, verb_of
from halfseen.world.config import WorldConfig
from halfseen.world.dynamics import step
from halfseen.world.state import HiddenState, TableState, occlusion_without

MAX_OBJECTS = 30
"""Labels and the grasp are the bits of one 32-bit observation."""
_LEAST_LOG = -80.0
# Made by NumPy: an array of JAX would start its backend on import.
_GRID = np.linspace(-5.0, 5.0, 51, dtype=np.float32)


class TableSituation(NamedTuple):
    """All there is to a table: what is seen of it and what is not."""

    seen: TableState
    hidden: HiddenState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TableProblem:
    """One decision at a table: from what is seen now to the end of the path.

    Parameters
    ----------
    config
        The world that is believed in.
    seen
        The state in which the decision is made; one table.

    Raises
    ------
    ArgumentError
        There are more than 30 objects.
    """

    config: WorldConfig
    seen: TableState

    def __post_init__(self) -> None:
        # Under a transformation the fields may be placeholders without a shape.
        if hasattr(self.seen, "is_object") and hasattr(self.seen.is_object, "shape"):
            num_objects = self.seen.num_objects
            if num_objects > MAX_OBJECTS:
                raise ArgumentError(f"the table has {num_objects} objects; this problem takes {MAX_OBJECTS} at most")

    @property
    def num_actions(self) -> int:
        """FINISH, and WASH and LIFT of each object."""
        return num_actions(self.seen.num_objects)

    @property
    def horizon(self) -> int:
        """Steps of a whole path; those already made are not made again."""
        return self.seen.horizon

    @property
    def discount(self) -> float:
        """The sooner is not the better: 1."""
        return 1.0

    def initial_state(self, key: Array) -> TableSituation:
        """Draw the hidden parts, given all labels and attempts so far."""
        dirty_key, grip_key = jax.random.split(key)
        is_dirty = jax.random.uniform(dirty_key, self.seen.log_odds.shape) < jax.nn.sigmoid(self.seen.log_odds)
        return TableSituation(self.seen, HiddenState(is_dirty, _drawn_grip(self.config, self.seen, grip_key)))

    def is_possible(self, state: TableSituation) -> Bool[Array, " A"]:
        """FINISH always, WASH and LIFT of what stands on the table."""
        return possible_actions(state.seen)

    def step(self, state: TableSituation, action: Int[Array, ""], key: Array) -> Step:
        """Carry out one possible action in the world."""
        after, hidden, outcome = step(self.config, state.seen, state.hidden, action, key)
        now = state.seen.horizon - state.seen.steps_to_go
        says_dirty = after.log_odds > state.seen.log_odds
        bits = jnp.append(says_dirty, after.attempt_succeeded[now]).astype(jnp.int32)
        observation = jnp.sum(bits << jnp.arange(bits.shape[0]))
        return Step(TableSituation(after, hidden), observation, outcome.reward, outcome.is_over)

    def log_likelihood(self, observation: Int[Array, ""], state_after: TableSituation, action: Int[Array, ""]) -> Array:
        """Log probability of the labels, and of the grasp, which `state_after` itself says: 0 or −∞."""
        seen, hidden = state_after
        num_objects = seen.num_objects
        bits = (observation >> jnp.arange(num_objects + 1)) & 1
        is_grasped = seen.attempt_succeeded[seen.horizon - 1 - seen.steps_to_go]
        is_target = jnp.arange(num_objects) == target_of(action, num_objects)
        is_held = is_target & is_grasped & (verb_of(action, num_objects) == Verb.LIFT)
        right = known_seeing(self.config).accuracy(jnp.where(is_held, 0.0, occlusion_without(seen, is_held)))
        chance = jnp.where((bits[:-1] == 1) == hidden.is_dirty, right, 1.0 - right)
        # What is off the table gets no label.
        label = jnp.where(seen.is_on_table, jnp.log(chance), jnp.where(bits[:-1] == 0, 0.0, -jnp.inf))
        return jnp.sum(label) + jnp.where(bits[-1] == is_grasped, 0.0, -jnp.inf)

    def rule_values(self, state: TableSituation) -> Float[Array, " A"]:
        """Q_1 of what is seen; −∞ where an action is impossible."""
        return one_step_q(self.config, belief_of(self.config, state.seen))

    def control(self, state: TableSituation) -> Control:
        """Q° and V° of what is seen."""
        belief = belief_of(self.config, state.seen)
        return Control(rule_and_control(self.config, belief)[1], control_value(self.config, belief))


def _drawn_grip(config: WorldConfig, seen: TableState, key: Array) -> Float[Array, " N"]:
    """Draw each grip offset from its posterior given all attempts."""
    grid = jnp.asarray(_GRID)
    law = known_grasping(config)
    missed = law.log_failure(seen.attempt_occlusion[:, None], law.offset_std * grid)
    held = jnp.log(-jnp.expm1(missed))
    # What is impossible must stay finite: 0 · ∞ is no number.
    evidence = jnp.maximum(jnp.where(seen.attempt_succeeded[:, None], held, missed), _LEAST_LOG)
    is_mine = jax.nn.one_hot(seen.attempt_object, seen.num_objects, dtype=evidence.dtype)
    log_density = -0.5 * grid**2 + is_mine.T @ evidence
    share = jnp.cumsum(jax.nn.softmax(log_density, axis=-1), axis=-1)
    draw_key, within_key = jax.random.split(key)
    rank = jnp.sum(share < jax.random.uniform(draw_key, (seen.num_objects, 1)), axis=-1)
    within = jax.random.uniform(within_key, (seen.num_objects,), minval=-0.5, maxval=0.5)
    drawn = grid[jnp.minimum(rank, len(grid) - 1)] + within * (grid[1] - grid[0])
    return law.offset_std * drawn
