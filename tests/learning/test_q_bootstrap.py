import numpy as np
import pandas as pd
import pytest
from trials import ACTIONS, FULL, indicators, two_stage_trial, with_known_actions

from halfseen.censoring import Cox
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner, DoublyRobust, Weighted, bootstrap
from halfseen.logs import Logs
from halfseen.workers import Workers

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
    with pytest.raises(ArgumentError, match="the log has 10 trajectories, but the learner was fitted to 60"):
        bootstrap(learner, logs.select(range(10)))
    with pytest.raises(ArgumentError, match=r"level is 1\.0"):
        bootstrap(learner, logs, num_replicates=2).q_interval(pd.DataFrame([indicators(1, 0)]), 1, level=1.0)
