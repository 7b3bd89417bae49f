"""The fit of the persistent law of seeing: against a loop over looks, and against the law that made the labels."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import norm
from simulated_tables import CALIBRATED, SEEING, evidence

from fitted_laws import FITTED
from halfseen.tables.laws.labels import Labels
from halfseen.tables.laws.persistent_fit import (
    SPREAD,
    centre,
    facing_of,
    fit_persistent,
    intervals_of,
    masses,
    negative_log_posterior,
    views_of,
)
from halfseen.world import PersistentSeeing

SHARE = 0.6
FACING = 0.3
RNG = np.random.default_rng(3)
THETAS = [centre(FACING), centre(FACING) + RNG.normal(size=(2, 5)), 2.0 * RNG.normal(size=(2, 5))]


def law_at(theta, facing=FACING):
    curves = np.cumsum(masses(theta)[:, :-1], axis=1)
    return PersistentSeeing(facing, tuple(views_of(facing)), *(tuple(curve) for curve in curves))


def looks(num_objects, law, seed=0, num_looks=4):
    """Looks at objects one by one, as the law has them; those that show nothing new leave no label."""
    rng = np.random.default_rng(seed)
    rows = []
    for target in range(num_objects):
        is_dirty, seen, shown = rng.random() < SHARE, 0.0, rng.integers(3)
        for _ in range(num_looks):
            is_held = rng.random() < 0.15
            occlusion = 0.0 if is_held or rng.random() < 0.2 else rng.random()
            chance = law.positive(np.float64(occlusion), seen, is_held)[0 if is_dirty else 1]
            says_dirty = bool(rng.random() < chance)
            after = float(law.after(np.float64(occlusion), seen, says_dirty, is_held))
            if chance > 0.0:
                truth = shown == 1 and is_dirty, shown == 1 and not is_dirty
                rows.append((target // 3, target, occlusion, is_held, seen, after, says_dirty, *truth))
            seen = after
    return Labels(*(np.array(column) for column in zip(*rows, strict=True)))


LABELS = looks(60, SEEING)


@pytest.mark.parametrize("theta", THETAS)
def test_posterior_is_what_a_loop_over_looks_gives(theta):
    law, middle = law_at(theta), centre(FACING)
    total = norm.logpdf(theta, middle, SPREAD).sum() - norm.logpdf(middle, middle, SPREAD).sum()
    for target in np.unique(LABELS.object):
        likelihood = np.array([SHARE, 1.0 - SHARE])
        for row in np.flatnonzero(LABELS.object == target):
            finds = np.array(law.positive(LABELS.occlusion[row], LABELS.seen[row], LABELS.is_held[row]))
            likelihood *= finds if LABELS.says_dirty[row] else 1.0 - finds
        total += np.log((likelihood * [not LABELS.was_clean[row], not LABELS.was_dirty[row]]).sum())
    known = intervals_of(LABELS, FACING)
    assert negative_log_posterior(theta, known, middle, SHARE)[0] == pytest.approx(-total, abs=1e-4)


@pytest.mark.parametrize("theta", THETAS)
def test_gradient_is_that_of_the_posterior(theta):
    known, middle = intervals_of(LABELS, FACING), centre(FACING)

    def value(at):
        return negative_log_posterior(at.reshape(2, 5), known, middle, SHARE)[0]

    gradient = negative_log_posterior(theta, known, middle, SHARE)[1]
    np.testing.assert_allclose(gradient.ravel(), approx_fprime(theta.ravel(), value, 1e-7), atol=1e-4)


@pytest.mark.parametrize("scale", [1.0, 5.0, 12.0])
def test_curves_rise_whatever_the_parameters(scale):
    curves = np.cumsum(masses(scale * np.sign(RNG.normal(size=(2, 5)))), axis=1)
    assert (np.diff(curves) >= 0.0).all()
    np.testing.assert_allclose(curves[:, -1], 1.0)


@pytest.mark.parametrize("law", [SEEING, FITTED.seeing])
def test_how_much_an_object_shows_is_what_the_recorder_counted(law):
    assert facing_of(looks(20, law)) == law.facing


def test_in_a_cell_that_sees_all_sides_lifting_shows_no_more():
    law = PersistentSeeing(1.0, (0.5, 1.0), (0.5, 0.8), (0.05, 0.1))
    fitted = fit_persistent(looks(200, law), SHARE)
    assert (fitted.facing, fitted.views) == (1.0, (0.25, 0.5, 0.75, 1.0))


def test_without_labels_the_law_is_the_prior_s():
    law = fit_persistent(LABELS.first(0), SHARE)
    assert law.positive(0.0, 0.0) == pytest.approx((0.5, 0.1))


def test_the_same_labels_give_the_same_bits():
    assert fit_persistent(LABELS, SHARE) == fit_persistent(LABELS, SHARE)


def curves_of(law):
    return np.array([law.sensitivity, law.false_alarms])


def test_the_law_that_was_drawn_from_is_found():
    fitted = fit_persistent(looks(4000, SEEING), SHARE)
    np.testing.assert_allclose(curves_of(fitted), curves_of(SEEING), atol=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(("cut_share", "cut_kind"), [(0.0, "independent"), (0.5, "attempt"), (0.5, "occlusion")])
def test_the_law_that_made_the_labels_is_found_although_labels_choose_what_is_washed(cut_share, cut_kind):
    fits = [
        fit_persistent(evidence(2000, cut_share, cut_kind, config=CALIBRATED, seed=seed).told, SHARE)
        for seed in range(4)
    ]
    found = np.mean([curves_of(law) for law in fits], axis=0)
    np.testing.assert_allclose(found[:, :-1], curves_of(SEEING)[:, :-1], atol=0.02)
    np.testing.assert_allclose(found[:, -1], curves_of(SEEING)[:, -1], atol=0.05)
