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

import numpy as np

from halfseen.arrays import Array, library_of, mapped, record
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import Outlook, Table, laid_out, left_price, rule_and_control, table_of
from halfseen.planners.trajectories import Settings, advantages, draws_of, looked, picked, settings_of
from halfseen.shapes import Float, Int
from halfseen.world import random
from halfseen.world.actions import FINISH
from halfseen.world.config import WorldConfig
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
    table: Table
    look: Outlook
    settings: Settings | None
    """Of a table alone."""
    rule: Float[Array, "B A"]
    """Q_1."""
    control: Float[Array, "B A"]
    """Q°; −∞ where an action is impossible, as in `rule`."""
    total: Float[Array, "B A"]
    """Sum of the advantages over the rollouts of each action."""
    count: Float[Array, "B A"]
    """int of rollouts of each action."""

    @property
    def values(self) -> Float[Array, "B A"]:
        """Q of each action, −∞ where it is impossible."""
        is_last = (self.table.steps_to_go == 1)[:, None]
        return library_of(self.rule).where(is_last, self.rule, self.shrunk)

    @property
    def shrunk(self) -> Float[Array, "B A"]:
        """Q as if no step were the last: mean advantages, shrunk towards that of all actions by `SHRINKAGE`."""
        xp, zero = library_of(self.total), np.float32(0.0)
        is_counted = xp.isfinite(self.control) & (np.arange(self.count.shape[-1]) != FINISH)
        total, count = (xp.where(is_counted, each, zero) for each in (self.total, self.count))
        mean = total.sum(axis=-1, keepdims=True) / xp.maximum(count.sum(axis=-1, keepdims=True), np.float32(1.0))
        added = (total + np.float32(SHRINKAGE) * mean) / (count + np.float32(SHRINKAGE))
        return self.control + xp.where(is_counted, added, zero)

    @property
    def promising(self) -> Int[Array, "B k"]:
        """All actions but FINISH, which has one rollout, and is known; the best first."""
        return 1 + library_of(self.rule).argsort(-self.shrunk[..., 1:], axis=-1, stable=True)

    def num_left(self, size: int) -> Int[Array, " B"]:
        """How many actions are drawn from, where so many are left of all."""
        xp = library_of(self.control)
        return xp.minimum(size, xp.maximum(xp.sum(xp.isfinite(self.control[..., 1:]), axis=-1), 1))


def opened(config: WorldConfig, state: TableState) -> Search:
    """A search of tables (one axis of them) before its first rollout."""
    table = table_of(belief_of(config, state))
    settings = settings_of(config, table)
    look, left = looked(config, table, settings), left_price(config, table)
    rule, control = (laid_out(left, left + values) for values in rule_and_control(config, table, look))
    none = library_of(rule).zeros_like(rule)
    return Search(config, table, look, settings, rule, control, none, none)


def rolled_out(
    search: Search,
    table: Int[Array, " R"],
    action: Int[Array, " R"],
    draws: Float[Array, "steps draws R"],
    planning_horizon: int,
) -> Float[Array, " R"]:
    """Advantages of a rollout of each of some actions, WASH or LIFT, each at one of the tables."""
    begin = picked((search.table, search.look), table)
    # These verbs follow on FINISH.
    return advantages(search.config, *begin, action - 1, draws, planning_horizon, search.settings)


def sampled_values(config: WorldConfig, state: TableState, key: Key, num_rollouts: int) -> Float[Array, "S A"]:
    """Worth of each of S rollouts of each action of one table.

    It is −∞ where an action is impossible. FINISH has one rollout, and its worth is exact.
    """
    search = opened(config, mapped(lambda leaf: library_of(leaf).asarray(leaf)[None], state))
    xp, (num_actions,) = library_of(search.control), search.control.shape[1:]
    actions, num_objects = np.arange(1, num_actions), len(search.table.is_there)
    if xp is np:
        actions = actions[np.isfinite(search.control[0, 1:])]
    keys, size, parts = random.keys_of(key, num_rollouts), max(1, LANES // max(len(actions), 1)), []
    for some in (keys[k : k + size] for k in range(0, num_rollouts, size)):
        which, of_each = np.repeat(np.arange(len(some)), len(actions)), xp.asarray(np.tile(actions, len(some)))
        draws = draws_of(some, state.horizon - 1, num_objects)[..., which]
        found = rolled_out(search, np.zeros_like(which), of_each, draws, state.horizon + 1)
        parts.append(found.reshape(len(some), len(actions)))
    drawn_of = dict(zip(actions.tolist(), xp.moveaxis(xp.concatenate(parts), -1, 0), strict=True))
    none = xp.zeros(num_rollouts, dtype=np.float32)
    added = xp.stack([drawn_of.get(action, none) for action in range(num_actions)], axis=-1)
    # What is impossible stays so, whatever came of following it.
    worth = xp.where(xp.isfinite(search.control), search.control + added, search.control)
    return xp.where((search.table.steps_to_go == 1)[:, None], search.rule, worth)


def drawn(
    search: Search,
    promising: Int[Array, "B k"],
    num_left: Int[Array, " B"],
    lane: Int[np.ndarray, " L"],
    draws: Float[Array, "steps draws B numbers"],
    planning_horizon: int,
) -> Search:
    """Add one rollout for each lane: lane l has the l-th of the actions that are left, in turn.

    `promising` are the actions of each table, the best first, of which so many are left, and lanes are numbered
    within their round. Draws go by l // num_left, as all actions of a round meet the same; the first of them is
    that of the first lane.
    """
    xp, (num_tables, num_actions) = library_of(search.rule), search.rule.shape
    left, table = num_left[:, None], np.repeat(np.arange(num_tables), len(lane))
    action = xp.take_along_axis(promising, lane % left, axis=-1).reshape(-1)
    number = (lane // left - lane[0] // left).reshape(-1)
    found = rolled_out(search, table, action, draws[:, :, table, number], planning_horizon)
    is_own = action[:, None] == xp.arange(num_actions)
    added = (xp.where(is_own, found[:, None], np.float32(0.0)), is_own.astype(np.float32))
    total, count = (each.reshape(num_tables, len(lane), num_actions).sum(axis=1) for each in added)
    return replace(search, total=search.total + total, count=search.count + count)


def halved(num_rollouts: int, num_actions: int) -> list[int]:
    """Actions that are left in each round of a number of rollouts, halves down to 2."""
    sizes = [min(num_actions - 1, max(2, num_rollouts // 4))]
    while sizes[-1] > 2:
        sizes.append((sizes[-1] + 1) // 2)
    return sizes


def num_steps(planning_horizon: int, horizon: int) -> int:
    """Beliefs that a rollout moves through after the first, at most."""
    return max(1, min(int(planning_horizon), horizon) - 1)


def searched(search: Search, key: Key, num_rollouts: int, planning_horizon: int, horizon: int) -> Search:
    """Add a number of rollouts, most of them of the actions that promise most.

    Sequential halving [KarninKorenSomekh2013]_: each round adds equally many rollouts of every action that is left,
    and the better half stays.

    So many rollouts, about, are those of all actions together. Where a table has fewer than two steps to go,
    nothing is to be searched. The last of `planning_horizon` ≥ 2 actions is worth Q_1; at most `horizon` steps are
    to go.
    """
    sizes = halved(num_rollouts, search.rule.shape[-1])
    xp, lane = library_of(search.rule), np.arange(max(sizes[0], round(num_rollouts / len(sizes))))
    left = xp.stack([search.num_left(size) for size in sizes])
    # The draws of all rounds at once: they do not depend on which actions are left, only on how many.
    num_keys = int(np.max(lane[-1] // left)) + 1 if xp is np else len(lane)
    round_keys = xp.moveaxis(random.keys_of(key, len(sizes)), -2, 0)[..., None, :]
    draws = draws_of(
        random.fold_in(round_keys, xp.arange(num_keys)),
        num_steps(planning_horizon, horizon),
        len(search.table.is_there),
    )
    for k in range(len(sizes)):
        search = drawn(search, search.promising, left[k], lane, draws[:, :, k], planning_horizon)
    return search


def searched_values(
    config: WorldConfig, state: TableState, key: Key, num_rollouts: int, planning_horizon: int
) -> Float[Array, "*B A"]:
    """Q of each action from a number of rollouts; see `searched`."""
    batch, num_axes = state.steps_to_go.shape, state.steps_to_go.ndim
    states, keys = mapped(lambda leaf: leaf.reshape(-1, *leaf.shape[num_axes:]), (state, key))
    xp, found = library_of(state.hides, key), []
    size = max(1, LANES // max(num_rollouts // 4, 1)) if xp is np else len(keys)
    for first in range(0, len(keys), size):
        some, of_some = mapped(lambda leaf, at=slice(first, first + size): leaf[at], (states, keys))
        horizon = max(2, int(some.steps_to_go.max())) if xp is np else state.horizon
        search = opened(config, some)
        if horizon > 1:
            search = searched(search, of_some, num_rollouts, planning_horizon, horizon)
        found.append(search.values)
    values = xp.concatenate(found)
    return values.reshape(*batch, values.shape[-1])
