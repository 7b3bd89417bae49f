"""Later trajectories count more: as if each were there so often, in parts as in memory; when a half-life is taken."""

import numpy as np
import pandas as pd
import pytest

from halfseen.evaluation.held_out import learn_by_folds
from halfseen.learning import CensoredQLearner
from halfseen.learning.sample import latest, recency_weights
from halfseen.logs import Logs, LogStream
from refusals import refused
from small_logs import flat_log

ACTIONS, COVARIATES = {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"]


def turning(num, turns_at, seed=0):
    """One stage; A is better where x is above 0, and from a trajectory on where it is below."""
    rng = np.random.default_rng(seed)
    x, is_a = rng.normal(size=num), rng.random(num) < 0.5
    sign = np.where(np.arange(num) < turns_at, 1.0, -1.0)
    stages = {"trajectory": range(num), "stage": 1, "elapsed_s": 1.0, "action": np.where(is_a, "A", "B"), "x": x}
    reward = sign * x * np.where(is_a, 1.0, -1.0) + 0.3 * rng.normal(size=num)
    return Logs(
        pd.DataFrame(stages | {"reward": reward}),
        pd.DataFrame({"trajectory": range(num), "end_s": 1.0, "ending": "finished"}),
    )


def copied(logs, counts):
    """Each trajectory so often, under new names."""
    which, tables = np.repeat(logs.trajectory_ids, counts), []
    for table in (logs.stages, logs.trajectories):
        parts = [table[table["trajectory"] == name].assign(trajectory=k) for k, name in enumerate(which)]
        tables.append(pd.concat(parts))
    return Logs(*tables)


@pytest.mark.parametrize("stages", ["separate", "pooled"])
def test_weights_are_copies_of_trajectories(stages):
    logs = flat_log(8, cut_after_s=8.0)
    options = {"reg": 0.05, "stages": stages, "censoring": "none"}
    weighted = CensoredQLearner.of_paper(2, ACTIONS, COVARIATES, half_life=1, **options).fit(logs)
    doubled = CensoredQLearner.of_paper(2, ACTIONS, COVARIATES, **options).fit(copied(logs, 2 ** np.arange(8)))
    np.testing.assert_allclose(weighted.q_functions_.coefficients, doubled.q_functions_.coefficients, atol=1e-9)
    counts = 2.0 ** np.arange(8)
    np.testing.assert_allclose(recency_weights(8, 1.0), counts / counts.mean())


@pytest.mark.parametrize("censoring", ["kaplan-meier", "buckley-james", "auto"])
def test_a_half_life_without_end_is_none(censoring):
    logs = flat_log(60)
    plain, endless = (
        CensoredQLearner(2, ACTIONS, COVARIATES, censoring=censoring, half_life=half_life).fit(logs)
        for half_life in (None, 1e15)
    )
    np.testing.assert_allclose(endless.q_functions_.coefficients, plain.q_functions_.coefficients, atol=1e-9)
    np.testing.assert_allclose(endless.weights_, plain.weights_)


@pytest.mark.parametrize("half_life", [20, "auto"])
def test_a_log_in_parts_is_weighed_as_one_in_memory(tmp_path, half_life):
    logs = turning(160, 60)
    logs.write(tmp_path / "logs")
    learner = CensoredQLearner(1, ["A", "B"], ["x"], q_function="linear", half_life=half_life)
    whole = learner.unfitted().fit(logs)
    parts = learner.unfitted().fit(LogStream(tmp_path / "logs", 37))
    np.testing.assert_allclose(parts.q_functions_.coefficients, whole.q_functions_.coefficients, atol=1e-9)
    np.testing.assert_array_equal(parts.weights_, whole.weights_)
    assert parts.model_.half_life == whole.model_.half_life == 20


def test_a_half_life_is_taken_where_it_predicts_better_and_follows_the_turn():
    x = pd.DataFrame({"x": [-1.0, 1.0]})
    pooled, recent = (
        CensoredQLearner(1, ["A", "B"], ["x"], half_life=h).fit(turning(300, 200)) for h in (None, "auto")
    )
    assert pooled.decide(x, 1).tolist() == ["B", "A"]
    assert recent.decide(x, 1).tolist() == ["A", "B"]
    assert "halves every" in recent.chosen_[-1]
    few = CensoredQLearner(1, ["A", "B"], ["x"], half_life="auto").fit(turning(60, 30))
    assert few.chosen_[-1] == "all trajectories count alike: 60 are too few to choose a half-life"


def test_policies_of_folds_have_a_half_life_of_as_many_of_their_own(monkeypatch):
    learner = CensoredQLearner(1, ["A", "B"], ["x"], q_function="linear", half_life=50).fit(turning(200, 200))
    asked = []
    fit = CensoredQLearner.fit
    monkeypatch.setattr(CensoredQLearner, "fit", lambda self, logs: asked.append(self.half_life) or fit(self, logs))
    learn_by_folds(learner, turning(200, 200), 5)
    assert asked == pytest.approx([40.0] * 5)


def test_the_latest_count_half_of_the_last_one_or_more():
    logs = turning(300, 300)
    assert latest(logs, None, 300) is logs
    assert latest(logs, 120.0, 300).trajectory_ids.tolist() == list(range(180, 300))
    assert latest(logs, 10.0, 300).num_trajectories == 100
    assert latest(logs, 500.0, 600).trajectory_ids[0] == 50


@pytest.mark.parametrize("half_life", [0, -3.0, "soon", True, np.inf, np.nan])
def test_what_is_no_half_life_is_refused(half_life):
    with refused("half_life is .*; it is a number of trajectories above 0"):
        CensoredQLearner(1, ["A", "B"], ["x"], half_life=half_life).fit(turning(20, 20))


def test_of_tables_it_is_for_eq_3_without_laws():
    assert type(CensoredQLearner.for_table(3, half_life=8)) is CensoredQLearner
