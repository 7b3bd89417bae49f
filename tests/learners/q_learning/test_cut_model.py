import numpy as np
import pandas as pd
import pytest
from trials import ACTIONS, naive_survival, two_stage_trial

from halfseen.censoring import Cox, KaplanMeier, stage_weights
from halfseen.errors import ArgumentError, LogError, PositivityError
from halfseen.learners import CensoredQLearner
from halfseen.logs import Logs
from halfseen.world import Scene, TableWorld, UniformPolicy


@pytest.fixture(scope="module")
def logs():
    return two_stage_trial()


@pytest.fixture(scope="module")
def known(logs):
    """The same with the action of every stage, those that were cut included."""
    by_lot = pd.Series(np.random.default_rng(0).choice(ACTIONS, logs.num_stages))
    return Logs(logs.stages.assign(action=logs.stages["action"].fillna(by_lot)), logs.paths)


def learner(**options):
    return CensoredQLearner(2, ACTIONS, ["s1_1", "s2_1"], reg=0.1, **options)


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


@pytest.mark.parametrize("by", ["stage", "pooled"])
def test_weights_are_products_over_stages_by_a_loop(logs, by):
    rows = ages(logs)
    assert set(rows["age"][rows["is_completed"]]) & set(rows["age"][~rows["is_completed"]]), "there are ties"
    weights = np.zeros((logs.num_paths, 2))
    for path, mine in rows.groupby("path"):
        survival = 1.0
        for row in mine.itertuples():
            others = rows if by == "pooled" else rows[rows["stage"] == row.stage]
            if row.is_completed:
                survival *= naive_survival(others["age"].tolist(), others["is_completed"].tolist(), row.age)
                weights[path, row.stage] = 1.0 / survival
    np.testing.assert_allclose(learner(censoring_by=by).fit(logs).weights_, weights, rtol=1e-12)


def test_by_path_it_is_the_paths_own_clock(logs):
    expected = stage_weights(logs.elapsed_s(), logs.end_s, logs.is_finished)
    np.testing.assert_array_equal(learner().fit(logs).weights_, expected)


def test_actions_can_hasten_cuts(known):
    fitted = learner(censoring=Cox(ridge=0.1), censoring_by="pooled").fit(known).cut_model_
    model, columns = fitted.fitted[0]
    assert [name for name, _ in zip(model.covariates_, columns, strict=True)] == ["s1_1", "s2_1", "action=A"]
    rows = ages(known)
    frame = known.stages[["s1_1", "s2_1"]].assign(a=(known.stages["action"] == "A").astype(float))
    by_hand = Cox(ridge=0.1).fit(rows["age"], rows["is_completed"], frame.to_numpy())
    np.testing.assert_allclose(model.coefficients_, by_hand.coefficients_, atol=1e-9)


def test_a_fitted_model_and_one_of_ones_own_are_used(known):
    rows = ages(known)
    fitted = KaplanMeier().fit(rows["age"], rows["is_completed"])
    given = learner(censoring=fitted, censoring_by="pooled").fit(known).weights_
    np.testing.assert_allclose(given, learner(censoring_by="pooled").fit(known).weights_, rtol=1e-12)


def test_begun_weights_are_those_of_the_stage_before(logs):
    fitted = learner(censoring_by="stage").fit(logs)
    begun = fitted.cut_model_.begun_weights(fitted.lay_out(logs))
    assert set(begun[:, 0]) == {1.0}
    np.testing.assert_array_equal(begun[:, 1] > 0, fitted.lay_out(logs).is_begun[:, 1])
    came_on = begun[:, 1] > 0
    np.testing.assert_array_equal(begun[came_on, 1], fitted.weights_[came_on, 0])


@pytest.mark.parametrize("by", ["path", "pooled"])
def test_survival_within_a_stage_falls_from_one_to_what_its_weight_says(known, by):
    fitted = learner(censoring=Cox(ridge=0.1), censoring_by=by).fit(known)
    paths = fitted.lay_out(known)
    steps = np.linspace(0.0, 1.0, 5) * paths.watched_s[..., None]
    within = fitted.cut_model_.survival(paths, steps, paths.is_begun)
    assert (within[..., 0] == 1.0).all()
    assert (np.diff(within, axis=-1) <= 1e-12).all()
    weights, begun = fitted.cut_model_.weights(paths), fitted.cut_model_.begun_weights(paths)
    seen = paths.is_completed
    np.testing.assert_allclose(within[seen][:, -1], begun[seen] / weights[seen])


@pytest.mark.slow
def test_cuts_at_a_table_may_depend_on_the_attempt():
    scene = Scene(np.array([[0.0, 0.6], [0.0, 0.0]]))
    logs = TableWorld().simulate(scene, UniformPolicy(), episodes=150, seed=0, cut_share=0.5, cut_kind="attempt")
    fitted = CensoredQLearner.for_table(10, censoring=Cox(ridge=1.0), censoring_by="pooled", reg=1.0).fit(logs)
    names = fitted.cut_model_.fitted[0].model.covariates_
    assert names == ["num_objects", "mean_occlusion", "action=FINISH", "action=WASH", "target_occlusion"]
    with pytest.raises(ArgumentError, match="'weather' is none of a table's: num_objects, mean_occlusion, action"):
        CensoredQLearner.for_table(10, censoring="cox", censoring_covariates=["weather"]).fit(logs)


def test_what_cuts_cannot_depend_on_is_refused(logs, known):
    with pytest.raises(ArgumentError, match=r"path \d+, stage \d: action=A is not known, and cuts are to depend on it"):
        learner(censoring="cox", censoring_by="stage").fit(logs)
    with pytest.raises(ArgumentError, match="censoring_by is 'clock'; it is 'path', 'stage' or 'pooled'"):
        learner(censoring_by="clock").fit(logs)
    texts = Logs(known.stages.assign(colour="red"), known.paths)
    with pytest.raises(ArgumentError, match="censoring covariate 'colour' holds no numbers"):
        learner(censoring="cox", censoring_covariates=["colour"]).fit(texts)
    with pytest.raises(LogError, match="the stages have no column 'weather'"):
        learner(censoring="cox", censoring_covariates=["weather"]).fit(known)


def test_a_stage_that_nothing_outlived_is_not_identified(logs):
    gone = KaplanMeier().fit([0.5, 1.5], [True, False])
    with pytest.raises(PositivityError, match=r"path \d+, stage 1: completed \d s after it began, where the censoring"):
        learner(censoring=gone, censoring_by="stage").fit(logs)
    truncated = learner(censoring=gone, censoring_by="stage", truncate_at=3.0).fit(logs)
    assert truncated.weights_.max() == pytest.approx(3.0)
