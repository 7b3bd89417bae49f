"""Tables in the middle of a trajectory, made by hand."""

import numpy as np
from naive_planner import CONFIG, Cup

from halfseen.arrays import mapped
from halfseen.planners import GreedyPolicy, rollout
from halfseen.world import TableState, UniformPolicy, random
from halfseen.world.rollout import play
from halfseen.world.state import NO_ATTEMPT, pad_scenes
from picked import picked

TWO = np.array([[0.0, 0.6], [0.1, 0.0]])
THREE = np.array([[0.0, 0.6, 0.3], [0.1, 0.0, 0.2], [0.4, 0.05, 0.0]])
CUPS = [Cup(0.85, ((0.6, False), (0.6, True))), Cup(0.4, ((0.1, False),)), Cup(0.7)]


def rules_of(config):
    """All greedy rules: that with history and penalty is the last."""
    return [GreedyPolicy(config, uses_history=h, counts_penalty=p) for h in (False, True) for p in (False, True)]


def met_by_lot(config, scene, num_episodes):
    """States along the way of somebody who acts by lot, one by one."""
    episodes = play(config, pad_scenes([scene]), UniformPolicy(), random.key_of(0), num_episodes)
    states = picked(episodes.states, episodes.is_taken)
    return [picked(states, k) for k in range(len(states.steps_to_go))]


def state_of_few(cups=CUPS, hides=THREE, steps_to_go=6):
    """Pad to three objects."""
    return state_of(cups, hides, steps_to_go, num_padding=3 - len(cups))


def drawn_successors(config, state, choice, num):
    """What is believed after so many attempts at one table, each by draws of its own; the axis of draws last."""
    search = rollout.opened(config, mapped(lambda leaf: np.asarray(leaf)[None], state))
    table, look = rollout.picked((search.table, search.look), np.zeros(num, dtype=np.int64))
    draws = rollout.draws_of(random.keys_of(random.key_of(0), num), 1, state.num_objects)[0]
    return rollout.successor(config, table, look, np.full(num, choice), draws)


def state_of(cups, hides, steps_to_go=10, num_padding=0):
    """Make the state that says of each cup what is believed; its padding is NaN, as far as that goes."""
    num_objects, size, horizon = len(cups), len(cups) + num_padding, CONFIG.horizon
    padded_hides = np.full((size, size), np.nan if num_padding else 0.0, dtype=np.float32)
    padded_hides[:num_objects, :num_objects] = hides
    padding = [np.nan] * num_padding
    tried = [(i, *attempt) for i, cup in enumerate(cups) for attempt in cup.attempts]
    rest = horizon - len(tried)
    leaves = {
        "hides": padded_hides,
        "is_object": np.arange(size) < num_objects,
        "is_on_table": np.array([cup.is_on_table for cup in cups] + [False] * num_padding),
        "grip": np.array([cup.grip for cup in cups] + padding, dtype=np.float32),
        "log_odds": np.array([cup.log_odds for cup in cups] + padding, dtype=np.float32),
        "seen": np.array([cup.seen for cup in cups] + padding, dtype=np.float32),
        "lifts": np.zeros(size, dtype=np.int32),
        "attempt_object": np.array([i for i, _, _ in tried] + [NO_ATTEMPT] * rest, dtype=np.int32),
        "attempt_occlusion": np.array([occluded for _, occluded, _ in tried] + [0.0] * rest, dtype=np.float32),
        "attempt_succeeded": np.array([is_grasped for _, _, is_grasped in tried] + [False] * rest, dtype=bool),
        "steps_to_go": np.int32(steps_to_go),
    }
    return TableState(**leaves)
