"""Covariates far from 0, such as Unix times: their origin changes nothing, or is refused."""

import numpy as np
import pandas as pd
import pytest

from halfseen.evaluation import FixedSequence, QSpec, evaluate
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from refusals import refused
from small_logs import flat_log

ORIGINS = [1e6, 3e8, 1.7e9]


def moved(origin):
    logs = flat_log(120)
    chance = np.full(logs.num_stages, 0.5)
    return Logs(logs.stages.assign(x1=logs.stages["x1"] + origin, probability=chance), logs.trajectories)


ALWAYS_A = FixedSequence(("A", "A"))


def found(logs, policy=ALWAYS_A, **options):
    one = evaluate(policy, logs, against="logging", **options)
    return one.doubly_robust.value, one.fitted_q.value, one.difference.low


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"propensity": "estimated"}, {"censoring": "cox"}])
def test_the_origin_of_a_covariate_changes_no_value(options):
    whole = found(moved(0.0), **options)
    for origin in ORIGINS:
        np.testing.assert_allclose(found(moved(origin), **options), whole, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("origin", ORIGINS)
def test_a_linear_q_refuses_a_covariate_that_its_sums_would_lose(origin):
    message = r"covariate 'x1' is about .*e\+0[689] and differs by 0.9\d, which rounding would erase from a linear Q"
    learner = CensoredQLearner.of_paper(2, ["A", "B", "C"], ["x1"])
    with refused(message):
        learner.fit(moved(origin))
    with refused(message):
        found(moved(origin), q=QSpec(q_function="linear"))
    learner.set_params(q_function="quadratic", reg=0.01)
    states = pd.DataFrame({"x1": [-1.0, 0.0, 1.0]})
    whole = learner.unfitted().fit(moved(0.0)).q_values(states, 1)
    np.testing.assert_allclose(learner.fit(moved(origin)).q_values(states + origin, 1), whole, atol=1e-6)


def test_a_constant_covariate_is_none_that_rounding_would_erase():
    logs = flat_log(120)
    same = Logs(logs.stages.assign(x1=0.1, x2=np.where(logs.stages.index % 2, 0.3, 0.1 + 0.2)), logs.trajectories)
    learner = CensoredQLearner.of_paper(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=0.01).fit(same)
    assert np.ptp(learner.q_values(same.stages, 1), axis=0).max() == 0.0


class Above:
    """A above 0 in one column, and B below."""

    actions, horizon = ("A", "B"), 1

    def __init__(self, column):
        self.column = column

    def probabilities(self, frame, stage):
        is_above = frame[self.column].to_numpy() > 0
        return np.column_stack([is_above, ~is_above]).astype(float)


@pytest.mark.slow
@pytest.mark.parametrize("names", [["x1*x1"], ["x1*x1", "x1*x1'"], ["x1 less its mean"]])
@pytest.mark.parametrize("origin", [0.0, 3e8])
def test_a_column_with_the_name_of_a_term_keeps_its_values(names, origin):
    logs = flat_log(120, horizon=1)
    size = np.random.default_rng(3).normal(size=(len(names), logs.num_stages))
    stages = logs.stages.assign(x1=logs.stages["x1"] + origin, probability=0.5)
    whole, other = (
        found(Logs(stages.assign(**dict(zip(columns, size, strict=True))), logs.trajectories), Above(columns[0]))
        for columns in (["size", "width"][: len(names)], names)
    )
    np.testing.assert_allclose(other, whole, rtol=1e-9)
