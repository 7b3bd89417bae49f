"""What planning time is worth: one repetition of the planners, at every planning horizon and every decision budget.

All policies meet the same evaluation episodes. A slow planner plays few of them, in turn over the repetitions, so that
every table is met; it is compared on those that it played. An episode depends on its key and number alone, so one that
is played by itself is the one that others play many at once.
"""

import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from halfseen.learners.q_learning.encoding import Encoded, encode_states
from halfseen.planners.pomdp import POMDPPolicy
from halfseen.study.design import StudyDesign
from halfseen.study.findings import LEARNED
from halfseen.study.learning import learn
from halfseen.study.policies import heuristics, logging_policy
from halfseen.study.repetition import EVALUATION, LOGS, CutRates, cut_log, first_paths, folds, random_key
from halfseen.study.timing import decided, one_core
from halfseen.study.treatments import treat
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.config import Number, WorldConfig
from halfseen.world.cuts import CutKind
from halfseen.world.dynamics import start, step
from halfseen.world.episodes import evaluate, play
from halfseen.world.policy import Policy
from halfseen.world.state import HiddenState, Layout, TableState

HORIZON_PREFIX, SEARCH_PREFIX = "pomdp-", "search-"
CUT_KIND: CutKind = "independent"
NUM_FITS = 5
"""Timed; their median counts."""
MOST_TIMED_S = 3.0
"""Time that is spent on timing one planner, but for its last decision [s]."""
FEWEST_TIMED = 3


class Planner(NamedTuple):
    """A planner that takes part."""

    policy: POMDPPolicy
    num_episodes: int | None
    """How many of a repetition's episodes it plays; all if None."""


class Played(NamedTuple):
    """What a policy earned on single episodes."""

    reward: list[float]
    robot_s: list[float]


def planning_contenders(
    world: WorldConfig,
    horizons: Sequence[int],
    num_simulations: int,
    budgets: Sequence[tuple[str, int, int]],
) -> dict[str, Planner]:
    """The planners by name: ``pomdp-h`` looks h steps ahead, ``search-n`` to the end of the path with n simulations.

    Parameters
    ----------
    world
        The world that they believe in.
    horizons
        Planning horizons.
    num_simulations
        Simulations a decision at each planning horizon.
    budgets
        Of the search to the end: what the budget is called, its simulations, and the episodes of each repetition that
        are played with it.
    """
    ahead = {
        f"{HORIZON_PREFIX}{h}": Planner(POMDPPolicy(world, planning_horizon=h, num_simulations=num_simulations), None)
        for h in horizons
    }
    searches = {
        f"{SEARCH_PREFIX}{size}": Planner(
            POMDPPolicy(world, planning_horizon=world.horizon, num_simulations=size), num_episodes
        )
        for _, size, num_episodes in budgets
    }
    return ahead | searches


def run_planning_repetition(
    design: StudyDesign, planners: Mapping[str, Planner], layouts: Layout, rates: CutRates, repetition: int
) -> dict[str, Any]:
    """Play all policies; return plain numbers: of each policy, which episodes it played and what each brought.

    Parameters
    ----------
    design
        What the study does.
    planners
        Of `planning_contenders`.
    layouts
        The tables.
    rates
        Of cuts, from `halfseen.study.repetition.cut_rates`.
    repetition
        Which; its episodes are those of `halfseen.study.repetition.run_repetition`.
    """
    key = random_key(design, EVALUATION, repetition)
    num_all = design.episodes_per_scene * layouts.is_object.shape[0]
    rows = []
    fast: dict[str, Policy] = {LEARNED: headline_policy(design, layouts, rates, repetition), **heuristics(design)}
    for name, policy in fast.items():
        totals = evaluate(design.world, layouts, policy, key, num_all)
        reward, robot_s = (np.asarray(of, dtype=np.float64).tolist() for of in (totals.reward, totals.robot_s))
        rows.append(_row(name, range(num_all), Played(reward, robot_s)))
    for name, planner in planners.items():
        episodes = episodes_in_turn(repetition, planner.num_episodes, num_all)
        rows.append(_row(name, episodes, play_singly(design.world, layouts, planner.policy, key, episodes)))
    return {"repetition": repetition, "played": rows}


def _row(name: str, episodes: Sequence[int], played: Played) -> dict[str, Any]:
    return {"policy": name, "episodes": list(episodes), **played._asdict()}


def episodes_in_turn(repetition: int, num_episodes: int | None, num_all: int) -> list[int]:
    """Which of a repetition's episodes a policy plays that plays only some: each repetition goes on with the next.

    Episode i is of table i modulo their number: so all tables are met alike.
    """
    num_played = num_all if num_episodes is None else min(num_episodes, num_all)
    first = repetition * num_played if num_played < num_all else 0
    return sorted((first + k) % num_all for k in range(num_played))


def play_singly(
    config: WorldConfig, layouts: Layout, policy: Policy, key: jax.Array, episodes: Sequence[int]
) -> Played:
    """Play single episodes of those that `halfseen.world.episodes.evaluate` plays many at once.

    Here no decision is made after the end, and a planner is compiled for one table alone, as it is timed.
    """
    reward, robot_s = [], []
    for episode in episodes:
        state, hidden, world_key, policy_key = _begun(config, layouts, key, episode)
        earned, taken_s = 0.0, 0.0
        for t in range(config.horizon):
            action = decided(policy, state, jax.random.fold_in(policy_key, t))
            state, hidden, gained, duration_s, is_over = _stepped(config, state, hidden, action, world_key, t)
            earned, taken_s = earned + float(gained), taken_s + float(duration_s)
            if is_over:
                break
        reward.append(earned)
        robot_s.append(taken_s)
    return Played(reward, robot_s)


@jax.jit
def _begun(
    config: WorldConfig, layouts: Layout, key: jax.Array, episode: Number
) -> tuple[TableState, HiddenState, jax.Array, jax.Array]:
    """The table as the episode begins, and the keys of the world and of the policy."""
    layout = jax.tree.map(lambda leaf: leaf[episode % leaf.shape[0]], layouts)
    start_key, world_key, policy_key = jax.random.split(jax.random.fold_in(key, episode), 3)
    return *start(config, layout, start_key), world_key, policy_key


@jax.jit
def _stepped(
    config: WorldConfig, state: TableState, hidden: HiddenState, action: jax.Array, world_key: jax.Array, t: Number
) -> tuple[TableState, HiddenState, jax.Array, jax.Array, jax.Array]:
    after, hidden, outcome = step(config, state, hidden, action, jax.random.fold_in(world_key, t))
    return after, hidden, outcome.reward, outcome.duration_s, outcome.is_over


def headline_policy(design: StudyDesign, layouts: Layout, rates: CutRates, repetition: int) -> LinearTablePolicy:
    """The policy that Table 1 compares, learned again from the repetition's log."""
    policies = learn(*_lesson(design, layouts, rates, repetition))
    return LinearTablePolicy(policies.coefficients[0])


def learning_time_s(design: StudyDesign, layouts: Layout, rates: CutRates) -> float:
    """Time that learning the headline policy takes, on one core, after compilation [s]; the median of a few."""
    lesson = _lesson(design, layouts, rates, 0)
    learn(*lesson)
    with one_core():
        return float(np.median([_seconds(learn, *lesson) for _ in range(NUM_FITS)]))


def _lesson(design: StudyDesign, layouts: Layout, rates: CutRates, repetition: int) -> tuple[Any, Any, Any]:
    """Encoded paths, treated stages and folds of the headline policy."""
    size, longest = design.table_num_paths, max(design.num_paths)
    episodes = play(design.world, layouts, logging_policy(design), random_key(design, LOGS, repetition), longest)
    log = cut_log(design, episodes, rates[CUT_KIND, design.table_cut_share], CUT_KIND, repetition)
    features, is_possible = encode_states(episodes.states)
    encoded = Encoded(*(np.asarray(leaf)[:size] for leaf in (features, is_possible, episodes.action)))
    treated = treat(first_paths(log, size), "weighted", design.world)
    return encoded, [treated], folds(design, repetition, longest)[:size]


def planner_times_ms(planners: Mapping[str, Planner], states: TableState) -> dict[str, Float[np.ndarray, " S"]]:
    """Time of a decision of each planner, on one core, after compilation [ms].

    Each decides once on the first states of a batch, and on no more of them once `MOST_TIMED_S` are spent: on fewer,
    the slower it is.

    Parameters
    ----------
    planners
        Of `planning_contenders`.
    states
        Tables to decide on.
    """
    key = jax.random.key(0)
    singles = [jax.tree.map(lambda leaf, k=k: leaf[k], states) for k in range(states.is_object.shape[0])]
    for planner in planners.values():
        decided(planner.policy, singles[0], key).block_until_ready()
    with one_core():
        return {name: _times_ms(planner.policy, singles, key) for name, planner in planners.items()}


def _times_ms(policy: Policy, states: Sequence[TableState], key: jax.Array) -> Float[np.ndarray, " S"]:
    taken_s: list[float] = []
    for state in states:
        if sum(taken_s) > MOST_TIMED_S and len(taken_s) >= FEWEST_TIMED:
            break
        taken_s.append(_seconds(lambda state=state: decided(policy, state, key).block_until_ready()))
    return 1e3 * np.array(taken_s)


def _seconds(function: Any, *arguments: Any) -> float:
    begin = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - begin
