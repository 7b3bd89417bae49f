"""What an action is worth if a stated rule decides ever after, by rollouts.

The rule is the myopic look-ahead of `one_step`, π(b) = argmax Q_1(b, ·). The best action by Q^π is far better than π
itself: one improvement of a rule is most of what there is to gain [BertsekasCastanon1999]_.

A rollout is a trajectory of beliefs b_0, b_1, … that begins with action a_0 and then follows π. Its worth is

    Q°(b_0, a_0) + Σ_{t≥1} A°(b_t, a_t),    A°(b, a) = Q°(b, a) − V°(b),    Q°(b, a) = E[R + V°(b')],

a control variate in place of the rewards themselves: V° lets every object be left or tried once, however few steps
remain, and Q° is Q_1 for unlimited steps, then exact in closed form. So the mean is Q^π(b_0, a_0) whatever V° is; and
as V° is near V^π, the advantages A° are small and little noise is left. With one step to go Q_1 is exact and nothing is
drawn. All actions meet the same draws.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.planners.belief import Belief, belief_of, sample_successor
from halfseen.planners.one_step import UNLIMITED, control_value, rule_and_control
from halfseen.world.action_space import FINISH
from halfseen.world.config import Number, WorldConfig
from halfseen.world.state import TableState

SHRINKAGE = 8.0
"""Rollouts that the mean advantage of all actions counts for in that of one."""


@partial(jax.jit, static_argnames="num_rollouts")
def sampled_values(config: WorldConfig, state: TableState, key: Array, num_rollouts: int) -> Float[Array, "S A"]:
    """Worth of each of S rollouts of each action of one table.

    Parameters
    ----------
    config
        The world that is believed in.
    state
        One table.
    key
        What is drawn from.
    num_rollouts
        S.

    Returns
    -------
    Float[Array, "S A"]
        −∞ where an action is impossible. FINISH has one rollout, and its worth is exact.
    """
    belief, keys = belief_of(config, state), jax.random.split(key, num_rollouts)
    is_last = belief.steps_to_go == 1
    first = jnp.where(is_last, *rule_and_control(config, belief))

    def rollouts(action: Int[Array, ""]) -> Float[Array, " S"]:
        return jax.vmap(lambda key: _advantage(config, belief, action, key))(keys)

    def added(action: Int[Array, ""]) -> Float[Array, " S"]:
        is_followed = (first[action] > -jnp.inf) & (action != FINISH) & ~is_last
        return jax.lax.cond(is_followed, rollouts, lambda _: jnp.zeros(num_rollouts), action)

    # One action after the other: what is impossible costs nothing, and memory stays small.
    return first + jax.lax.map(added, jnp.arange(first.shape[0])).T


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Search:
    """One table, and what the rollouts of each action brought so far."""

    config: WorldConfig
    belief: Belief
    rule: Float[Array, " A"]
    """Q_1."""
    control: Float[Array, " A"]
    """Q°; −∞ where an action is impossible, as in `rule`."""
    total: Float[Array, " A"]
    """Sum of the advantages over the rollouts of each action."""
    count: Float[Array, " A"]
    """Number of rollouts of each action."""


def opened(config: WorldConfig, state: TableState) -> Search:
    """A search of one table before its first rollout."""
    belief = belief_of(config, state)
    rule, control = rule_and_control(config, belief)
    return Search(config, belief, rule, control, jnp.zeros_like(rule), jnp.zeros_like(rule))


def searched(search: Search, key: Array, num_rollouts: int, planning_horizon: Number) -> Search:
    """Add a number of rollouts, most of them of the actions that promise most.

    Sequential halving [KarninKorenSomekh2013]_: each round adds equally many rollouts of every action that is left,
    and the better half stays.

    Parameters
    ----------
    search
        One table, with at least two steps to go.
    key
        What is drawn from.
    num_rollouts
        Of all actions together; about so many.
    planning_horizon
        Actions of a rollout, ≥ 2, the first included; the last one is worth Q_1.
    """
    sizes = halved(num_rollouts, search.rule.shape[0])
    lane = jnp.arange(max(sizes[0], round(num_rollouts / len(sizes))))

    def one_round(tally: tuple[Array, Array], of_round: tuple[Array, Array]) -> tuple[tuple[Array, Array], None]:
        num_left, key = of_round
        now = replace(search, total=tally[0], count=tally[1])
        now = drawn(now, most_promising(now), num_left, lane, key, planning_horizon)
        return (now.total, now.count), None

    rounds = jnp.array(sizes), jax.random.split(key, len(sizes))
    (total, count), _ = jax.lax.scan(one_round, (search.total, search.count), rounds)
    return replace(search, total=total, count=count)


def drawn(
    search: Search,
    promising: Int[Array, " K"],
    num_left: Number,
    lane: Int[Array, " L"],
    key: Array,
    planning_horizon: Number,
) -> Search:
    """Add one rollout for each lane: lane l has the l-th of the actions that are left, in turn.

    Parameters
    ----------
    search
        One table, with at least two steps to go.
    promising
        All actions but FINISH, which has one rollout, and is known; the best first.
    num_left
        How many of them are drawn from.
    lane
        Numbers of the rollouts within their round.
    key
        What the round draws from; all its actions meet the same draws.
    planning_horizon
        Actions of a rollout, ≥ 2.
    """
    num_left = jnp.minimum(num_left, jnp.maximum(jnp.sum(search.control[1:] > -jnp.inf), 1))
    action = promising[lane % num_left]
    keys = jax.vmap(partial(jax.random.fold_in, key))(lane // num_left)
    advantage = jax.vmap(lambda action, key: _advantage(search.config, search.belief, action, key, planning_horizon))(
        action, keys
    )
    return replace(search, total=search.total.at[action].add(advantage), count=search.count.at[action].add(1.0))


def searched_values(
    config: WorldConfig, state: TableState, key: Array, num_rollouts: int, planning_horizon: Number
) -> Float[Array, " A"]:
    """Q of each action of one table from a number of rollouts; see `searched` and `values`."""
    return values(searched(opened(config, state), key, num_rollouts, planning_horizon))


def values(search: Search) -> Float[Array, " A"]:
    """Q of each action, −∞ where it is impossible.

    An action's mean advantage is shrunk towards that of all actions, as far as `SHRINKAGE` rollouts would.
    """
    return jnp.where(search.belief.steps_to_go == 1, search.rule, _shrunk(search))


def most_promising(search: Search) -> Int[Array, " K"]:
    """All actions but FINISH, the best first."""
    return 1 + jnp.argsort(-_shrunk(search)[1:])


def halved(num_rollouts: int, num_actions: int) -> list[int]:
    """Actions that are left in each round of a number of rollouts, halves down to 2."""
    sizes = [min(num_actions - 1, max(2, num_rollouts // 4))]
    while sizes[-1] > 2:
        sizes.append((sizes[-1] + 1) // 2)
    return sizes


def _shrunk(search: Search) -> Float[Array, " A"]:
    total, count = search.total, search.count
    is_counted = (jnp.arange(count.shape[0]) != FINISH) & (search.control > -jnp.inf)
    mean = jnp.sum(jnp.where(is_counted, total, 0.0)) / jnp.maximum(jnp.sum(jnp.where(is_counted, count, 0.0)), 1.0)
    added = (total + SHRINKAGE * mean) / (count + SHRINKAGE)
    return search.control + jnp.where(is_counted, added, 0.0)


def _advantage(
    config: WorldConfig, belief: Belief, action: Int[Array, ""], key: Array, planning_horizon: Number = UNLIMITED
) -> Float[Array, ""]:
    """Sum of the advantages of one rollout, its worth less Q° of its first action; at least two steps are to go."""
    last_step = belief.steps_to_go - planning_horizon + 1

    def goes_on(carry: tuple[Belief, Array, Array, Array, Array]) -> Array:
        return carry[2]

    def follow(carry: tuple[Belief, Array, Array, Array, Array]) -> tuple[Belief, Array, Array, Array, Array]:
        belief, action, _, total, key = carry
        key, step_key = jax.random.split(key)
        belief = sample_successor(config, belief, action, step_key)
        is_last = (belief.steps_to_go == 1) | (belief.steps_to_go == last_step)
        q, control = rule_and_control(config, belief)
        action = jnp.argmax(q).astype(action.dtype)
        # On a table that is cleared both are 0.
        total = total + jnp.where(is_last, q[action], control[action]) - control_value(config, belief)
        return belief, action, (action != FINISH) & ~is_last, total, key

    return jax.lax.while_loop(goes_on, follow, (belief, action, jnp.asarray(True), jnp.zeros(()), key))[3]
