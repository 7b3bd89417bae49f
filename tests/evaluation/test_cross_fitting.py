"""No path is judged by what it shaped, and what the whole answer changes by is in its interval."""

import numpy as np
import pytest
from enumerated_trial import StatePolicy, specified, trial
from scipy import stats

from halfseen.evaluation import QSpec, evaluate
from halfseen.evaluation.cross_fitting import nuisances_by_folds, nuisances_of
from halfseen.evaluation.estimate import estimate_of
from halfseen.evaluation.off_policy import q_model_of
from halfseen.evaluation.second_order import with_second_order
from halfseen.learning import DoublyRobust, NamedActions
from halfseen.logs import Logs

TARGET = StatePolicy((0.1, 0.8))
BY_COX = DoublyRobust("cox", by="pooled", truncate_at=10.0)


def fitted_by_folds(logs, fold):
    model, paths = q_model_of(TARGET, logs, BY_COX, QSpec()).fitted(logs)
    return list(nuisances_by_folds(model, paths, nuisances_of(model, paths), fold))


def test_what_is_fitted_without_a_fold_does_not_know_it():
    logs = trial(0, cut_rate=0.15)
    fold = np.arange(logs.num_paths) % 4
    late = fold == 3
    stages, paths = logs.stages.copy(), logs.paths.copy()
    stages.loc[np.isin(stages["path"], logs.path_ids[late]), "elapsed_s"] *= 1.25
    paths.loc[late, "end_s"] *= 1.25
    one, other = fitted_by_folds(logs, fold), fitted_by_folds(Logs(stages, paths), fold)
    np.testing.assert_allclose(one[3].uncut[~late], other[3].uncut[~late], rtol=1e-12)
    assert np.abs(one[0].uncut[~late] - other[0].uncut[~late]).max() > 1e-3


def test_the_interval_is_the_wider_of_two():
    influence = np.random.default_rng(0).normal(size=100)
    by_paths = stats.t.ppf(0.975, 39) * influence.std(ddof=1) / 10.0
    calm, wild = np.full(5, influence.mean()), influence.mean() + np.array([-1.0, 1.0, 0.0, 2.0, -2.0])
    narrow, wide = (estimate_of(influence, 40.0, 0.95, without) for without in (calm, wild))
    assert narrow.high - narrow.value == pytest.approx(by_paths)
    by_groups = np.sqrt(4.0 / 5.0 * 10.0)
    assert wide.standard_error == pytest.approx(by_groups)
    assert wide.high - wide.value == pytest.approx(stats.t.ppf(0.975, 4) * by_groups)
    assert narrow.value == wide.value


def test_second_order_terms_are_products_of_standardised_covariates():
    logs = trial(2)
    rng = np.random.default_rng(0)
    wide = Logs(logs.stages.assign(v=rng.normal(3.0, 2.0, logs.num_stages)), logs.paths)
    task, widened = with_second_order(NamedActions(["A", "B"], ["x", "v"]), wide)
    assert task.covariates == ["x", "v", "stage", "x*v", "v*v"]
    x, v = ((wide.stages[name] - wide.stages[name].mean()) / wide.stages[name].std(ddof=0) for name in ("x", "v"))
    np.testing.assert_allclose(widened.stages["x*v"], x * v)
    np.testing.assert_allclose(widened.stages["v*v"], v * v)


def test_cuts_widen_the_interval():
    logs = trial(1, num_paths=300, cut_rate=0.3)
    found = evaluate(TARGET, logs, **specified(BY_COX))
    light = evaluate(TARGET, trial(1, num_paths=300), **specified(BY_COX))
    assert found.doubly_robust.standard_error > 1.5 * light.doubly_robust.standard_error
