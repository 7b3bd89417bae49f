"""Sampled futures of a table: the hidden state is drawn from the belief, then simulated, for one robot or a team.

Unlike `rollout`, which simulates beliefs, a future simulates the world itself, with all effects of the transition
(robots, times, prices). It never reads the true hidden state: attributes and grips are drawn from the posterior of
`belief`, and labels from their probabilities given the observations.

Multi-agent rollout: each action of the deciding robot is tried in such futures, in which all robots, this one included,
then follow a rule; the other robots deviate from it at their own decisions. Improving a rule one robot at a time costs
the sum, not the product, of the robots' numbers of actions [Bertsekas2021]_.
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
from halfseen.world.policy import Policy, PolicyDraw
from halfseen.world.random import Key
from halfseen.world.seeing import Glimpse, KnownSeeing, LookOutcome, labelled
from halfseen.world.state import HiddenState, Pending, Robots, TableState, occlusion
from halfseen.world.transition import step, until_out_s

NUM_PROPOSALS = 16
"""Attempts drawn for each robot at work; one that has not ended yet is kept."""
NUM_FUTURES = 32
Tree = TypeVar("Tree")


@record
class ForeseenSeeing:
    """Draws labels from a law's probabilities, given the truth and the share seen, without a latent variable."""

    law: KnownSeeing

    def draw_latent(self, num_objects: int, key: Key) -> None:
        """No latent variable: the persistent state is in `Glimpse.seen`."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], latent: None, key: Key
    ) -> LookOutcome:
        """Label each object once."""
        return labelled(self.law, glimpse, log_odds, is_dirty, key)


def spread(tree: Tree, num: int, axis: int) -> Tree:
    """Repeat records `num` times along a new axis."""

    def each(leaf: Array) -> Array:
        xp, shape = library_of(leaf), np.shape(leaf)
        return xp.broadcast_to(xp.expand_dims(leaf, axis), (*shape[:axis], num, *shape[axis:]))

    return mapped(each, tree)


def imagined(config: WorldConfig, state: TableState, key: Key) -> HiddenState:
    """Draw the hidden state of tables from its posterior given the observations.

    For a team, this includes the endings of the actions in progress. For each robot, `NUM_PROPOSALS` attempts are
    drawn, with their grips, as if begun on the current table. One that lasts longer than the robot's elapsed time is
    kept (rejection sampling); if there is none, the longest is kept and ends at once. Drop-out times are redrawn, as a
    constant hazard is memoryless.
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
    """Draw how a robot's action will end (`Pending` without the robot axis), and the grip of its object."""
    assert state.decider is not None
    xp, never, num_axes = library_of(robots.is_busy), np.float32(np.inf), state.decider.ndim
    verb, target, since_s, is_busy = (
        each[..., robot] for each in (robots.verb, robots.target, robots.since_s, robots.is_busy)
    )
    is_wait, occluded = verb == WAIT, occlusion(state)
    alone = replace(state, robots=None, workspace=None)
    # WAIT, like FINISH, does not act on the table.
    begun = (alone, xp.where(is_wait, Verb.FINISH, verb), target, occluded)
    tables, verbs, targets, occlusions = spread(begun, NUM_PROPOSALS, num_axes)
    grip_key, attempt_key = random.split(random.keys_of(key, NUM_PROPOSALS))
    world = config.as_robot(robot)
    drawn = _imagined_table(world, tables, grip_key)
    tried = attempted(world, tables, drawn, verbs, targets, attempt_key, occlusions)
    duration_s = (world.transport_s + tried.duration_s) / config.speed[robot]
    # If two actions end at the same time, that of the lower robot ends first, so a higher robot may be at its end.
    is_later = (robot > state.decider)[..., None]
    goes_on = (duration_s > since_s[..., None]) | ((duration_s == since_s[..., None]) & is_later)
    # The proposals are exchangeable, so the first that goes on is a valid draw.
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
    """Correction of a stage's reward that replaces hidden attributes by their probabilities.

    The success of an attempt is independent of DIRTY, so the expected reward does not change: only its variance falls
    (Rao–Blackwell).
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
    """Reward until the end of each action, followed by a policy, in each of S futures; −∞ if not tried.

    All actions share the hidden state and the random draws (common random numbers).

    `policy` then decides for all robots; `tried` selects among the possible actions, by default all.
    """
    xp, num_axes = library_of(state.is_on_table), state.steps_to_go.ndim
    wanted: Any = possible_actions(state) if tried is None else tried
    hidden_key, world_key, policy_key = random.split(random.keys_of(key, num_futures), 3)
    states, is_tried = spread((state, wanted), num_futures, num_axes)
    hidden = imagined(config, states, hidden_key)
    rows = np.nonzero(is_tried) if xp is np else tuple(xp.indices(is_tried.shape).reshape(is_tried.ndim, -1))
    begin = mapped(lambda leaf: leaf[rows[:-1]], (states, hidden, world_key, policy_key))
    # Labels are drawn from their probabilities, not from the law's latent variable.
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
    """Total reward of each row until its end; NumPy drops the rows that are over."""
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
    """Takes the action with the largest value if all robots follow a rule afterwards.

    It deviates from the rule's action only for one that is better over the same futures by `caution` standard errors.

    Parameters
    ----------
    config
        Its model of the world and the robots.
    rule
        Policy of all robots afterwards.
    num_futures
        Number of futures in which each action is tried, ≥ 2.
    caution
        Required advantage over the rule's action, in standard errors.

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
                f"num_futures is {self.num_futures}; give at least 2; the standard error of a gain is estimated "
                "from them"
            )

    @property
    def num_robots(self) -> int:
        """K."""
        return self.config.num_robots

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose for each table; the futures draw from `key` (the propensity is unknown)."""
        future_key, rule_key = random.split(key)
        by_rule = self.rule.decide(state, rule_key).action
        rewards = future_rewards(self.config, state, self.rule, future_key, self.num_futures)
        xp, is_possible = library_of(rewards), possible_actions(state)
        # Impossible actions are −∞ in every future, which must not enter a mean.
        rewards = xp.where(is_possible[..., None, :], rewards, np.float32(0.0))
        gained = rewards - at(rewards, by_rule[..., None])[..., None]
        error = xp.std(gained, axis=-2) / np.float32(np.sqrt(self.num_futures - 1.0))
        gain = xp.mean(gained, axis=-2) - self.caution * error
        promise = xp.where(is_possible, gain, np.float32(-np.inf))
        best = xp.argmax(promise, axis=-1)
        action = xp.where(at(promise, best) > 0.0, best, by_rule).astype(np.int32)
        return PolicyDraw(action, xp.full(action.shape, np.nan, dtype=np.float32))
