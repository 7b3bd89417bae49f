"""A smooth Q that promises more than the log makes likely gives way to a linear one."""

import numpy as np
import pytest

from halfseen.learning import CensoredQLearner, DiscretePolicy, promise
from halfseen.learning.q_space import KernelQ, LinearQ
from halfseen.logs import Logs
from small_logs import flat_log

LOG = flat_log()
BROUGHT = LOG.stages.groupby("trajectory")["reward"].sum().loc[LOG.trajectory_ids[LOG.is_finished]]
RARE = float(np.quantile(BROUGHT, 0.95))


def promising(value):
    """A policy whose Q is the same everywhere in the first stage, but for an impossible action."""
    return DiscretePolicy(("A", "B"), (), np.array([[True, False]]), np.array([[[value], [1e6]]]))


@pytest.mark.parametrize(("value", "is_told"), [(RARE - 0.01, False), (RARE + 0.01, True)])
def test_what_is_promised_is_held_against_what_one_in_twenty_finished_trajectories_brought(value, is_told):
    said = promise.too_hopeful(promising(value), LOG)
    assert bool(said) == is_told
    assert not is_told or f"{value:.3g} a trajectory" in said


def test_few_finished_trajectories_say_nothing():
    few = LOG.select(LOG.trajectory_ids[:5])
    assert promise.too_hopeful(promising(1e9), few) == ""


def learner(**changed):
    return CensoredQLearner(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], **changed)


@pytest.mark.parametrize(
    ("changed", "linear_hopes", "space"),
    [({}, False, LinearQ), ({}, True, KernelQ), ({"q_function": "smooth"}, False, KernelQ)],
)
def test_q_is_linear_where_nobody_asked_for_another_and_that_promises_less(monkeypatch, changed, linear_hopes, space):
    def hope(policy, logs):
        assert isinstance(logs, Logs)
        return "9 a trajectory" if linear_hopes or policy.kernel_map is not None else ""

    monkeypatch.setattr(promise, "too_hopeful", hope)
    assert isinstance(learner(**changed).fit(LOG).model_.space, KernelQ), "of two stages it is believed"
    monkeypatch.setattr(promise, "MANY_STAGES", 2)
    found = learner(**changed).fit(LOG)
    assert isinstance(found.model_.space, space)
    assert any("promises 9 a trajectory" in each for each in found.chosen_) == (space is LinearQ)
    if space is LinearQ:
        plain = learner(q_function="linear").fit(LOG)
        np.testing.assert_array_equal(found.policy_.coefficients, plain.policy_.coefficients)
