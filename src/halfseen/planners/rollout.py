"""Q of a fixed rule by rollouts: the value of an action if the rule decides afterwards.

The rule is the myopic look-ahead of `one_step`, π(b) = argmax Q_1(b, ·). The best action by Q^π is far better than that
of π: one policy improvement gives most of the possible gain [BertsekasCastanon1999]_.

A rollout is a trajectory of beliefs b_0, b_1, … that begins with action a_0 and then follows π. Its value is

    Q°(b_0, a_0) + Σ_{t≥1} A°(b_t, a_t),    A°(b, a) = Q°(b, a) − V°(b),    Q°(b, a) = E[R + V°(b')],

with a control variate in place of the rewards: V° lets every object be left or tried once, without a limit on steps,
and Q° is Q_1 for unlimited steps, exact in closed form. The mean is Q^π(b_0, a_0) for any V°; as V° is near V^π, the
advantages A° are small and little noise remains. With one step to go, Q_1 is exact and nothing is drawn. All actions
share the same draws.

Each lane, along the last axis R of arrays, is one trajectory. All rollouts of all tables advance together, one step at
a time; NumPy drops those that are over.
"""

from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from halfseen.arrays import Array, library_of, mapped, record
from halfseen.planners import one_step
from halfseen.planners.belief import known_seeing
from halfseen.planners.one_step import HELD, Beliefs, Chances, Outlook, laid_out, left_price, rule_and_control, table_of
from halfseen.shapes import Bool, Float, Int
from halfseen.world import random
from halfseen.world.actions import FINISH
from halfseen.world.config import WorldConfig
from halfseen.world.random import Key
from halfseen.world.seeing import AssumedSeeing
from halfseen.world.state import TableState

MOST_SETS = 64
"""Largest number of object sets of one table for which precomputing all settings pays off."""
SPARED = 24
"""Number of ended trajectories up to which dropping them does not pay off."""
_ZERO, _ONE, _TINY = np.float32(0.0), np.float32(1.0), np.finfo(np.float32).tiny
Tree = TypeVar("Tree")


def draws_of(key: Key, num_steps: int, num_objects: int) -> Float[Array, "steps draws *K"]:
    """Draw uniform numbers for `num_steps` steps from each key: first for the grasp, then for each object's label."""
    before = [key]
    for _ in range(num_steps - 1):
        before.append(random.fold_in(before[-1], 0))
    xp = library_of(key)
    both = random.keys_of(random.fold_in(xp.stack(before), 1), 2)
    grasp, label = random.uniform(both[..., 0, :], 1), random.uniform(both[..., 1, :], num_objects)
    return xp.moveaxis(xp.concatenate([grasp, label], axis=-1), -1, 1)


def picked(tree: Tree, lanes: Int[Array, " R"]) -> Tree:
    """Select lanes of records."""
    return mapped(lambda leaf: leaf.take(lanes, axis=-1), tree)


class Settings(NamedTuple):
    """Precomputed settings of all subsets of the objects now on one table."""

    bit: Int[np.ndarray, " N"]
    """Bit of each object in the index of a subset; 0 for absent objects."""
    each: Chances
    """Setting of each subset, by index; labels assume that no more has been seen."""

    def of(self, config: WorldConfig, table: Beliefs) -> Chances:
        """Settings of later beliefs of that table."""
        setting = picked(self.each, self.bit @ table.is_there)
        if type(config.seeing) is AssumedSeeing:
            return setting
        return setting._replace(label=one_step.labels_in(config, table, setting.occluded))


def settings_of(config: WorldConfig, table: Beliefs) -> Settings | None:
    """Settings of all subsets of the objects of one table; None for several tables, too many objects, or JAX."""
    if library_of(table.hides) is not np or table.is_there.shape[1] != 1:
        return None
    is_there = table.is_there[:, 0]
    bit = np.where(is_there, 1 << np.maximum(np.cumsum(is_there) - 1, 0), 0)
    num_sets = int(bit.sum()) + 1
    if num_sets > MOST_SETS:
        return None
    every = picked(table, np.zeros(num_sets, dtype=np.int64))
    every = every._replace(is_there=(bit[:, None] & np.arange(num_sets)) > 0)
    return Settings(bit, one_step.setting_of((config,), every))


def looked(config: WorldConfig, table: Beliefs, settings: Settings | None) -> Outlook:
    """Predict the outcomes of one attempt, from precomputed settings if given."""
    return one_step.outlook_of(config, table, None if settings is None else settings.of(config, table))


def successor(
    config: WorldConfig, table: Beliefs, look: Outlook, choice: Int[Array, " R"], draws: Float[Array, "draws R"]
) -> Beliefs:
    """Sample the belief after an attempt, one particle per lane.

    `choice` indexes WASH of each object, then LIFT of each. `draws` are uniform in [0, 1): one for the success of the
    grasp, and one for the label of each object.
    """
    xp, num_objects = library_of(table.is_dirty), len(table.is_there)
    lanes, objects, nodes = (np.arange(num) for num in (len(choice), num_objects, len(table.weights)))
    target, objects = choice % num_objects, objects[:, None]
    is_grasped = draws[0] < look.expected[0][HELD, target, lanes]
    is_target, result = target == objects, is_grasped.astype(np.int32)
    is_moved = is_target & is_grasped
    is_held = is_moved & (choice >= num_objects)
    # Bayes' rule for the grip and every label; drawn outcomes have positive probability, so the floor only guards
    # absent objects.
    chance = xp.maximum(look.expected[0][result, target, lanes], _TINY)
    update = look.likelihood[result, nodes[:, None], target, lanes] / chance
    way, law = xp.where(is_grasped, 1 + target, 0), known_seeing(config)
    hit, says = (xp.where(is_held, each[0, -1], each[0][way, objects, lanes]) for each in (look.hit, look.says))
    is_said = draws[1:] < says
    of_said = xp.maximum(xp.where(is_said, says, _ONE - says), _TINY)
    seen = table.seen
    if type(law) is not AssumedSeeing:
        occluded = xp.where(is_held, _ZERO, look.occluded[way, objects, lanes])
        seen = law.after(occluded, seen, is_said, is_held).astype(np.float32)
    return table._replace(
        is_there=table.is_there & ~(is_moved ^ is_held),
        is_dirty=xp.where(is_said, hit, table.is_dirty - hit) / of_said,
        weights=table.weights * xp.where(is_target, update[:, None], _ONE),
        seen=seen,
        steps_to_go=table.steps_to_go - 1,
    )


def advantages(
    search: "Search",
    which: Int[Array, " R"],
    action: Int[Array, " R"],
    draws: Float[Array, "steps draws R"],
    planning_horizon: int,
) -> Float[Array, " R"]:
    """Sum of the advantages of each trajectory, its value minus Q° of its first action; 0 with one step to go.

    It begins with `action`, WASH or LIFT, at one of the tables; the last of `planning_horizon` ≥ 2 actions is valued by
    Q_1.
    """
    config, (table, look) = search.config, picked((search.table, search.look), which)
    # FINISH is action 0, before these verbs.
    choice = action - 1
    xp, total, done, totals = library_of(table.is_dirty), _ZERO * draws[0, 0], [], []
    lanes, last_step = np.arange(len(choice)), table.steps_to_go - planning_horizon + 1
    goes_on = (table.steps_to_go > 1) & table.is_there.any(axis=0)
    for t in range(len(draws)):
        num = np.count_nonzero(goes_on) if xp is np else len(lanes)
        if num == 0:
            break
        if num < (len(lanes) if t == 0 else min(len(lanes) / 2, len(lanes) - SPARED)):
            keep, over = np.flatnonzero(goes_on), np.flatnonzero(~goes_on)
            done, totals = [*done, lanes[over]], [*totals, total[over]]
            rest = (table, look, choice, draws, lanes, last_step, total, goes_on)
            table, look, choice, draws, lanes, last_step, total, goes_on = picked(rest, keep)
        table = successor(config, table, look, choice, draws[t])
        look = looked(config, table, search.settings)
        choice, gained, is_end = _followed(config, table, look, last_step)
        total = total + xp.where(goes_on, gained, _ZERO)
        goes_on = goes_on & ~is_end
    if not done:
        return total
    return np.concatenate([*totals, total])[np.argsort(np.concatenate([*done, lanes]))]


def _followed(
    config: WorldConfig, table: Beliefs, look: Outlook, last_step: Int[Array, " R"]
) -> tuple[Int[Array, " R"], Float[Array, " R"], Bool[Array, " R"]]:
    """Next action of the rule, its advantage, and whether the trajectory ends with it."""
    values = one_step.rule_and_control(config, table, look)
    xp, best = library_of(values), values[0].argmax(axis=0)
    rule, control = values[:, best, np.arange(len(best))]
    # FINISH, with value 0 here, is best.
    is_finish = rule <= _ZERO
    is_last = (table.steps_to_go == 1) | (table.steps_to_go == last_step)
    worth = xp.where(is_finish, _ZERO, xp.where(is_last, rule, control))
    return best, worth - one_step.control_value(table, look), is_finish | is_last


SHRINKAGE = 8.0
"""Weight, in rollouts, of the mean advantage of all actions in that of one."""
LANES = 1024
"""Approximate number of rollouts that advance together, which fit the cache of a core. It does not change results."""


@record
class Search:
    """Some tables, with the results of the rollouts of each action so far."""

    config: WorldConfig
    table: Beliefs
    look: Outlook
    settings: Settings | None
    """Only for a single table."""
    rule: Float[Array, "B A"]
    """Q_1."""
    control: Float[Array, "B A"]
    """Q°; −∞ if an action is impossible, as in `rule`."""
    total: Float[Array, "B A"]
    """Sum of the advantages over the rollouts of each action."""
    count: Float[Array, "B A"]
    """Number of rollouts of each action."""

    @property
    def values(self) -> Float[Array, "B A"]:
        """Q of each action; −∞ if impossible."""
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
        """All actions except FINISH, whose value is known; the best first."""
        return 1 + library_of(self.rule).argsort(-self.shrunk[..., 1:], axis=-1, stable=True)

    def num_left(self, size: int) -> Int[Array, " B"]:
        """Number of possible actions among `size` remaining ones, at least 1."""
        xp = library_of(self.control)
        return xp.minimum(size, xp.maximum(xp.sum(xp.isfinite(self.control[..., 1:]), axis=-1), 1))


def opened(config: WorldConfig, state: TableState) -> Search:
    """Start a search of tables (one batch axis), before its first rollout."""
    table = table_of(config, state)
    settings = settings_of(config, table)
    look, left = looked(config, table, settings), left_price(config, table)
    rule, control = (laid_out(left, left + values) for values in rule_and_control(config, table, look))
    none = library_of(rule).zeros_like(rule)
    return Search(config, table, look, settings, rule, control, none, none)


def sampled_values(config: WorldConfig, state: TableState, key: Key, num_rollouts: int) -> Float[Array, "S A"]:
    """Value of each of S rollouts of each action of one table.

    It is −∞ if an action is impossible. That of FINISH is exact.
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
        found = advantages(search, np.zeros_like(which), of_each, draws, state.horizon + 1)
        parts.append(found.reshape(len(some), len(actions)))
    drawn_of = dict(zip(actions.tolist(), xp.moveaxis(xp.concatenate(parts), -1, 0), strict=True))
    none = xp.zeros(num_rollouts, dtype=np.float32)
    added = xp.stack([drawn_of.get(action, none) for action in range(num_actions)], axis=-1)
    # Impossible actions stay at −∞, whatever their rollouts gave.
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
    """Add one rollout for each lane: lane l tries remaining action l mod `num_left`.

    `promising` are the actions of each table, the best first, of which `num_left` remain; lanes are numbered within
    their round. Draws are indexed by l // num_left, since all actions of a round share them, starting at that of the
    first lane.
    """
    xp, (num_tables, num_actions) = library_of(search.rule), search.rule.shape
    left, table = num_left[:, None], np.repeat(np.arange(num_tables), len(lane))
    action = xp.take_along_axis(promising, lane % left, axis=-1).reshape(-1)
    number = (lane // left - lane[0] // left).reshape(-1)
    found = advantages(search, table, action, draws[:, :, table, number], planning_horizon)
    is_own = action[:, None] == xp.arange(num_actions)
    added = (xp.where(is_own, found[:, None], np.float32(0.0)), is_own.astype(np.float32))
    total, count = (each.reshape(num_tables, len(lane), num_actions).sum(axis=1) for each in added)
    return replace(search, total=search.total + total, count=search.count + count)


def halved(num_rollouts: int, num_actions: int) -> list[int]:
    """Number of remaining actions in each round of sequential halving, down to 2."""
    sizes = [min(num_actions - 1, max(2, num_rollouts // 4))]
    while sizes[-1] > 2:
        sizes.append((sizes[-1] + 1) // 2)
    return sizes


def num_steps(planning_horizon: int, horizon: int) -> int:
    """Largest number of belief updates of a rollout."""
    return max(1, min(int(planning_horizon), horizon) - 1)


def searched(search: Search, key: Key, num_rollouts: int, planning_horizon: int, horizon: int) -> Search:
    """Add a number of rollouts, focused on the most promising actions.

    Sequential halving [KarninKorenSomekh2013]_: each round adds equally many rollouts of every remaining action, and
    keeps the better half.

    `num_rollouts` is approximate and counts all actions. Tables with fewer than two steps to go need no search. The
    last of `planning_horizon` ≥ 2 actions is valued by Q_1; at most `horizon` steps are to go.
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
