"""What an action is worth if a stated rule decides ever after, by sampled futures.

The rule is the closed look one step ahead of `one_step`, π(b) = argmax Q_1(b, ·). The best action by Q^π is
far better than π itself: one improvement of a rule is most of what there is to gain [BertsekasCastanon1999]_.

A future is a path of beliefs b_0, b_1, … from action a_0 on, and is worth

    Σ_t  Q°(b_t, a_t) − V°(b_{t+1})  +  value of what is left at its end,   Q°(b, a) = E[R + V°(b')],

where V° lets every object be left or tried once, however few steps remain. Q° is Q_1 for unlimited steps, then exact in
closed form, so the mean is Q^π(b_0, a_0) whatever V° is; and as V° is near V^π, there is little noise left. With one
step to go Q_1 is exact and nothing is drawn. All actions meet the same draws.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.planners.belief import Belief, belief_of, sample_successor
from halfseen.planners.one_step import leaf_value, one_step_q
from halfseen.world.actions import FINISH, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.state import TableState

_UNLIMITED = 1_000_000


@partial(jax.jit, static_argnames="num_futures")
def sampled_values(config: WorldConfig, state: TableState, key: Array, num_futures: int) -> Float[Array, "S A"]:
    """Worth of each of S sampled futures that begin with each action of one table.

    Parameters
    ----------
    config
        The world that is believed in.
    state
        One table.
    key
        The only source of chance.
    num_futures
        S.

    Returns
    -------
    Float[Array, "S A"]
        −∞ where an action is impossible. FINISH has one future, and its worth is exact.
    """
    belief, keys = belief_of(config, state), jax.random.split(key, num_futures)
    is_last = belief.steps_to_go == 1
    first = jnp.where(is_last, *_rule_and_baseline(config, belief))

    def futures(action: Int[Array, ""]) -> Float[Array, " S"]:
        return jax.vmap(lambda key: _surplus(config, belief, action, key))(keys)

    def added(action: Int[Array, ""]) -> Float[Array, " S"]:
        is_followed = possible_actions(state)[action] & (action != FINISH) & ~is_last
        return jax.lax.cond(is_followed, futures, lambda _: jnp.zeros(num_futures), action)

    # One action after the other: what is impossible costs nothing, and memory stays small.
    return first + jax.lax.map(added, jnp.arange(first.shape[0])).T


def _surplus(config: WorldConfig, belief: Belief, action: Int[Array, ""], key: Array) -> Float[Array, ""]:
    """Worth of one future less Q° of its first action; at least two steps are to go."""

    def goes_on(carry: tuple[Belief, Array, Array, Array]) -> Array:
        belief, is_open, _, _ = carry
        return is_open & jnp.any(belief.is_on_table)

    def follow(carry: tuple[Belief, Array, Array, Array]) -> tuple[Belief, Array, Array, Array]:
        belief, _, total, key = carry
        key, step_key = jax.random.split(key)
        is_last = belief.steps_to_go == 1
        q, baseline = _rule_and_baseline(config, belief)
        action = jnp.argmax(q)
        worth = jnp.where(is_last, q[action], baseline[action])
        total = total + worth - leaf_value(config, _with_steps(belief, _UNLIMITED))
        return sample_successor(config, belief, action, step_key), (action != FINISH) & ~is_last, total, key

    key, step_key = jax.random.split(key)
    reached = sample_successor(config, belief, action, step_key)
    return jax.lax.while_loop(goes_on, follow, (reached, jnp.asarray(True), jnp.zeros(()), key))[2]


def _rule_and_baseline(config: WorldConfig, belief: Belief) -> tuple[Float[Array, " A"], Float[Array, " A"]]:
    """Q_1 and Q°; what does not depend on the steps is computed once."""
    steps = jnp.stack([belief.steps_to_go, jnp.asarray(_UNLIMITED, dtype=jnp.int32)])
    both = jax.vmap(lambda num_steps: one_step_q(config, _with_steps(belief, num_steps)))(steps)
    return both[0], both[1]


def _with_steps(belief: Belief, num_steps: Int[Array, ""] | int) -> Belief:
    return replace(belief, steps_to_go=jnp.asarray(num_steps, dtype=jnp.int32))
