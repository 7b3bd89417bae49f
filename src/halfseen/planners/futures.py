"""Futures of a table: what is hidden is drawn from the belief, then played, whichever robot works at it.

Where `rollout` moves a belief, a future here moves the world itself, so that all that the transition knows (robots,
times, prices) counts. Nothing that is truly hidden is read: attributes and grips are drawn as `belief` has them, and
labels by their probabilities given what is known.

Multi-agent rollout: each action of the robot that decides is tried in such futures, in which all robots, this one
included, go on by a rule; the others' turns to deviate from it come when they decide. To improve a rule one robot at a
time costs as many tries as the robots have actions, added up and not multiplied [Bertsekas2021]_.
"""

from dataclasses import field, replace
from typing import Any, TypeVar

import numpy as np

from halfseen.arrays import STATIC, Array, at, chosen, expit, library_of, mapped, record, stacked
from halfseen.errors import ArgumentError
from halfseen.planners.belief import grip_posterior, known_seeing, latent_at
from halfseen.shapes import Bool, Float, Int
from halfseen.world import random
from halfseen.world.actions import WAIT, Verb, possible_actions
from halfseen.world.attempts import attempted
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, Policy
from halfseen.world.random import Key
from halfseen.world.seeing import Glimpse, KnownSeeing, LookOutcome, labelled
from halfseen.world.state import HiddenState, Pending, Robots, TableState, occlusion
from halfseen.world.transition import step, until_out_s

NUM_PROPOSALS = 16
"""Attempts drawn for each robot that is at work; one of those that have not yet ended is taken."""
NUM_FUTURES = 32
Tree = TypeVar("Tree")


@record
class ForeseenSeeing:
    """Labels by the probabilities of a law, given the truth and what is known: no latent variable is needed."""

    law: KnownSeeing

    def draw_latent(self, num_objects: int, key: Key) -> None:
        """No latent variable: what persists is in `Glimpse.seen`."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], latent: None, key: Key
    ) -> LookOutcome:
        """Label each object once."""
        return labelled(self.law, glimpse, log_odds, is_dirty, key)


def spread(tree: Tree, num: int, axis: int) -> Tree:
    """Records as often as said, along a new axis."""

    def each(leaf: Array) -> Array:
        xp, shape = library_of(leaf), np.shape(leaf)
        return xp.broadcast_to(xp.expand_dims(leaf, axis), (*shape[:axis], num, *shape[axis:]))

    return mapped(each, tree)


def imagined(config: WorldConfig, state: TableState, key: Key) -> HiddenState:
    """Draw what is hidden of tables, given all that is seen.

    Of several robots, too, how what they are at will end: for each, `NUM_PROPOSALS` attempts are drawn, grip and all,
    as if begun on the table as it is now; one of those that last longer than the robot has been at it is taken
    (rejection sampling). If none does, the longest is, and ends at once. Whether a robot will drop out is drawn afresh,
    as a constant hazard remembers nothing.
    """
    if state.robots is None:
        return _imagined_table(config, state, key)
    table_key, robots_key = random.split(key)
    hidden, robots = _imagined_table(config, state, table_key), state.robots
    each = [_pending(config, state, robots, k, random.fold_in(robots_key, k)) for k in range(config.num_robots)]
    pending = stacked([of_robot for of_robot, _ in each], axis=state.steps_to_go.ndim)
    xp, latent = library_of(robots.is_busy), hidden.grasp_latent
    is_at_object = robots.is_busy & (robots.verb > 0) & (robots.verb != WAIT)
    is_its = is_at_object[..., None] & (xp.arange(state.num_objects) == robots.target[..., None])
    for k, (_, offset) in enumerate(each):
        latent = mapped(lambda all_of, own, k=k: xp.where(is_its[..., k, :], own[..., None], all_of), latent, offset)
    until_s = until_out_s(config, random.fold_in(robots_key, config.num_robots))
    return replace(hidden, grasp_latent=latent, pending=pending, until_out_s=until_s)


def _imagined_table(config: WorldConfig, state: TableState, key: Key) -> HiddenState:
    dirty_key, grip_key = random.split(key)
    is_dirty = random.uniform(dirty_key, state.num_objects) < expit(state.log_odds)
    node = random.categorical(grip_key, grip_posterior(config, state).log_weights)
    return HiddenState(is_dirty, latent_at(config, node), None)


def _pending(config: WorldConfig, state: TableState, robots: Robots, robot: int, key: Key) -> tuple[Pending, Any]:
    """How what one robot carries out will end (`Pending` without the axis of robots), and the grip of its object."""
    assert state.decider is not None
    xp, never, num_axes = library_of(robots.is_busy), np.float32(np.inf), state.decider.ndim
    verb, target, since_s, is_busy = (
        each[..., robot] for each in (robots.verb, robots.target, robots.since_s, robots.is_busy)
    )
    is_wait, occluded = verb == WAIT, occlusion(state)
    alone = replace(state, robots=None, workspace=None)
    # To the table, who waits does nothing, as who finishes.
    begun = (alone, xp.where(is_wait, Verb.FINISH, verb), target, occluded)
    tables, verbs, targets, occlusions = spread(begun, NUM_PROPOSALS, num_axes)
    grip_key, attempt_key = random.split(random.keys_of(key, NUM_PROPOSALS))
    world = config.as_robot(robot)
    drawn = _imagined_table(world, tables, grip_key)
    tried = attempted(world, tables, drawn, verbs, targets, attempt_key, occlusions)
    duration_s = (world.transport_s + tried.duration_s) / config.speed[robot]
    # Of two that end at once the lower robot ends first, so that a higher one may be at its end.
    is_later = (robot > state.decider)[..., None]
    goes_on = (duration_s > since_s[..., None]) | ((duration_s == since_s[..., None]) & is_later)
    # They are alike before they are looked at: the first that goes on is as good as any.
    first = xp.where(xp.any(goes_on, axis=-1), xp.argmax(goes_on, axis=-1), xp.argmax(duration_s, axis=-1))
    chosen_s = at(duration_s, first)
    left_s = xp.where(is_wait, never, xp.maximum(chosen_s - since_s, np.float32(0.0)))
    hides = xp.take_along_axis(tried.hides, first[..., None, None, None], axis=-3)[..., 0, :, :]
    pending = Pending(
        left_s=xp.where(is_busy, left_s, never),
        duration_s=chosen_s,
        is_held=at(tried.is_held, first),
        occlusion=at(occluded, target),
        hides=hides,
        is_moved=hides != state.hides,
    )
    return pending, mapped(lambda offset: at(at(offset, targets), first), drawn.grasp_latent)


def less_luck(
    config: WorldConfig, before: TableState, after: TableState, hidden: HiddenState, is_over: Bool[Array, "*B"]
) -> Float[Array, "*B"]:
    """What is to be added to the reward of a stage so that hidden attributes count as far as they are known.

    Whether an attempt holds tells nothing of DIRTY, so that a stage's rewards are expected to be the same: only their
    noise falls (Rao–Blackwell).
    """
    xp, is_dirty, zero = library_of(is_over), hidden.is_dirty, np.float32(0.0)
    washed = config.reward_wash_dirty - config.reward_wash_clean
    is_washed, is_left = before.is_on_table & ~after.is_on_table, after.is_on_table & is_over[..., None]
    of_washed = xp.sum(xp.where(is_washed, expit(before.log_odds) - is_dirty, zero), axis=-1)
    of_left = xp.sum(xp.where(is_left, expit(after.log_odds) - is_dirty, zero), axis=-1)
    return washed * of_washed + config.reward_dirty_left * of_left


def future_rewards(
    config: WorldConfig,
    state: TableState,
    policy: Policy,
    key: Key,
    num_futures: int,
    tried: Bool[Array, "*B A"] | None = None,
) -> Float[Array, "*B S A"]:
    """Reward to the trajectory's end of each action followed by a policy, in each of S futures; −∞ if not tried.

    All actions meet the same hidden truth and the same draws.

    `policy` decides ever after, for all robots; `tried` says which of the possible actions are tried, by default
    all.
    """
    xp, num_axes = library_of(state.is_on_table), state.steps_to_go.ndim
    wanted: Any = possible_actions(state) if tried is None else tried
    hidden_key, world_key, policy_key = random.split(random.keys_of(key, num_futures), 3)
    states, is_tried = spread((state, wanted), num_futures, num_axes)
    hidden = imagined(config, states, hidden_key)
    rows = np.nonzero(is_tried) if xp is np else tuple(xp.indices(is_tried.shape).reshape(is_tried.ndim, -1))
    begin = mapped(lambda leaf: leaf[rows[:-1]], (states, hidden, world_key, policy_key))
    # Labels come from what is known, and no longer from what is hidden.
    foreseen = replace(config, seeing=ForeseenSeeing(known_seeing(config)))
    total = _played(foreseen, *begin, rows[-1].astype(np.int32), policy)
    if xp is not np:
        return xp.where(is_tried, total.reshape(is_tried.shape), np.float32(-np.inf))
    found = np.full(is_tried.shape, -np.inf, dtype=np.float32)
    found[rows] = total
    return found


def _played(
    config: WorldConfig,
    state: TableState,
    hidden: HiddenState,
    world_key: Key,
    policy_key: Key,
    action: Int[Array, " R"],
    policy: Policy,
) -> Float[Array, " R"]:
    """What each row earns to its end; in NumPy, rows that are over are left out of what is computed."""
    xp = library_of(state.is_on_table)
    total, goes_on, number = (
        xp.zeros(len(action), dtype=np.float32),
        xp.ones(len(action), dtype=bool),
        np.arange(len(action)),
    )
    for t in range(config.num_stages):
        after, of_hidden, outcome = step(config, state, hidden, action, random.fold_in(world_key, t))
        reward = outcome.reward + less_luck(config, state, after, of_hidden, outcome.is_over)
        if xp is np:
            total = total + np.bincount(number, reward, len(total)).astype(np.float32)
            rows = (after, of_hidden, number, world_key, policy_key)
            rows = mapped(lambda leaf, kept=~outcome.is_over: leaf[kept], rows)
            state, hidden, number, world_key, policy_key = rows
            if not len(number):
                break
        else:
            total = total + xp.where(goes_on, reward, np.float32(0.0))
            state, hidden = chosen(goes_on, (after, of_hidden), (state, hidden))
            goes_on = goes_on & ~outcome.is_over
        action = policy.decide(state, random.fold_in(policy_key, t)).action
    return total


@record
class RolloutPolicy:
    """Takes the action that a rule of all robots, followed ever after, makes worth most.

    It leaves the rule's own action only for one that did better over the same futures by `caution` standard errors.

    Parameters
    ----------
    config
        The world and the robots that it believes in.
    rule
        What all robots follow afterwards.
    num_futures
        Futures in which each action is tried, ≥ 2.
    caution
        Standard errors by which another action must be better than the rule's.

    Raises
    ------
    ArgumentError
        `num_futures` is below 2.
    """

    config: WorldConfig
    rule: Policy
    num_futures: int = field(default=NUM_FUTURES, metadata=STATIC)
    caution: float | Array = 1.0

    def __post_init__(self) -> None:
        if self.num_futures < 2:
            raise ArgumentError(
                f"num_futures is {self.num_futures}; give at least 2, as their scatter tells how sure a gain is"
            )

    @property
    def num_robots(self) -> int:
        """K."""
        return self.config.num_robots

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table; the futures draw from `key` (the probability of a choice is not known)."""
        future_key, rule_key = random.split(key)
        by_rule = self.rule.decide(state, rule_key).action
        rewards = future_rewards(self.config, state, self.rule, future_key, self.num_futures)
        xp, is_possible = library_of(rewards), possible_actions(state)
        # What is impossible is worth −∞ in every future, which no mean is to be made of.
        rewards = xp.where(is_possible[..., None, :], rewards, np.float32(0.0))
        gained = rewards - at(rewards, by_rule[..., None])[..., None]
        error = xp.std(gained, axis=-2) / np.float32(np.sqrt(self.num_futures - 1.0))
        gain = xp.mean(gained, axis=-2) - self.caution * error
        promise = xp.where(is_possible, gain, np.float32(-np.inf))
        best = xp.argmax(promise, axis=-1)
        action = xp.where(at(promise, best) > 0.0, best, by_rule).astype(np.int32)
        return Decision(action, xp.full(action.shape, np.nan, dtype=np.float32))
