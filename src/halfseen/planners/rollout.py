"""What an action is worth if a stated rule decides ever after, by rollouts.

The rule is the myopic look-ahead of `one_step`, π(b) = argmax Q_1(b, ·). The best action by Q^π is far better than π
itself: one improvement of a rule is most of what there is to gain [BertsekasCastanon1999]_.

A rollout is a trajectory of beliefs b_0, b_1, … that begins with action a_0 and then follows π. Its worth is

    Q°(b_0, a_0) + Σ_{t≥1} A°(b_t, a_t),    A°(b, a) = Q°(b, a) − V°(b),    Q°(b, a) = E[R + V°(b')],

a control variate in place of the rewards themselves: V° lets every object be left or tried once, however few steps
remain, and Q° is Q_1 for unlimited steps, then exact in closed form. So the mean is Q^π(b_0, a_0) whatever V° is; and
as V° is near V^π, the advantages A° are small and little noise is left. With one step to go Q_1 is exact and nothing is
drawn. All actions meet the same draws. All rollouts of all tables advance together (`trajectories`).
"""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from halfseen.arrays import Array, library_of, mapped, record
from halfseen.planners.belief import Belief, belief_of
from halfseen.planners.one_step import Chances, outlook_of, rule_and_control
from halfseen.planners.trajectories import UNLIMITED, Draws, Settings, advantages, draws_of, picked, settings_of
from halfseen.world import random
from halfseen.world.actions import FINISH
from halfseen.world.config import WorldConfig
from halfseen.world.number import Number
from halfseen.world.random import Key
from halfseen.world.state import TableState

SHRINKAGE = 8.0
"""Rollouts that the mean advantage of all actions counts for in that of one."""
LANES = 1024
"""Rollouts that advance together, about: what they need stays in the cache of a core. It changes no value."""


@record
class Search:
    """Some tables, and what the rollouts of each action brought so far."""

    config: WorldConfig
    belief: Belief
    chances: Chances
    rule: Float[Array, "B A"]
    """Q_1."""
    control: Float[Array, "B A"]
    """Q°; −∞ where an action is impossible, as in `rule`."""
    total: Float[Array, "B A"]
    """Sum of the advantages over the rollouts of each action."""
    count: Float[Array, "B A"]
    """Number of rollouts of each action."""
    settings: Settings | None = None
    """Of a table alone."""


def opened(config: WorldConfig, state: TableState) -> Search:
    """A search of tables (one axis of them) before its first rollout."""
    belief = belief_of(config, state)
    settings = settings_of(config, belief)
    outlook = outlook_of(config, belief, None if settings is None else settings.of(config, belief))
    rule, control = rule_and_control(config, belief, outlook)
    none = library_of(rule).zeros_like(rule)
    return Search(config, belief, outlook.chances, rule, control, none, none, settings)


def sampled_values(config: WorldConfig, state: TableState, key: Key, num_rollouts: int) -> Float[Array, "S A"]:
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
    search = opened(config, mapped(lambda leaf: library_of(leaf).asarray(leaf)[None], state))
    xp, num_actions = library_of(search.control), search.control.shape[-1]
    actions = np.arange(1, num_actions)
    if xp is np:
        actions = actions[np.isfinite(search.control[0, 1:])]
    added = [xp.zeros((num_rollouts, 1), dtype=np.float32)]
    step = max(1, LANES // max(len(actions), 1))
    keys = random.keys_of(key, num_rollouts)
    parts = [_of_each(search, actions, keys[k : k + step], state.horizon) for k in range(0, num_rollouts, step)]
    drawn_at = dict(zip(actions.tolist(), xp.moveaxis(xp.concatenate(parts), -1, 0), strict=True))
    added += [drawn_at[a][:, None] if a in drawn_at else added[0] for a in range(1, num_actions)]
    is_last = search.belief.steps_to_go == 1
    # What is impossible stays so, whatever came of following it.
    worth = xp.where(xp.isfinite(search.control), search.control + xp.concatenate(added, axis=-1), search.control)
    return xp.where(is_last[..., None], search.rule, worth)


def _of_each(search: Search, actions: Int[np.ndarray, " k"], keys: Key, horizon: int) -> Float[Array, "s k"]:
    """Advantages of a rollout of each of some actions, by each of some keys."""
    xp, shape = library_of(search.control), (len(keys), len(actions))
    which = np.repeat(np.arange(len(keys)), len(actions))
    draws = draws_of(keys, horizon - 1, search.belief.is_on_table.shape[-1])
    belief, chances = picked((search.belief, search.chances), np.zeros_like(which))
    action = xp.asarray(np.tile(actions, len(keys)))
    return advantages(search.config, belief, chances, action, draws, which, UNLIMITED, search.settings).reshape(shape)


def searched(search: Search, key: Key, num_rollouts: int, planning_horizon: Number, horizon: int) -> Search:
    """Add a number of rollouts, most of them of the actions that promise most.

    Sequential halving [KarninKorenSomekh2013]_: each round adds equally many rollouts of every action that is left,
    and the better half stays.

    Parameters
    ----------
    search
        Tables; where one has fewer than two steps to go, nothing is to be searched.
    key
        What is drawn from, for each.
    num_rollouts
        Of all actions together; about so many.
    planning_horizon
        Actions of a rollout, ≥ 2, the first included; the last one is worth Q_1.
    horizon
        Steps that are to go at most.
    """
    sizes = halved(num_rollouts, search.rule.shape[-1])
    xp, lane = library_of(search.rule), np.arange(max(sizes[0], round(num_rollouts / len(sizes))))
    left = xp.stack([num_left(search, size) for size in sizes])
    # The draws of all rounds at once: they do not depend on which actions are left, only on how many.
    num_keys = int(np.max(lane[-1] // left)) + 1 if xp is np else len(lane)
    round_keys = xp.moveaxis(random.keys_of(key, len(sizes)), -2, 0)[..., None, :]
    draws = draws_of(
        random.fold_in(round_keys, xp.arange(num_keys)), num_steps(planning_horizon, horizon), _num(search)
    )
    for k in range(len(sizes)):
        of_round = Draws(draws.grasp[:, k], draws.label[:, k])
        search = drawn(search, most_promising(search), left[k], lane, of_round, planning_horizon)
    return search


def _num(search: Search) -> int:
    return search.belief.is_on_table.shape[-1]


def num_steps(planning_horizon: Number, horizon: int) -> int:
    """Beliefs that a rollout moves through after the first, at most."""
    is_known = isinstance(planning_horizon, int | float)
    return max(1, min(int(planning_horizon), horizon) - 1) if is_known else horizon - 1


def num_left(search: Search, size: int) -> Int[Array, " B"]:
    """How many of the actions are drawn from, where so many are left of all."""
    xp = library_of(search.control)
    return xp.minimum(size, xp.maximum(xp.sum(xp.isfinite(search.control[..., 1:]), axis=-1), 1))


def drawn(
    search: Search,
    promising: Int[Array, "B k"],
    num_left: Int[Array, " B"],
    lane: Int[np.ndarray, " L"],
    draws: Draws,
    planning_horizon: Number,
) -> Search:
    """Add one rollout for each lane: lane l has the l-th of the actions that are left, in turn.

    Parameters
    ----------
    search
        Some tables.
    promising
        All actions but FINISH, which has one rollout, and is known; the best first.
    num_left
        How many of them are drawn from.
    lane
        Numbers of the rollouts within their round.
    draws
        Of the round, by number l // num_left, axes (steps, B, numbers): all its actions meet the same draws. The first
        of them is that of the first lane.
    planning_horizon
        Actions of a rollout, ≥ 2.
    """
    xp, (num_tables, num_actions) = library_of(search.rule), search.rule.shape
    turn, left = xp.asarray(lane), num_left[:, None]
    action = xp.take_along_axis(promising, turn % left, axis=-1)
    number = turn // left - lane[0] // left
    table = np.repeat(np.arange(num_tables), len(lane))
    num_keys = draws.grasp.shape[2]
    flat = Draws(*(each.reshape(each.shape[0], num_tables * num_keys, *each.shape[3:]) for each in draws))
    which, rows, own = number.reshape(-1) + num_keys * table, np.arange(len(table)), action.reshape(-1)
    if xp is np:
        rows = np.flatnonzero(_is_searched(search)[table])
    belief, chances = picked((search.belief, search.chances), table[rows])
    found = advantages(search.config, belief, chances, own[rows], flat, which[rows], planning_horizon, search.settings)
    is_own = own[rows, None] == xp.arange(num_actions)
    added = [xp.where(is_own, found[:, None], np.float32(0.0)), is_own.astype(np.float32)]
    total, count = (_by_table(each, table[rows], num_tables, len(lane)) for each in added)
    return replace(search, total=search.total + total, count=search.count + count)


def _is_searched(search: Search) -> Any:
    return (search.belief.steps_to_go > 1) & search.belief.is_on_table.any(axis=-1)


def _by_table(
    values: Float[Array, "R A"], table: Int[np.ndarray, " R"], num_tables: int, num_lanes: int
) -> Float[Array, "B A"]:
    """Sum over the rollouts of each table, of which all are there, or none."""
    xp = library_of(values)
    sums = xp.sum(values.reshape(-1, num_lanes, values.shape[-1]), axis=1)
    if len(sums) == num_tables:
        return sums
    found = np.zeros((num_tables, values.shape[-1]), dtype=np.float32)
    found[table[::num_lanes]] = sums
    return found


def searched_values(
    config: WorldConfig, state: TableState, key: Key, num_rollouts: int, planning_horizon: Number
) -> Float[Array, "*B A"]:
    """Q of each action from a number of rollouts; see `searched` and `values`."""
    batch, num_axes = state.steps_to_go.shape, state.steps_to_go.ndim

    def flat(leaf):
        return leaf.reshape(-1, *leaf.shape[num_axes:])

    states, keys = mapped(flat, state), flat(key)
    xp, num_tables = library_of(states.hides, keys), len(keys)
    size = max(1, LANES // max(num_rollouts // 4, 1)) if xp is np else num_tables
    found = []
    for first in range(0, num_tables, size):
        some = mapped(lambda leaf, at=slice(first, first + size): leaf[at], states)
        horizon = max(2, int(some.steps_to_go.max())) if xp is np else state.horizon
        search = opened(config, some)
        if horizon > 1:
            search = searched(search, keys[first : first + size], num_rollouts, planning_horizon, horizon)
        found.append(values(search))
    found = xp.concatenate(found)
    return found.reshape(*batch, found.shape[-1])


def values(search: Search) -> Float[Array, "B A"]:
    """Q of each action, −∞ where it is impossible.

    An action's mean advantage is shrunk towards that of all actions, as far as `SHRINKAGE` rollouts would.
    """
    is_last = search.belief.steps_to_go == 1
    return library_of(search.rule).where(is_last[..., None], search.rule, _shrunk(search))


def most_promising(search: Search) -> Int[Array, "B k"]:
    """All actions but FINISH, the best first."""
    return 1 + library_of(search.rule).argsort(-_shrunk(search)[..., 1:], axis=-1, stable=True)


def halved(num_rollouts: int, num_actions: int) -> list[int]:
    """Actions that are left in each round of a number of rollouts, halves down to 2."""
    sizes = [min(num_actions - 1, max(2, num_rollouts // 4))]
    while sizes[-1] > 2:
        sizes.append((sizes[-1] + 1) // 2)
    return sizes


def _shrunk(search: Search) -> Float[Array, "B A"]:
    xp, zero, one = library_of(search.total), np.float32(0.0), np.float32(1.0)
    total, count = search.total, search.count
    is_counted = xp.isfinite(search.control) & (np.arange(count.shape[-1]) != FINISH)
    of_all = [xp.sum(xp.where(is_counted, each, zero), axis=-1, keepdims=True) for each in (total, count)]
    mean = of_all[0] / xp.maximum(of_all[1], one)
    added = (total + np.float32(SHRINKAGE) * mean) / (count + np.float32(SHRINKAGE))
    return search.control + xp.where(is_counted, added, zero)
