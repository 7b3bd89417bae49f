"""Fits of both laws of seeing: against a loop over looks, and against the laws that made the labels."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import norm
from simulated_tables import CALIBRATED, SEEING, evidence

from fitted_laws import FITTED
from halfseen.tables.evidence import Labels, of_first
from halfseen.tables.law_seeing import Independent, Persistent, masses
from halfseen.tables.recorder import seeing_of
from halfseen.world import AssumedSeeing, PersistentSeeing, WorldConfig
from halfseen.world.seeing import label_evidence

SHARE = 0.6
RNG = np.random.default_rng(3)
CUTS = [(0.0, "independent"), (0.5, "attempt"), (0.5, "occlusion")]


def some_labels(num=80, num_objects=15, seed=0):
    """Labels of a recorder to whom each look is news."""
    rng = np.random.default_rng(seed)
    target = np.append(np.arange(num_objects), rng.integers(0, num_objects, num - num_objects))
    occlusion = np.where(rng.random(num) < 0.1, 1.0, rng.random(num))
    shown = rng.choice(3, num_objects)[target]
    no_views = np.zeros(num, dtype=bool), np.zeros(num), np.zeros(num)
    return Labels(
        target // 3, target, occlusion, *no_views, rng.random(num) < 0.6, shown == 1, shown == 2, np.zeros(num)
    )


def looks(num_objects, law, seed=0, num_looks=4, recorder=None):
    """Looks at objects one by one, as a law has them; those that show nothing new leave no label."""
    rng, target, seen, each = np.random.default_rng(seed), np.arange(num_objects), np.zeros(num_objects), []
    is_dirty, shown = rng.random(num_objects) < SHARE, rng.integers(3, size=num_objects)
    truth = (shown == 1) & is_dirty, (shown == 1) & ~is_dirty
    for _ in range(num_looks):
        is_held = rng.random(num_objects) < 0.15
        occlusion = np.where(is_held | (rng.random(num_objects) < 0.2), 0.0, rng.random(num_objects))
        chance = np.where(is_dirty, *law.positive(occlusion, seen, is_held))
        says_dirty = rng.random(num_objects) < chance
        after = law.after(occlusion, seen, says_dirty, is_held)
        moved = label_evidence(*(recorder or law).positive(occlusion, seen, is_held), says_dirty)
        labels = Labels(target // 3, target, occlusion, is_held, seen, after, says_dirty, *truth, moved)
        each.append([values[chance > 0.0] for values in labels])
        seen = after
    result = Labels(*map(np.concatenate, zip(*each, strict=True)))
    by_object = np.argsort(result.object, kind="stable")
    return Labels(*(values[by_object] for values in result))


def persistent_law(theta):
    curves = np.cumsum(masses(theta)[:, :-1], axis=1)
    return PersistentSeeing(KNOWN.facing, tuple(KNOWN.views), *(tuple(curve) for curve in curves))


LABELS = looks(60, SEEING)
KNOWN = Persistent(LABELS, SHARE)


def fitted_law(family):
    return family.law(family.fitted(family.prior))


def fit_independent(expected, share):
    return fitted_law(Independent(expected, share))


def fit_persistent(expected, share):
    return fitted_law(Persistent(expected, share))


class Family(NamedTuple):
    labels: Labels
    law: Any
    loss: Any
    prior: Any
    thetas: list
    finds: Any
    """P(DIRTY is said) of a label, if it is dirty and if it is clean."""


NEWS = Independent(some_labels(), SHARE)
INDEPENDENT = Family(
    some_labels(),
    NEWS.law,
    lambda theta: NEWS.loss(theta, NEWS.prior),
    NEWS.prior,
    [NEWS.prior.mode, np.array([0.4, -1.0, 0.4]), np.array([-1.0, -4.0, -0.6])],
    lambda law, occlusion, seen, is_held: (law.accuracy(occlusion), 1.0 - law.accuracy(occlusion)),
)
PERSISTENT = Family(
    LABELS,
    persistent_law,
    lambda theta: KNOWN.loss(theta, KNOWN.prior),
    KNOWN.prior,
    [KNOWN.prior.mode, KNOWN.prior.mode + RNG.normal(size=10), 2.0 * RNG.normal(size=10)],
    lambda law, occlusion, seen, is_held: law.positive(occlusion, seen, is_held),
)
BOTH = pytest.mark.parametrize("family", [INDEPENDENT, PERSISTENT], ids=["independent", "persistent"])


@pytest.mark.parametrize("k", range(3))
@BOTH
def test_posterior_is_what_a_loop_over_looks_gives(family, k):
    theta, labels, prior = family.thetas[k], family.labels, family.prior
    total, law = norm.logpdf(theta, *prior).sum() - norm.logpdf(prior.mode, *prior).sum(), family.law(theta)
    for target in np.unique(labels.object):
        likelihood = np.array([SHARE, 1.0 - SHARE])
        for row in np.flatnonzero(labels.object == target):
            finds = np.array(family.finds(law, labels.occlusion[row], labels.seen[row], labels.is_held[row]))
            likelihood *= finds if labels.says_dirty[row] else 1.0 - finds
        total += np.log((likelihood * [not labels.was_clean[row], not labels.was_dirty[row]]).sum())
    assert family.loss(theta)[0] == pytest.approx(-total, abs=1e-9 if family is INDEPENDENT else 1e-4)


@pytest.mark.parametrize("k", range(3))
@BOTH
def test_gradient_is_that_of_the_posterior(family, k):
    theta = family.thetas[k]
    numeric = approx_fprime(theta.ravel(), lambda at: family.loss(at)[0], 1e-7)
    np.testing.assert_allclose(family.loss(theta)[1].ravel(), numeric, atol=1e-4)


def test_without_labels_the_laws_are_the_priors():
    law = fit_independent(of_first(some_labels(), 0), SHARE)
    assert (law.accuracy(0.0), law.power) == pytest.approx((0.75, 1.0))
    assert fit_persistent(of_first(LABELS, 0), SHARE).positive(0.0, 0.0) == pytest.approx((0.5, 0.1))


@pytest.mark.parametrize("scale", [1.0, 5.0, 12.0])
def test_curves_rise_whatever_the_parameters(scale):
    curves = np.cumsum(masses(scale * np.sign(RNG.normal(size=10))), axis=1)
    assert (np.diff(curves) >= 0.0).all()
    np.testing.assert_allclose(curves[:, -1], 1.0)


@pytest.mark.parametrize("law", [SEEING, FITTED.seeing])
def test_how_much_an_object_shows_is_what_the_recorder_counted(law):
    assert Persistent(looks(20, law), SHARE).facing == law.facing


def test_in_a_cell_that_sees_all_sides_lifting_shows_no_more():
    law = PersistentSeeing(1.0, (0.5, 1.0), (0.5, 0.8), (0.05, 0.1))
    fitted = fit_persistent(looks(200, law), SHARE)
    assert (fitted.facing, fitted.views) == (1.0, (0.25, 0.5, 0.75, 1.0))


def curves_of(law):
    return np.array([law.sensitivity, law.false_alarms])


def test_the_persistent_law_that_was_drawn_from_is_found():
    fitted = fit_persistent(looks(4000, SEEING), SHARE)
    np.testing.assert_allclose(curves_of(fitted), curves_of(SEEING), atol=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(("cut_share", "cut_kind"), CUTS)
def test_the_laws_that_made_the_labels_are_found_although_labels_choose_what_is_washed(cut_share, cut_kind):
    def found(fit, reads, config):
        labels = [evidence(2000, cut_share, cut_kind, config=config, seed=seed).labels for seed in range(4)]
        return np.mean([reads(fit(each, SHARE)) for each in labels], axis=0)

    shares = np.array([0.0, 0.2, 0.5, 0.8])
    accuracy = found(fit_independent, lambda law: law.accuracy(shares), WorldConfig())
    np.testing.assert_allclose(accuracy, WorldConfig().seeing.accuracy(shares), atol=0.012)
    curves = found(fit_persistent, curves_of, CALIBRATED)
    np.testing.assert_allclose(curves[:, :-1], curves_of(SEEING)[:, :-1], atol=0.02)
    np.testing.assert_allclose(curves[:, -1], curves_of(SEEING)[:, -1], atol=0.05)


@pytest.mark.slow
def test_what_is_washed_is_chosen_by_its_labels_which_the_fit_takes_in():
    labels, right = evidence(2000).labels, WorldConfig().seeing.accuracy(0.0)
    in_view = labels.occlusion == 0.0
    # Of washed objects labels say DIRTY more often than of others, be they dirty or clean.
    assert np.mean(labels.says_dirty[in_view & labels.was_dirty]) > right + 0.02
    assert np.mean(~labels.says_dirty[in_view & labels.was_clean]) < right - 0.02
    assert abs(fit_independent(labels, SHARE).accuracy(0.0) - right) < 0.012


def wrong(law):
    """A recorder that takes the whole view for surer than it is."""
    return PersistentSeeing(
        law.facing, law.views, (*law.sensitivity[:3], 0.95, 0.99), (*law.false_alarms[:3], 0.085, 0.09)
    )


@pytest.mark.parametrize("law", [SEEING, FITTED.seeing], ids=["quarters", "other knots"])
def test_the_recorders_law_is_read_back_from_its_log_odds(law):
    found = seeing_of(looks(300, law), SHARE)
    assert not found.is_rejected
    shown = np.linspace(0.01, 0.99, 50) * law.facing
    np.testing.assert_allclose(found.recorder.found_by(shown), law.found_by(shown), atol=2e-3)
    # Few labels move it little.
    np.testing.assert_allclose(found.law.found_by(shown), law.found_by(shown), atol=0.05)


@pytest.mark.slow
def test_a_right_recorder_is_rejected_as_rarely_as_the_level_says():
    rejected = [seeing_of(looks(120, SEEING, seed), SHARE).is_rejected for seed in range(20)]
    assert sum(rejected) <= 1


def test_labels_reject_a_recorder_that_is_too_sure_and_the_law_is_fitted_to_them():
    found = seeing_of(looks(3000, SEEING, recorder=wrong(SEEING)), SHARE)
    assert found.is_rejected
    np.testing.assert_allclose(curves_of(found.law), curves_of(SEEING), atol=0.06)
    np.testing.assert_allclose(curves_of(found.recorder), curves_of(wrong(SEEING)), atol=2e-3)


@pytest.mark.slow
def test_log_odds_that_no_law_of_the_family_made_tell_of_no_recorder():
    result = looks(80, SEEING)
    found = seeing_of(result._replace(moved=result.moved * np.where(np.arange(len(result.moved)) % 2, 1.0, 2.0)), SHARE)
    assert found.recorder is None
    np.testing.assert_allclose(curves_of(found.law), curves_of(fit_persistent(result, SHARE)))


@pytest.mark.slow
@pytest.mark.parametrize(("share", "is_read"), [(0.03, True), (0.2, False)])
def test_some_views_that_are_remembered_otherwise_hide_no_recorder(share, is_read):
    result = looks(150, SEEING)
    is_other = np.random.default_rng(1).random(len(result.moved)) < share
    occlusion = np.where(is_other & ~result.is_held, 0.5 * result.occlusion, result.occlusion)
    recorder = seeing_of(result._replace(occlusion=occlusion), SHARE).recorder
    assert (recorder is not None) is is_read
    if recorder is not None:
        np.testing.assert_allclose(curves_of(recorder), curves_of(SEEING), atol=2e-3)


def test_an_independent_recorder_is_read_back_too():
    law, labels = AssumedSeeing(0.52, 0.31, 1.3), some_labels(num=400, num_objects=200)
    evidence_of_labels = label_evidence(*law.positive(labels.occlusion, labels.seen), labels.says_dirty)
    found = seeing_of(labels._replace(moved=evidence_of_labels), SHARE)
    shares = np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(found.recorder.accuracy(shares), law.accuracy(shares), atol=1e-3)


@pytest.mark.slow
def test_a_law_that_is_given_is_where_few_labels_leave_it():
    few = of_first(LABELS, 4)
    contradictory = few._replace(moved=np.arange(len(few.moved), dtype=float) - 3.0)
    found = seeing_of(contradictory, SHARE, known=SEEING)
    assert found.recorder is None
    shown = np.linspace(0.01, 0.3, 20)
    np.testing.assert_allclose(found.law.found_by(shown), SEEING.found_by(shown), atol=0.05)
