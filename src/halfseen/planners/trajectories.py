"""Trajectories of beliefs that follow the look one step ahead: the inner loop of `rollout`.

Each lane, along the last axis R of all arrays here, is one trajectory. All advance together, a step at a time; with
NumPy those that are over are left out.
"""

from typing import NamedTuple, TypeVar

import numpy as np

from halfseen.arrays import Array, library_of, mapped
from halfseen.planners import one_step
from halfseen.planners.belief import known_seeing
from halfseen.planners.one_step import HELD, Outlook, Setting, Table
from halfseen.shapes import Bool, Float, Int
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.random import Key
from halfseen.world.seeing import AssumedSeeing

MOST_SETS = 64
"""Sets of objects of one table for which it pays to find at once what each makes of attempts."""
SPARED = 24
"""Trajectories that are over for which it does not pay to leave them out."""
_ZERO, _ONE, _TINY = np.float32(0.0), np.float32(1.0), np.finfo(np.float32).tiny
Tree = TypeVar("Tree")


def draws_of(key: Key, num_steps: int, num_objects: int) -> Float[Array, "steps draws *K"]:
    """Draw uniformly for so many steps from each key: first for the grasp, then for the label of each object."""
    before = [key]
    for _ in range(num_steps - 1):
        before.append(random.fold_in(before[-1], 0))
    xp = library_of(key)
    both = random.keys_of(random.fold_in(xp.stack(before), 1), 2)
    grasp, label = random.uniform(both[..., 0, :], 1), random.uniform(both[..., 1, :], num_objects)
    return xp.moveaxis(xp.concatenate([grasp, label], axis=-1), -1, 1)


def picked(tree: Tree, lanes: Int[Array, " R"]) -> Tree:
    """Some lanes of records."""
    return mapped(lambda leaf: leaf.take(lanes, axis=-1), tree)


class Settings(NamedTuple):
    """What each set of the objects that stand on one table now would make of attempts and labels."""

    bit: Int[np.ndarray, " N"]
    """What each object adds to the number of a set; 0 for what is not there."""
    each: Setting
    """Of each set, by its number; labels as if nothing more had been seen."""

    def of(self, config: WorldConfig, table: Table) -> Setting:
        """Those of some beliefs of that table, from now on."""
        setting = picked(self.each, self.bit @ table.is_there)
        if type(config.seeing) is AssumedSeeing:
            return setting
        return setting._replace(label=one_step.labels_in(config, table, setting.occluded))


def settings_of(config: WorldConfig, table: Table) -> Settings | None:
    """Settings of all sets of the objects of one table; None of several tables, of too many objects, and under JAX."""
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


def looked(config: WorldConfig, table: Table, settings: Settings | None) -> Outlook:
    """Look one attempt ahead; by how the objects stand, where that is known."""
    return one_step.outlook_of(config, table, None if settings is None else settings.of(config, table))


def successor(
    config: WorldConfig, table: Table, look: Outlook, choice: Int[Array, " R"], draws: Float[Array, "draws R"]
) -> Table:
    """What is believed after an attempt, by draws: one particle's future each.

    `choice` is WASH of each object in turn, then LIFT of each. `draws` are uniform in [0, 1): whether it is
    grasped, and what the look at each object says.
    """
    xp, num_objects = library_of(table.is_dirty), len(table.is_there)
    lanes, objects, nodes = (np.arange(num) for num in (len(choice), num_objects, len(table.weights)))
    target, objects = choice % num_objects, objects[:, None]
    is_grasped = draws[0] < look.expected[0][HELD, target, lanes]
    is_target, result = target == objects, is_grasped.astype(np.int32)
    is_moved = is_target & is_grasped
    is_held = is_moved & (choice >= num_objects)
    # By Bayes, of the grip and of every label; what was drawn was possible, so that the least of floats only guards
    # what is not there.
    chance = xp.maximum(look.expected[0][result, target, lanes], _TINY)
    update = look.likelihood[result, nodes[:, None], target, lanes] / chance
    way = xp.where(is_grasped, 1 + target, 0)
    hit, says = (xp.where(is_held, each[0, -1], each[0][way, objects, lanes]) for each in (look.hit, look.says))
    is_said = draws[1:] < says
    of_said = xp.maximum(xp.where(is_said, says, _ONE - says), _TINY)
    return table._replace(
        is_there=table.is_there & ~(is_moved ^ is_held),
        is_dirty=xp.where(is_said, hit, table.is_dirty - hit) / of_said,
        weights=table.weights * xp.where(is_target, update[:, None], _ONE),
        seen=_seen(config, table, look, way, is_held, is_said),
        steps_to_go=table.steps_to_go - 1,
    )


def _seen(
    config: WorldConfig,
    table: Table,
    look: Outlook,
    way: Int[Array, " R"],
    is_held: Bool[Array, "N R"],
    is_said: Bool[Array, "N R"],
) -> Float[Array, "N R"]:
    """What was seen after a look at what is hidden in some way."""
    xp, law = library_of(way), known_seeing(config)
    if type(law) is AssumedSeeing:
        return table.seen
    occluded = look.occluded[way, np.arange(len(table.seen))[:, None], np.arange(len(way))]
    return law.after(xp.where(is_held, _ZERO, occluded), table.seen, is_said, is_held).astype(np.float32)


def advantages(
    config: WorldConfig,
    table: Table,
    look: Outlook,
    choice: Int[Array, " R"],
    draws: Float[Array, "steps draws R"],
    planning_horizon: int,
    settings: Settings | None,
) -> Float[Array, " R"]:
    """Sum of the advantages of each trajectory, its worth less Q° of its first action; 0 where it has one step to go.

    `choice` is the first action, as `successor` has it, and the last of `planning_horizon` ≥ 2 actions is worth
    Q_1; `settings` are those of the table, if all begin on one.
    """
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
        look = looked(config, table, settings)
        choice, gained, is_end = _followed(config, table, look, last_step)
        total = total + xp.where(goes_on, gained, _ZERO)
        goes_on = goes_on & ~is_end
    if not done:
        return total
    return np.concatenate([*totals, total])[np.argsort(np.concatenate([*done, lanes]))]


def _followed(
    config: WorldConfig, table: Table, look: Outlook, last_step: Int[Array, " R"]
) -> tuple[Int[Array, " R"], Float[Array, " R"], Bool[Array, " R"]]:
    """What the rule does next, its advantage, and whether the trajectory ends with it."""
    values = one_step.rule_and_control(config, table, look)
    xp, best = library_of(values), values[0].argmax(axis=0)
    rule, control = values[:, best, np.arange(len(best))]
    # Nothing is better than to finish, which is worth 0 here.
    is_finish = rule <= _ZERO
    is_last = (table.steps_to_go == 1) | (table.steps_to_go == last_step)
    worth = xp.where(is_finish, _ZERO, xp.where(is_last, rule, control))
    return best, worth - one_step.control_value(table, look), is_finish | is_last
