"""What an action is worth if a stated rule decides ever after, by sampled futures.

The rule is the closed look one step ahead of `one_step`, π(b) = argmax Q_1(b, ·). The best action by Q^π is
far better than π itself: one improvement of a rule is most of what there is to gain [BertsekasCastanon1999]_.

A future is a path of beliefs b_0, b_1, … from action a_0 on, and is worth

    Σ_t  Q°(b_t, a_t) − V°(b_{t+1})  +  value of what is left at its end,   Q°(b, a) = E[R + V°(b')],

where V° lets every object be left or tried once, however few steps remain. Q° is Q_1 for unlimited steps, then exact in
closed form, so the mean is Q^π(b_0, a_0) whatever V° is; and as V° is near V^π, there is little noise left. With one
step to go Q_1 is exact and nothing is drawn. All actions meet the same draws.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.planners.belief import Belief, belief_of, sample_successor
from halfseen.planners.one_step import UNLIMITED, control_value, rule_and_control
from halfseen.world.action_space import FINISH, possible_actions
from halfseen.world.config import Number, WorldConfig
from halfseen.world.state import TableState

SHRINKAGE = 8.0
"""Futures that the mean surplus of all actions counts for in that of one."""


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
    first = jnp.where(is_last, *rule_and_control(config, belief))

    def futures(action: Int[Array, ""]) -> Float[Array, " S"]:
        return jax.vmap(lambda key: _surplus(config, belief, action, key))(keys)

    def added(action: Int[Array, ""]) -> Float[Array, " S"]:
        is_followed = possible_actions(state)[action] & (action != FINISH) & ~is_last
        return jax.lax.cond(is_followed, futures, lambda _: jnp.zeros(num_futures), action)

    # One action after the other: what is impossible costs nothing, and memory stays small.
    return first + jax.lax.map(added, jnp.arange(first.shape[0])).T


def searched_values(
    config: WorldConfig, state: TableState, key: Array, num_futures: int, planning_horizon: Number
) -> Float[Array, " A"]:
    """Q of each action of one table from a number of futures, most of them spent on the actions that promise most.

    Sequential halving [KarninKorenSomekh2013]_: each round draws equally many futures of every action that is left,
    and the better half stays. An action's surplus over Q° is shrunk towards that of all actions, as far as
    `SHRINKAGE` futures would.

    Parameters
    ----------
    config
        The world that is believed in.
    state
        One table.
    key
        The only source of chance.
    num_futures
        Of all actions together; about so many.
    planning_horizon
        Actions of a future, ≥ 2, the first included; the last one is worth Q_1.

    Returns
    -------
    Float[Array, " A"]
        −∞ where an action is impossible.
    """
    belief = belief_of(config, state)
    first = jnp.where(belief.steps_to_go == 1, *rule_and_control(config, belief))
    sizes = _halved(min(first.shape[0] - 1, max(2, num_futures // 4)))
    lane = jnp.arange(max(sizes[0], round(num_futures / len(sizes))))
    # FINISH has one future, and is known.
    num_open = jnp.maximum(jnp.sum(first[1:] > -jnp.inf), 1)

    def draw(carry: tuple[Array, Array], of_round: tuple[Array, Array]) -> tuple[tuple[Array, Array], None]:
        total, count = carry
        num_left, key = jnp.minimum(of_round[0], num_open), of_round[1]
        promising = 1 + jnp.argsort(-_shrunk(first, total, count)[1:])
        action = promising[lane % num_left]
        # All actions meet the same draws.
        keys = jax.vmap(partial(jax.random.fold_in, key))(lane // num_left)
        drawn = jax.vmap(lambda action, key: _surplus(config, belief, action, key, planning_horizon))(action, keys)
        return (total.at[action].add(drawn), count.at[action].add(1.0)), None

    nothing = jnp.zeros_like(first)
    rounds = jnp.array(sizes), jax.random.split(key, len(sizes))
    (total, count), _ = jax.lax.scan(draw, (nothing, nothing), rounds)
    return jnp.where(belief.steps_to_go == 1, first, _shrunk(first, total, count))


def _halved(size: int) -> list[int]:
    """Halves of a number, itself the first, down to 2."""
    sizes = [size]
    while sizes[-1] > 2:
        sizes.append((sizes[-1] + 1) // 2)
    return sizes


def _shrunk(first: Float[Array, " A"], total: Float[Array, " A"], count: Float[Array, " A"]) -> Float[Array, " A"]:
    is_counted = (jnp.arange(first.shape[0]) != FINISH) & (first > -jnp.inf)
    mean = jnp.sum(jnp.where(is_counted, total, 0.0)) / jnp.maximum(jnp.sum(jnp.where(is_counted, count, 0.0)), 1.0)
    added = (total + SHRINKAGE * mean) / (count + SHRINKAGE)
    return first + jnp.where(is_counted, added, 0.0)


def _surplus(
    config: WorldConfig, belief: Belief, action: Int[Array, ""], key: Array, planning_horizon: Number = UNLIMITED
) -> Float[Array, ""]:
    """Worth of one future less Q° of its first action; at least two steps are to go."""
    last_step = belief.steps_to_go - planning_horizon + 1

    def goes_on(carry: tuple[Belief, Array, Array, Array]) -> Array:
        belief, is_open, _, _ = carry
        return is_open & jnp.any(belief.is_on_table)

    def follow(carry: tuple[Belief, Array, Array, Array]) -> tuple[Belief, Array, Array, Array]:
        belief, _, total, key = carry
        key, step_key = jax.random.split(key)
        is_last = (belief.steps_to_go == 1) | (belief.steps_to_go == last_step)
        q, control = rule_and_control(config, belief)
        action = jnp.argmax(q)
        worth = jnp.where(is_last, q[action], control[action])
        total = total + worth - control_value(config, belief)
        return sample_successor(config, belief, action, step_key), (action != FINISH) & ~is_last, total, key

    key, step_key = jax.random.split(key)
    reached = sample_successor(config, belief, action, step_key)
    return jax.lax.while_loop(goes_on, follow, (reached, jnp.asarray(True), jnp.zeros(()), key))[2]
