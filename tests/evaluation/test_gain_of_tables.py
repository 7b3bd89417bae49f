"""The verdict on a policy of a table of states, where there is a single stage."""

import numpy as np
import pandas as pd
import pytest

from halfseen.evaluation import held_out_verdict
from halfseen.evaluation.held_out import learn_by_folds
from halfseen.evaluation.tabular import gain_of
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from small_logs import log_of

STATES, ACTIONS = [f"s{number:02d}" for number in range(25)], ["a", "b", "c"]


def bandit(seed, num_trajectories):
    """One stage; all actions earn alike, and a fifth of the trajectories were cut."""
    rng = np.random.default_rng(seed)
    rows, is_seen = np.arange(num_trajectories), rng.random(num_trajectories) < 0.8
    end_s = 1.0 + rng.random(num_trajectories)
    stages = {
        "trajectory": rows,
        "stage": 1,
        "state": rng.choice(STATES, num_trajectories),
        "action": rng.choice(ACTIONS, num_trajectories),
        "elapsed_s": np.where(is_seen, end_s, np.nan),
        "reward": np.where(is_seen, rng.normal(size=num_trajectories), np.nan),
    }
    ending = np.where(is_seen, "finished", "cut")
    return Logs(pd.DataFrame(stages), pd.DataFrame({"trajectory": rows, "end_s": end_s, "ending": ending}))


def naive_num_stages(logs, policy):
    """The least, over folds, of the harmonic mean of the completed stages of the action that is taken in each state."""
    least = np.inf
    for k, one in enumerate(policy.policies):
        learned = logs.stages[policy.fold != k]
        done = learned[learned["elapsed_s"].notna()]
        taken = one.decide(learned[["state"]], 1)
        pairs = zip(learned["state"], taken, strict=True)
        counts = [max(((done["state"] == s) & (done["action"] == a)).sum(), 0.5) for s, a in pairs]
        least = min(least, len(counts) / sum(1.0 / count for count in counts))
    return least


def test_stages_of_a_single_decision_are_counted():
    logs = bandit(0, 400)
    learner = CensoredQLearner(1, ACTIONS, ["state"]).fit(logs)
    policy = learn_by_folds(learner, logs, 5)
    found = gain_of(policy, learner.model_, logs, float(learner.q_functions_.reg[-1, 0]))
    assert found.num_stages == pytest.approx(naive_num_stages(logs, policy))
    assert found.num_stages < 10


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_too_few_stages_of_a_single_decision_make_nothing_better(seed):
    logs = bandit(seed, 400)
    verdict = held_out_verdict(CensoredQLearner(1, ACTIONS, ["state"]).fit(logs), logs)
    assert verdict.verdict == "inconclusive"
    assert "times a state, but 10 are needed; record more" in verdict.reason


def test_no_verdict_on_a_table_rests_on_copies_unless_they_are_trusted():
    rng, num = np.random.default_rng(0), 600
    seen = {"trajectory": np.repeat(range(num), 2), "stage": np.tile([1, 2], num)}
    seen |= {"state": rng.choice(STATES, 2 * num), "action": rng.choice(ACTIONS[:2], 2 * num)}
    seen["reward"] = (seen["action"] == "a") + rng.normal(size=2 * num)
    once = pd.DataFrame({**seen, "elapsed_s": rng.gamma(2.0, size=(num, 2)).cumsum(axis=1).ravel()})
    logs = log_of(**pd.concat([once, once.assign(trajectory=once["trajectory"] + num)]).to_dict("list"))
    learner = CensoredQLearner(2, ACTIONS[:2], ["state"]).fit(logs)
    found = held_out_verdict(learner, logs)
    assert (found.verdict, "600 trajectories are copies of another" in found.reason) == ("inconclusive", True)
    assert held_out_verdict(learner, logs, trust=["trajectories"]).verdict == "better"
