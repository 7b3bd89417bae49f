"""Pooled or separate stages: which is chosen, and by what."""

import numpy as np
import pandas as pd
import pytest

from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs


def trial(num_trajectories, is_swapped, seed=0):
    """Two stages; A suits a positive x and B a negative one, or in the second stage the other way round."""
    rng = np.random.default_rng(seed)
    trajectory = np.repeat(np.arange(num_trajectories), 2)
    stage = np.tile([1, 2], num_trajectories)
    x = rng.normal(size=2 * num_trajectories)
    action = rng.choice(["A", "B"], 2 * num_trajectories)
    sign = np.where(action == "A", 1.0, -1.0) * np.where((stage == 2) & is_swapped, -1.0, 1.0)
    reward = sign * x + 0.3 * rng.normal(size=2 * num_trajectories)
    stages = {
        "trajectory": trajectory,
        "stage": stage,
        "elapsed_s": stage * 1.0,
        "action": action,
        "reward": reward,
        "x": x,
    }
    ends = {
        "trajectory": np.arange(num_trajectories),
        "end_s": np.full(num_trajectories, 2.0),
        "ending": ["finished"] * num_trajectories,
    }
    return Logs(pd.DataFrame(stages), ends)


@pytest.mark.parametrize(("is_swapped", "stages"), [(False, "pooled"), (True, "separate")])
def test_stages_are_separate_where_they_differ(is_swapped, stages):
    learner = CensoredQLearner(2, ["A", "B"], ["x"]).fit(trial(120, is_swapped))
    assert learner.model_.stages == stages
    assert learner.chosen_[0].startswith(f"stages are {stages}: held out, ")
    states = pd.DataFrame({"x": [-1.0, 1.0]})
    assert learner.decide(states, 1).tolist() == ["B", "A"]
    assert learner.decide(states, 2).tolist() == (["A", "B"] if is_swapped else ["B", "A"])


@pytest.mark.parametrize(
    ("num_trajectories", "said"), [(60, {"stages": "pooled"}), (10, {})], ids=["said", "too few trajectories"]
)
def test_there_is_not_always_a_choice(num_trajectories, said):
    learner = CensoredQLearner(2, ["A", "B"], ["x"], **said).fit(trial(num_trajectories, True))
    assert (learner.model_.stages, learner.chosen_) == ("pooled", ())


def test_the_same_seed_chooses_the_same():
    logs = trial(60, False)
    one, other = (CensoredQLearner(2, ["A", "B"], ["x"], random_state=3).fit(logs) for _ in range(2))
    assert one.chosen_ == other.chosen_
