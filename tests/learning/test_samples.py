"""Later trajectories count more: as if each were there so often; and trajectories that are drawn again."""

import numpy as np
import pandas as pd
import pytest
from trials import ACTIONS, FULL, indicators, log_of, two_stage_trial, with_known_actions

from halfseen.censoring import Cox
from halfseen.errors import ArgumentError
from halfseen.evaluation.held_out import learn_by_folds
from halfseen.learning import CensoredQLearner, DoublyRobust, Weighted, bootstrap
from halfseen.learning.sample import latest, recency_weights
from halfseen.logs import Logs, LogStream
from halfseen.workers import Workers
from refusals import refused, refused_type
from small_logs import flat_log

BY_STAGE, COVARIATES = {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"]


def turning(num, turns_at, seed=0):
    """One stage; A is better where x is above 0, and from a trajectory on where it is below."""
    rng = np.random.default_rng(seed)
    x, is_a = rng.normal(size=num), rng.random(num) < 0.5
    sign = np.where(np.arange(num) < turns_at, 1.0, -1.0) * np.where(is_a, 1.0, -1.0)
    return log_of(np.where(is_a, "A", "B"), sign * x + 0.3 * rng.normal(size=num), x=x)


def copied(logs, counts):
    """Each trajectory so often, under new names."""
    which, tables = np.repeat(logs.trajectory_ids, counts), []
    for table in (logs.stages, logs.trajectories):
        parts = [table[table["trajectory"] == name].assign(trajectory=k) for k, name in enumerate(which)]
        tables.append(pd.concat(parts))
    return Logs(*tables)


@pytest.mark.slow
@pytest.mark.parametrize("stages", ["separate", "pooled"])
def test_weights_are_copies_of_trajectories(stages):
    logs = flat_log(8, cut_after_s=8.0)
    options = {"reg": 0.05, "stages": stages, "censoring": "none"}
    weighted = CensoredQLearner.of_paper(2, BY_STAGE, COVARIATES, half_life=1, **options).fit(logs)
    doubled = CensoredQLearner.of_paper(2, BY_STAGE, COVARIATES, **options).fit(copied(logs, 2 ** np.arange(8)))
    np.testing.assert_allclose(weighted.q_functions_.coefficients, doubled.q_functions_.coefficients, atol=1e-9)
    counts = 2.0 ** np.arange(8)
    np.testing.assert_allclose(recency_weights(8, 1.0), counts / counts.mean())


@pytest.mark.slow
@pytest.mark.parametrize("censoring", ["kaplan-meier", "buckley-james", "auto"])
def test_a_half_life_without_end_is_none(censoring):
    logs = flat_log(60)
    plain, endless = (
        CensoredQLearner(2, BY_STAGE, COVARIATES, censoring=censoring, half_life=half_life).fit(logs)
        for half_life in (None, 1e15)
    )
    np.testing.assert_allclose(endless.q_functions_.coefficients, plain.q_functions_.coefficients, atol=1e-9)
    np.testing.assert_allclose(endless.weights_, plain.weights_)


@pytest.mark.slow
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
    assert few.chosen_[-1] == "all trajectories have equal weight: 60 are too few to choose a half-life"


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
    with refused("half_life is .*; give a number of trajectories above 0"):
        CensoredQLearner(1, ["A", "B"], ["x"], half_life=half_life).fit(turning(20, 20))


def test_of_tables_it_is_for_eq_3_without_laws():
    assert type(CensoredQLearner.for_table(3, half_life=8)) is CensoredQLearner


NUM_TRAJECTORIES = 60


@pytest.fixture(scope="module")
def logs():
    return with_known_actions(two_stage_trial(num_trajectories=NUM_TRAJECTORIES))


def repeated(logs, counts):
    """A log in which trajectory i is there `counts[i]` times, under other names."""
    rows = np.repeat(logs.trajectory_ids, counts)
    names = pd.DataFrame({"trajectory": rows, "name": np.arange(len(rows))})
    frames = [
        names.merge(frame, on="trajectory").drop(columns="trajectory") for frame in (logs.stages, logs.trajectories)
    ]
    return Logs(*(frame.rename(columns={"name": "trajectory"}) for frame in frames))


@pytest.mark.slow
@pytest.mark.parametrize(
    "censoring",
    ["kaplan-meier", Weighted(Cox(ridge=1.0), by="pooled"), DoublyRobust(), "buckley-james"],
    ids=["weights", "cox by stage", "doubly robust", "imputed"],
)
def test_a_replicate_is_what_is_learned_from_the_trajectories_that_were_drawn(logs, censoring):
    """A trajectory drawn k times counts as k trajectories that are the same, in the weights and the targets, too."""
    learner = CensoredQLearner.of_paper(2, ACTIONS, ["s1_1", "s2_1"], reg=0.1, censoring=censoring).fit(logs)
    found = bootstrap(learner, logs, num_replicates=3, random_state=5)

    share = np.full(NUM_TRAJECTORIES, 1 / NUM_TRAJECTORIES)
    counts = np.random.default_rng(5).multinomial(NUM_TRAJECTORIES, share, size=3)
    for k in range(3):
        again = CensoredQLearner.of_paper(2, ACTIONS, ["s1_1", "s2_1"], reg=0.1, censoring=censoring).fit(
            repeated(logs, counts[k])
        )
        np.testing.assert_allclose(
            found.replicates.coefficients[k], again.q_functions_.coefficients, rtol=1e-6, atol=1e-8
        )


@pytest.mark.slow
def test_workers_draw_the_same(logs):
    learner = CensoredQLearner.of_paper(2, ACTIONS, ["s1_1", "s2_1"], reg=0.1, censoring="buckley-james").fit(logs)
    alone, together = (
        bootstrap(learner, logs, num_replicates=21, random_state=5, workers=Workers(num)) for num in (1, 2)
    )
    np.testing.assert_array_equal(alone.replicates.coefficients, together.replicates.coefficients)
    assert len(alone.replicates.coefficients) == 21


def test_intervals_and_shares(logs):
    learner = CensoredQLearner.of_paper(2, ACTIONS, FULL, reg=1.0).fit(logs)
    found = bootstrap(learner, logs, num_replicates=40)
    frame = pd.DataFrame([indicators(1, state) for state in range(3)])
    low, high = found.q_interval(frame, 1, level=0.9)
    wide_low, wide_high = found.q_interval(frame, 1, level=0.99)
    q = learner.q_values(frame, 1)
    assert (low < q).mean() > 0.8
    assert (q < high).mean() > 0.8
    assert (wide_low <= low).all()
    assert (wide_high >= high).all()
    shares = found.decision_shares(frame, 1)
    assert shares.sum(axis=1) == pytest.approx(1.0)
    assert (shares[np.arange(3), np.argmax(q, axis=1)] > 0.5).all()


def test_what_cannot_be_asked_is_refused(logs):
    learner = CensoredQLearner.of_paper(2, ACTIONS, FULL, reg=1.0)
    with pytest.raises(ArgumentError, match="fit it to this log first"):
        bootstrap(learner, logs)
    learner.fit(logs)
    with pytest.raises(ArgumentError, match="num_replicates is 1"):
        bootstrap(learner, logs, num_replicates=1)
    for wrong, words in (({"num_replicates": "3"}, "num_replicates is '3'"), ({"random_state": "x"}, "it is a seed")):
        with refused_type(words):
            bootstrap(learner, logs, **wrong)
    turned = Logs(logs.stages.assign(action=logs.stages["action"].replace({"A": "B", "B": "A"})), logs.trajectories)
    for another in (logs.select(range(10)), turned):
        with pytest.raises(ArgumentError, match="is not that of 60 which the learner was fitted to"):
            bootstrap(learner, another)
    with refused_type("workers is 4; give Workers of halfseen.workers, such as Workers"):
        bootstrap(learner, logs, workers=4)
    with pytest.raises(ArgumentError, match="stage is 3; give a whole number, 1 to the horizon, 2"):
        bootstrap(learner, logs, num_replicates=2).decision_shares(pd.DataFrame([indicators(1, 0)]), 3)
    with pytest.raises(ArgumentError, match=r"level is 1\.0"):
        bootstrap(learner, logs, num_replicates=2).q_interval(pd.DataFrame([indicators(1, 0)]), 1, level=1.0)
