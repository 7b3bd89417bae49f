"""A classifier of first states: what it bets on, and since when it says that they have changed."""

import numpy as np
import pandas as pd
import pytest

from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.monitoring import betting
from halfseen.monitoring.joint import first_states

LOOKS_AT = Covariates(("x", "y", "tool"), {"tool": ("A", "B")})
REFERENCE = np.column_stack([np.random.default_rng(2).normal(size=(200, 2)), np.zeros(200)])


def log_of(rng, num, changed_from):
    """Log whose x and y are correlated from a trajectory on, each alone as before; every ninth tool is unknown."""
    x, y = rng.normal(size=(2, num))
    y = np.where(np.arange(num) < changed_from, y, 0.8 * x + 0.6 * y)
    tool = np.where(np.arange(num) % 9 == 8, "C", "A")
    stages = pd.DataFrame({"trajectory": np.arange(num), "stage": 1, "x": x, "y": y, "tool": tool})
    stages = stages.assign(elapsed_s=1.0, action="GRASP", reward=1.0)
    ends = pd.DataFrame({"trajectory": np.arange(num), "end_s": 1.0, "ending": "finished"})
    return Logs(stages=stages, trajectories=ends)


def test_pairs_take_the_oldest_aside_and_a_change_of_the_correlation_alone_is_noticed():
    rng = np.random.default_rng(2)
    found = first_states(LOOKS_AT, log_of(rng, 500, 0), REFERENCE, 0)
    assert (found.payoffs[:, 0, 0] == 1.0).all()
    assert (found.payoffs[8::9] == 1.0).all()
    assert found.pairs[:, 1].tolist() == sorted(found.pairs[:, 1])
    assert len({*found.pairs.flat}) == found.pairs.size
    assert betting.log_wealth(found.payoffs)[-1, 0] > np.log(1000)
    same = first_states(LOOKS_AT, log_of(rng, 500, 500), REFERENCE, 0)
    assert betting.log_wealth(same.payoffs)[-1, 0] < np.log(20)


@pytest.mark.slow
@pytest.mark.parametrize("changed_from", [0, 150, 300])
def test_a_change_of_the_correlation_alone_is_dated(changed_from):
    for seed in range(5):
        found = first_states(LOOKS_AT, log_of(np.random.default_rng(seed), 600, changed_from), REFERENCE, seed)
        change = found.changed_at(599)
        assert change.low - 15 <= changed_from <= change.high + 15, seed
        assert change.at == pytest.approx(changed_from, abs=30)


def test_a_change_lies_at_or_before_its_alarm():
    found = first_states(LOOKS_AT, log_of(np.random.default_rng(0), 600, 300), REFERENCE, 0)
    assert found.changed_at(200).high <= 200
