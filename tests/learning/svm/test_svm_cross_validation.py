import numpy as np
import pytest
from sklearn.model_selection import KFold, RepeatedKFold

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredSVR, survival_array
from halfseen.learning.svm import cross_validation
from halfseen.learning.svm.kernels import RbfKernel
from halfseen.learning.svm.losses import named_loss
from halfseen.learning.svm.solver import Problem, solve
from halfseen.learning.svm.spaces import GramSpace

GAMMA = 2.0


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(5)
    rows = rng.uniform(size=(240, 2))
    time = np.exp(np.sin(5 * rows[:, 0]) + 0.4 * rng.normal(size=240))
    cut = rng.exponential(4.0, size=240)
    return rows, survival_array(np.minimum(time, cut), time <= cut)


def naive_losses(rows, y, weights, loss, regs, splits):
    """A fit for every fold and λ, each from nothing."""
    kernel, seen = RbfKernel(GAMMA), weights > 0
    losses = np.zeros(len(regs))
    for fitted, held in splits:
        fitted, held = fitted[seen[fitted]], held[seen[held]]
        num_rows = len(rows) * len(fitted) / seen.sum()
        for k, reg in enumerate(regs):
            space = GramSpace(kernel(rows[fitted], rows[fitted]))
            found = solve(Problem(space, y[fitted], weights[fitted] / num_rows, loss, float(reg), True))
            f = kernel(rows[held], rows[fitted]) @ found.coefficients + found.offset
            losses[k] += weights[held] @ loss.value(y[held], f)
    return losses / sum(weights[held].sum() for _, held in splits)


@pytest.mark.parametrize("loss", ["squared", "absolute", "huber"])
def test_losses_are_those_of_a_naive_loop_and_the_least_is_chosen(log, loss):
    rows, y = log
    splits = list(KFold(4, shuffle=True, random_state=3).split(rows))
    model = CensoredSVR(loss, gamma=GAMMA, cv=splits).fit(rows, y)
    naive = naive_losses(rows, y["time"], model.weights_, named_loss(loss), model.cv_regs_, splits)
    tried = np.isfinite(model.cv_losses_[0])
    np.testing.assert_allclose(model.cv_losses_[0][tried], naive[tried], rtol=2e-3)
    assert model.reg_ == model.cv_regs_[np.argmin(naive)]


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["absolute", "epsilon-insensitive"])
def test_giving_up_spares_work_and_changes_no_choice(log, loss, monkeypatch):
    rows, y = log
    quick = CensoredSVR(loss, gamma="cv").fit(rows, y)
    monkeypatch.setattr(cross_validation, "_HOPELESS", np.inf)
    patient = CensoredSVR(loss, gamma="cv").fit(rows, y)
    assert np.isinf(quick.cv_losses_).any()
    assert np.isfinite(patient.cv_losses_).all()
    assert (quick.reg_, quick.gamma_) == (patient.reg_, patient.gamma_)
    np.testing.assert_array_equal(quick.predict(rows), patient.predict(rows))


@pytest.mark.parametrize(
    "splits",
    [
        pytest.param(
            lambda rows: list(RepeatedKFold(n_splits=3, n_repeats=2, random_state=0).split(rows)), id="repeated"
        ),
        pytest.param(lambda rows: [(np.arange(120, 240), np.arange(60))], id="some are never held out"),
    ],
)
def test_every_split_counts_and_rows_that_none_holds_out_do_not(log, splits):
    rows, y = log
    chosen = splits(rows)
    model = CensoredSVR("squared", gamma=GAMMA, cv=chosen).fit(rows, y)
    naive = naive_losses(rows, y["time"], model.weights_, named_loss("squared"), model.cv_regs_, chosen)
    tried = np.isfinite(model.cv_losses_[0])
    np.testing.assert_allclose(model.cv_losses_[0][tried], naive[tried], rtol=1e-6)


def test_splits_without_rows_that_were_seen(log):
    rows, y = log
    cut, seen = np.flatnonzero(~y["is_finished"]), np.flatnonzero(y["is_finished"])
    telling = [(seen[:80], seen[80:])]
    alone = CensoredSVR("squared", gamma=GAMMA, cv=telling).fit(rows, y)
    beside = CensoredSVR("squared", gamma=GAMMA, cv=[(seen, cut), *telling]).fit(rows, y)
    np.testing.assert_array_equal(beside.cv_losses_, alone.cv_losses_)
    with pytest.raises(ArgumentError, match="cv: split 1 fits to no row that was seen"):
        CensoredSVR("squared", gamma=GAMMA, cv=[*telling, (cut, seen)]).fit(rows, y)
    with pytest.raises(ArgumentError, match="cv: no split holds out a row that was seen"):
        CensoredSVR("squared", gamma=GAMMA, cv=[(seen, cut)]).fit(rows, y)
