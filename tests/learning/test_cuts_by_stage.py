import numpy as np
import pandas as pd
import pytest
from trials import ACTIONS, two_stage_trial

from halfseen.censoring import Cox
from halfseen.errors import ArgumentError, LogError
from halfseen.learning import CensoredQLearner, Weighted
from halfseen.logs import Logs


@pytest.fixture(scope="module")
def logs():
    return two_stage_trial()


@pytest.fixture(scope="module")
def known(logs):
    """The same with the action of every stage, those that were cut included."""
    by_lot = pd.Series(np.random.default_rng(0).choice(ACTIONS, logs.num_stages))
    return Logs(logs.stages.assign(action=logs.stages["action"].fillna(by_lot)), logs.paths)


def learner(**options):
    return CensoredQLearner.of_paper(2, ACTIONS, ["s1_1", "s2_1"], reg=0.1, **options)


def ages(logs):
    """Path, stage, how long the stage was watched, and whether it was completed."""
    rows = []
    for path, stages in logs.stages.groupby("path"):
        before, end_s = 0.0, logs.paths.set_index("path").loc[path, "end_s"]
        for stage, elapsed_s in zip(stages["stage"], stages["elapsed_s"], strict=True):
            is_completed = not np.isnan(elapsed_s)
            # A stage that is cut as it begins is watched for no time at all.
            age = max((elapsed_s if is_completed else end_s) - before, 1e-9)
            rows.append((path, stage - 1, age, is_completed))
            before = elapsed_s
    return pd.DataFrame(rows, columns=["path", "stage", "age", "is_completed"])


def test_actions_can_hasten_cuts(known):
    fitted = learner(censoring=Weighted(Cox(ridge=0.1), by="pooled")).fit(known).cut_model_
    model, columns = fitted.fitted[0]
    assert [name for name, _ in zip(model.covariates_, columns, strict=True)] == ["s1_1", "s2_1", "action=A"]
    rows = ages(known)
    frame = known.stages[["s1_1", "s2_1"]].assign(a=(known.stages["action"] == "A").astype(float))
    by_hand = Cox(ridge=0.1).fit(rows["age"], rows["is_completed"], frame.to_numpy())
    np.testing.assert_allclose(model.coefficients_, by_hand.coefficients_, atol=1e-9)


def test_what_cuts_cannot_depend_on_is_refused(logs, known):
    with pytest.raises(ArgumentError, match=r"path \d+, stage \d: action=A is not known, and cuts are to depend on it"):
        learner(censoring=Weighted("cox", by="stage")).fit(logs)
    with pytest.raises(ArgumentError, match="none of those of all stages differs between paths"):
        learner(censoring=Weighted("cox", by="pooled", covariates=[])).fit(known)
    texts = Logs(known.stages.assign(colour="red"), known.paths)
    with pytest.raises(ArgumentError, match="censoring covariate 'colour' is 'red' in every stage"):
        learner(censoring=Weighted("cox", covariates=["colour"])).fit(texts)
    with pytest.raises(LogError, match="the stages have no column 'weather'"):
        learner(censoring=Weighted("cox", covariates=["weather"])).fit(known)
