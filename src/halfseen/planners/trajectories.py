"""Trajectories of beliefs that follow the myopic look-ahead: the inner loop of `rollout`.

Each lane is one trajectory. All advance together, a step at a time; with NumPy those that are over are left out.
"""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import Array, library_of, mapped, record
from halfseen.planners.belief import Belief, Grip, known_seeing
from halfseen.planners.one_step import (
    Chances,
    Setting,
    control_value,
    label_in_each,
    outlook_of,
    rule_and_control,
    setting_of,
)
from halfseen.world import random
from halfseen.world.actions import FINISH, ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.number import Number
from halfseen.world.random import Key
from halfseen.world.seeing import AssumedSeeing, label_evidence
from halfseen.world.state import numbered

UNLIMITED = 1_000_000
"""Steps to go that never run out."""

_ZERO = np.float32(0.0)
Tree = TypeVar("Tree")


class Draws(NamedTuple):
    """Uniform draws of the steps of some trajectories."""

    grasp: Float[Array, "*S"]
    label: Float[Array, "*S N"]


def draws_of(key: Key, num_steps: int, num_objects: int) -> Draws:
    """Draws of so many steps from each key, the steps along the first axis."""
    before = [key]
    for _ in range(num_steps - 1):
        before.append(random.fold_in(before[-1], 0))
    both = random.keys_of(random.fold_in(library_of(key).stack(before), 1), 2)
    return Draws(random.uniform(both[..., 0, :]), random.uniform(both[..., 1, :], num_objects))


def picked(tree: Tree, rows: Int[Array, " R"]) -> Tree:
    """Some rows of records, laid out as `rows_last` has it."""
    return mapped(lambda leaf: _rows_of(leaf, rows), tree)


def _rows_of(values: Array, rows: Int[Array, " R"]) -> Array:
    if values.ndim == 1:
        return values[rows]
    last, first = _axes(values.ndim)
    return values.transpose(last).take(rows, axis=-1).transpose(first)


def rows_last(values: Array) -> Array:
    """The same, laid out in memory with the rows last, so that loops are as long as there are rows."""
    if library_of(values) is not np:
        return values
    last, first = _axes(values.ndim)
    return np.ascontiguousarray(values.transpose(last)).transpose(first)


@lru_cache(maxsize=16)
def _axes(num_axes: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Orders of axes that put the first one last, and back."""
    return (*range(1, num_axes), 0), (num_axes - 1, *range(num_axes - 1))


MOST_SETS = 64
"""Sets of objects of one table for which it pays to find at once what each makes of attempts."""


@record
class Settings:
    """What each set of the objects that stand on one table now would make of attempts and labels."""

    bit: Int[Array, " N"]
    """What each object adds to the number of a set; 0 for what is not there."""
    each: Setting
    """Of each set, by its number."""

    def of(self, config: WorldConfig, belief: Belief) -> Setting:
        """Those of some beliefs of that table, from now on."""
        number = belief.is_on_table @ self.bit
        if type(config.seeing) is AssumedSeeing:
            return Setting(*(_rows_of(leaf, number) for leaf in self.each))
        occluded, _, _, *others = self.each
        occluded = _rows_of(occluded, number)
        label = label_in_each(config, belief.seen, occluded)
        return Setting(occluded, *label, *(_rows_of(leaf, number) for leaf in others))


def settings_of(config: WorldConfig, belief: Belief) -> Settings | None:
    """Settings of all sets of the objects of one table; None of several tables, of too many objects, and under JAX."""
    if library_of(belief.hides) is not np or len(belief.is_on_table) != 1:
        return None
    is_there = belief.is_on_table[0]
    bit = np.where(is_there, 1 << np.maximum(np.cumsum(is_there) - 1, 0), 0)
    num_sets = int(bit.sum()) + 1
    if num_sets > MOST_SETS:
        return None
    sets = (np.arange(num_sets)[:, None] & bit) > 0
    every = replace(picked(belief, np.zeros(num_sets, dtype=np.int64)), is_on_table=rows_last(sets))
    return Settings(bit, setting_of(config, every))


def successor(config: WorldConfig, belief: Belief, chances: Chances, action: Int[Array, " R"], draws: Draws) -> Belief:
    """What is believed after an attempt to WASH or LIFT, by draws: one particle's future each.

    Parameters
    ----------
    config
        The world that is believed in.
    belief, chances
        Before the attempt, and what may follow it.
    action
        What is attempted.
    draws
        Uniform in [0, 1): whether it is grasped, and what the look at each object says.
    """
    xp, num_objects = library_of(belief.hides), belief.is_on_table.shape[-1]
    actions, rows = ActionSpace(num_objects), np.arange(len(action))
    verb, target = actions.verb(action), actions.target(action)
    is_target = numbered(target, num_objects)
    is_grasped = draws.grasp < chances.probability[rows, target]
    is_moved = is_target & is_grasped[..., None]
    is_held = is_moved & (verb == Verb.LIFT)[..., None]
    failed = chances.failed[rows, target]
    evidence = rows_last(xp.where(is_grasped[..., None], xp.log(-xp.expm1(failed)), failed))
    added = xp.where(is_target[..., None], evidence[..., None, :], _ZERO)
    is_on_table = belief.is_on_table & ~(is_moved & (verb == Verb.WASH)[..., None])
    grip = Grip(belief.grip.mean, belief.grip.log_weights + added)
    way = (rows, xp.where(is_grasped, 1 + target, 0))
    log_odds, seen = _looked(config, belief, is_on_table, chances, is_held, way, draws.label)
    return Belief(belief.hides, is_on_table, log_odds, seen, grip, belief.steps_to_go - 1)


def _looked(
    config: WorldConfig,
    belief: Belief,
    is_there: Bool[Array, "R N"],
    chances: Chances,
    is_held: Bool[Array, "R N"],
    way: tuple[Int[Array, " R"], Int[Array, " R"]],
    draws: Float[Array, "R N"],
) -> tuple[Float[Array, "R N"], Float[Array, "R N"]]:
    """Log-odds of DIRTY, and what was seen, after a look at what is hidden in one of the ways of `Chances`."""
    xp, law = library_of(draws), known_seeing(config)
    if_dirty, if_clean = (xp.where(is_held, each[..., -1, :], rows_last(each[way])) for each in chances.label)
    chance = if_clean + chances.is_dirty * (if_dirty - if_clean)
    says_dirty = rows_last(draws) < chance
    update = label_evidence(if_dirty, if_clean, says_dirty)
    log_odds = belief.log_odds + xp.where(is_there, update, _ZERO)
    if type(law) is AssumedSeeing:
        return log_odds, belief.seen
    occluded = xp.where(is_held, _ZERO, rows_last(chances.occluded[way]))
    seen = law.after(occluded, belief.seen, says_dirty, is_held)
    return log_odds, xp.where(is_there, seen, belief.seen)


def advantages(
    config: WorldConfig,
    belief: Belief,
    chances: Chances,
    action: Int[Array, " R"],
    draws: Draws,
    which: Int[Array, " R"],
    planning_horizon: Number,
    settings: Settings | None = None,
) -> Float[Array, " R"]:
    """Sum of the advantages of each trajectory, its worth less Q° of its first action.

    Parameters
    ----------
    config
        The world that is believed in.
    belief, chances
        Where each begins, at least two steps to go.
    action
        Its first action, WASH or LIFT.
    draws
        Of as many steps as any may take, along the first axis.
    which
        Number of its draws.
    planning_horizon
        Actions, ≥ 2, the last of which is worth Q_1.
    settings
        Of the table, if all begin on one.
    """
    xp = library_of(belief.hides, draws.grasp)
    last_step = belief.steps_to_go - planning_horizon + 1
    goes_on = belief.steps_to_go > 1
    lanes, done, totals = np.arange(len(action)), [], []
    total = xp.zeros(len(action), dtype=np.float32)
    for grasp, label in zip(*draws, strict=True):
        if xp is np and not goes_on.any():
            break
        belief = successor(config, belief, chances, action, Draws(grasp[which], label[which]))
        action, gained, is_end, chances = _followed(config, belief, last_step, settings)
        total = total + xp.where(goes_on, gained, _ZERO)
        goes_on = goes_on & ~is_end
        if xp is np and np.count_nonzero(goes_on) < min(len(goes_on) / 2, len(goes_on) - SPARED):
            keep, over = np.flatnonzero(goes_on), np.flatnonzero(~goes_on)
            done, totals = [*done, lanes[over]], [*totals, total[over]]
            lanes, total, goes_on, action, which, last_step = (
                each[keep] for each in (lanes, total, goes_on, action, which, last_step)
            )
            belief, chances = picked((belief, chances), keep)
    if not done:
        return total
    order = np.argsort(np.concatenate([*done, lanes]))
    return np.concatenate([*totals, total])[order]


SPARED = 24
"""Trajectories that are over for which it does not pay to leave them out."""


def _followed(
    config: WorldConfig, belief: Belief, last_step: Int[Array, " R"], settings: Settings | None
) -> tuple[Int[Array, " R"], Float[Array, " R"], Bool[Array, " R"], Chances]:
    """What the rule does next, its advantage, and whether the trajectory ends with it."""
    setting = None if settings is None else settings.of(config, belief)
    xp, outlook = library_of(belief.hides), outlook_of(config, belief, setting)
    rule, control = rule_and_control(config, belief, outlook)
    is_last = (belief.steps_to_go == 1) | (belief.steps_to_go == last_step)
    action, rows = xp.argmax(rule, axis=-1), np.arange(len(last_step))
    # On a table that is cleared both are 0.
    worth = xp.where(is_last, rule[rows, action], control[rows, action])
    return action, worth - control_value(belief, outlook), (action == FINISH) | is_last, outlook.chances
