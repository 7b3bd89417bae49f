"""What stands for what cuts took: what each kind weighs and imputes, and which combinations cannot be written."""

import numpy as np
import pandas as pd
import pytest
from trials import ACTIONS, two_stage_trial, with_known_actions

from halfseen.censoring import CENSORING_NAMES, Cox
from halfseen.errors import ArgumentError, LogError
from halfseen.learning import BuckleyJames, CensoredQLearner, DoublyRobust, KernelQ, NamedActions, Unweighted, Weighted
from halfseen.learning.q_model import QModel
from halfseen.learning.targets import named_targets, targets_of
from halfseen.logs import Logs

KINDS = [Weighted(), DoublyRobust(), BuckleyJames(), Unweighted()]


@pytest.fixture(scope="module")
def logs():
    return with_known_actions(two_stage_trial(num_trajectories=80))


def weighed(logs, targets, **options):
    model, trajectories = QModel(2, NamedActions(ACTIONS, ["s1_1", "s2_1"]), targets, **options).fitted(logs)
    return model, trajectories, *model.weights_and_imputation(trajectories)


@pytest.mark.parametrize(
    ("targets", "weights"),
    [
        (Weighted(truncate_at=1.5), lambda model, trajectories: model.cut_model.weights(trajectories.clocks)),
        (
            DoublyRobust(outcome_covariates=["s2_1"]),
            lambda model, trajectories: model.cut_model.begun_weights(trajectories.clocks),
        ),
        (BuckleyJames(), lambda model, trajectories: trajectories.is_begun),
        (Unweighted(), lambda model, trajectories: trajectories.is_completed),
    ],
    ids=lambda each: getattr(type(each), "__name__", ""),
)
def test_what_stages_weigh_and_what_is_imputed(logs, targets, weights):
    model, trajectories, weight, imputed = weighed(logs, targets)
    np.testing.assert_array_equal(weight, weights(model, trajectories))
    assert (imputed is None) == isinstance(targets, Weighted | Unweighted)
    assert (model.cut_model is None) == isinstance(targets, BuckleyJames | Unweighted)
    if isinstance(targets, Weighted):
        assert weight.max() == pytest.approx(1.5)
    if isinstance(targets, DoublyRobust):
        assert imputed.is_used.tolist() == [0.0, 1.0]
        assert imputed.share[trajectories.is_completed].max() > 1.0
        inverse = np.minimum(np.where(trajectories.is_completed, imputed.share, 0.0), 3.0)
        np.testing.assert_allclose(imputed.outcome_weight, inverse)
    if isinstance(targets, BuckleyJames):
        np.testing.assert_array_equal(imputed.share, trajectories.is_completed)
        assert imputed.is_used.tolist() == [1.0, 1.0]


def test_the_outcome_regression_chooses_among_the_covariates_of_a_linear_q_only(logs):
    with pytest.raises(ArgumentError, match="it chooses among the covariates of a linear Q only"):
        weighed(logs, DoublyRobust(outcome_covariates=["s2_1"]), space=KernelQ(10))
    _, _, _, imputed = weighed(logs, DoublyRobust(), space=KernelQ(10))
    assert imputed.is_used.all()


def test_names_and_models_are_shorthands():
    assert [targets_of(name) for name in CENSORING_NAMES] == [Weighted(name) for name in CENSORING_NAMES]
    assert targets_of("buckley-james") == BuckleyJames()
    assert targets_of("none") == Unweighted()
    model = Cox(ridge=1.0)
    assert targets_of(model) == Weighted(model)
    assert all(targets_of(kind) is kind for kind in KINDS)


def test_plain_settings_make_the_same():
    settings = {"by": "pooled", "covariates": ["x"], "truncate_at": 9.0}
    assert named_targets("cox", **settings) == Weighted("cox", "pooled", ["x"], 9.0)
    robust = named_targets("cox", **settings, is_doubly_robust=True, outcome_covariates=["z"])
    assert robust == DoublyRobust("cox", "pooled", ["x"], 9.0, ["z"])
    assert named_targets("buckley-james", outcome_covariates=["z"]) == BuckleyJames(["z"])
    assert named_targets("none") == Unweighted()


@pytest.mark.parametrize("name", ["none", "buckley-james"])
def test_what_needs_a_model_of_the_cuts_is_refused_where_there_is_none(name):
    weighs = "{} is .*, but censoring '" + name + "' makes no weights; leave it out"
    for said, message in (
        ({"by": "stage"}, weighs.format("by")),
        ({"covariates": ["z"]}, weighs.format("covariates")),
        ({"truncate_at": 9.0}, weighs.format("truncate_at")),
        ({"is_doubly_robust": True}, f"doubly robust targets need a model of the cuts, but censoring is '{name}'"),
    ):
        with pytest.raises(ArgumentError, match=message):
            named_targets(name, **said)
    with pytest.raises(ArgumentError, match=f"censoring is '{name}'; it is 'kaplan-meier'"):
        DoublyRobust(name)


def learner(**options):
    return CensoredQLearner.of_paper(2, ACTIONS, ["s1_1", "s2_1"], reg=0.1, **options)


def ages(logs):
    """Path, stage, how long the stage was watched, and whether it was completed."""
    rows = []
    for trajectory, stages in logs.stages.groupby("trajectory"):
        before, end_s = 0.0, logs.trajectories.set_index("trajectory").loc[trajectory, "end_s"]
        for stage, elapsed_s in zip(stages["stage"], stages["elapsed_s"], strict=True):
            is_completed = not np.isnan(elapsed_s)
            # A stage that is cut as it begins is watched for no time at all.
            age = max((elapsed_s if is_completed else end_s) - before, 1e-9)
            rows.append((trajectory, stage - 1, age, is_completed))
            before = elapsed_s
    return pd.DataFrame(rows, columns=["trajectory", "stage", "age", "is_completed"])


def test_actions_can_hasten_cuts(known):
    fitted = learner(censoring=Weighted(Cox(ridge=0.1), by="pooled")).fit(known).cut_model_
    model, columns = fitted.fitted[0]
    assert [name for name, _ in zip(model.covariates_, columns, strict=True)] == ["s1_1", "s2_1", "action=A"]
    rows = ages(known)
    frame = known.stages[["s1_1", "s2_1"]].assign(a=(known.stages["action"] == "A").astype(float))
    by_hand = Cox(ridge=0.1).fit(rows["age"], rows["is_completed"], frame.to_numpy())
    np.testing.assert_allclose(model.coefficients_, by_hand.coefficients_, atol=1e-9)


def test_what_cuts_cannot_depend_on_is_refused(trial, known):
    with pytest.raises(
        ArgumentError, match=r"trajectory \d+, stage \d: action=A is not known, and cuts are to depend on it"
    ):
        learner(censoring=Weighted("cox", by="stage")).fit(trial)
    with pytest.raises(ArgumentError, match="none of those of all stages differs between trajectories"):
        learner(censoring=Weighted("cox", by="pooled", covariates=[])).fit(known)
    texts = Logs(known.stages.assign(colour="red"), known.trajectories)
    with pytest.raises(ArgumentError, match="censoring covariate 'colour' is 'red' in every stage"):
        learner(censoring=Weighted("cox", covariates=["colour"])).fit(texts)
    with pytest.raises(LogError, match="the stages have no column 'weather'"):
        learner(censoring=Weighted("cox", covariates=["weather"])).fit(known)
