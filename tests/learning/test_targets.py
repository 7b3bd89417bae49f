"""What stands for what cuts took: what each kind weighs and imputes, and which combinations cannot be written."""

from dataclasses import fields

import numpy as np
import pandas as pd
import pytest
from trials import ACTIONS, two_stage_trial

from halfseen.censoring import CENSORING_NAMES, Cox
from halfseen.errors import ArgumentError
from halfseen.learning import BuckleyJames, DoublyRobust, KernelQ, NamedActions, Unweighted, Weighted
from halfseen.learning.q_model import QModel
from halfseen.learning.targets import named_targets, targets_of
from halfseen.logs import Logs

KINDS = [Weighted(), DoublyRobust(), BuckleyJames(), Unweighted()]


@pytest.fixture(scope="module")
def logs():
    trial = two_stage_trial(num_paths=80)
    by_lot = pd.Series(np.random.default_rng(0).choice(ACTIONS, trial.num_stages))
    return Logs(trial.stages.assign(action=trial.stages["action"].fillna(by_lot)), trial.paths)


def weighed(logs, targets, **options):
    model, paths = QModel(2, NamedActions(ACTIONS, ["s1_1", "s2_1"]), targets, **options).fitted(logs)
    return model, paths, *model.weights_and_imputation(paths)


def test_weighted_stages_are_the_completed_ones_and_nothing_is_imputed(logs):
    model, paths, weight, imputed = weighed(logs, Weighted(truncate_at=1.5))
    np.testing.assert_array_equal(weight, model.cut_model.weights(paths.clocks))
    assert weight.max() == pytest.approx(1.5)
    assert imputed is None


def test_doubly_robust_stages_weigh_what_the_stage_before_did(logs):
    model, paths, weight, imputed = weighed(logs, DoublyRobust(outcome_covariates=["s2_1"]))
    np.testing.assert_array_equal(weight, model.cut_model.begun_weights(paths.clocks))
    assert imputed.is_used.tolist() == [0.0, 1.0]
    assert imputed.share[paths.is_completed].max() > 1.0
    inverse = np.minimum(np.where(paths.is_completed, imputed.share, 0.0), 3.0)
    np.testing.assert_allclose(imputed.outcome_weight, inverse)


def test_buckley_james_needs_no_model_of_the_cuts(logs):
    model, paths, weight, imputed = weighed(logs, BuckleyJames())
    assert model.cut_model is None
    np.testing.assert_array_equal(weight, paths.is_begun)
    np.testing.assert_array_equal(imputed.share, paths.is_completed)
    assert imputed.is_used.tolist() == [1.0, 1.0]


def test_unweighted_stages_count_alike(logs):
    model, paths, weight, imputed = weighed(logs, Unweighted())
    assert model.cut_model is None
    np.testing.assert_array_equal(weight, paths.is_completed)
    assert imputed is None


def test_the_outcome_regression_chooses_among_the_covariates_of_a_linear_q_only(logs):
    with pytest.raises(ArgumentError, match="it chooses among the covariates of a linear Q only"):
        weighed(logs, DoublyRobust(outcome_covariates=["s2_1"]), space=KernelQ(10))
    _, _, _, imputed = weighed(logs, DoublyRobust(), space=KernelQ(10))
    assert imputed.is_used.all()


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: type(kind).__name__)
def test_no_setting_can_be_given_where_it_means_nothing(kind):
    of_cuts, of_outcome = {"model", "by", "covariates", "truncate_at"}, {"outcome_covariates"}
    allowed = {Weighted: of_cuts, DoublyRobust: of_cuts | of_outcome, BuckleyJames: of_outcome, Unweighted: set()}
    assert {field.name for field in fields(kind)} == allowed[type(kind)]


def test_names_and_models_are_shorthands():
    assert [targets_of(name) for name in CENSORING_NAMES] == [Weighted(name) for name in CENSORING_NAMES]
    assert targets_of("buckley-james") == BuckleyJames()
    assert targets_of("none") == Unweighted()
    model = Cox(ridge=1.0)
    assert targets_of(model) == Weighted(model)
    assert all(targets_of(kind) is kind for kind in KINDS)
    with pytest.raises(ArgumentError, match=r"censoring is 'weibull'; .*'none', Weighted\(…\), DoublyRobust\(…\) or a"):
        targets_of("weibull")


def test_plain_settings_make_the_same():
    settings = {"by": "pooled", "covariates": ["x"], "truncate_at": 9.0}
    assert named_targets("cox", **settings) == Weighted("cox", "pooled", ["x"], 9.0)
    robust = named_targets("cox", **settings, is_doubly_robust=True, outcome_covariates=["z"])
    assert robust == DoublyRobust("cox", "pooled", ["x"], 9.0, ["z"])
    assert named_targets("buckley-james", outcome_covariates=["z"]) == BuckleyJames(["z"])
    assert named_targets("none") == Unweighted()


@pytest.mark.parametrize("name", ["none", "buckley-james"])
@pytest.mark.parametrize("said", [{"by": "stage"}, {"covariates": ["z"]}, {"truncate_at": 9.0}])
def test_what_is_said_of_weights_is_refused_where_there_are_none(name, said):
    (what,) = said
    with pytest.raises(ArgumentError, match=f"{what} is .*, but censoring '{name}' makes no weights; leave it out"):
        named_targets(name, **said)


@pytest.mark.parametrize("name", ["none", "buckley-james"])
def test_doubly_robust_targets_need_a_model_of_the_cuts(name):
    with pytest.raises(
        ArgumentError, match=f"doubly robust targets need a model of the cuts, but censoring is '{name}'"
    ):
        named_targets(name, is_doubly_robust=True)
    with pytest.raises(ArgumentError, match=f"censoring is '{name}'; it is 'kaplan-meier'"):
        DoublyRobust(name)
