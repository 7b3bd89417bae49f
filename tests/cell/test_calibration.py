"""Laws from attempts and labels: beside naive likelihoods, and beside the truth that made the data."""

import json
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import norm

from halfseen.cell.calibration.grasp_fit import CENTRES, SCALES, fit_grasping
from halfseen.cell.calibration.law import Law
from halfseen.cell.calibration.law_folder import LAW, read_law, write_law
from halfseen.cell.calibration.seeing_fit import VIEWS, fit_seeing, found_by, intervals
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.cell.calibration.time_fit import fit_times
from halfseen.cell.calibration.trials import trials
from halfseen.cell.facts import Facts
from halfseen.errors import LogError, PolicyError
from halfseen.logs import Logs, read_logs
from halfseen.perception.labels import FACING_SHARE
from halfseen.policies.folder.files import write_files

TRUTH = np.array([2.0, -1.0, -1.5, -0.4, 0.3, np.log(0.8)])


def drawn_trials(num_objects, seed, tries=3, cut_rate=0.02):
    """Attempts by the model itself, cut at random; objects of one table are cut together."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(num_objects):
        facts = {"is_lying": float(rng.random() < 0.3), "width_m": rng.normal(0.075, 0.015), "room_m": 0.05}
        facts["room_m"] = float(rng.uniform(0.0, 0.1))
        offset, successes, failures = np.exp(TRUTH[-1]) * rng.normal(), 0, 0
        for _ in range(tries):
            occlusion = float(rng.uniform(0.0, 0.8))
            x = [1.0, occlusion, *((facts[name] - CENTRES[name]) / SCALES[name] for name in facts)]
            held = bool(rng.random() < expit(np.dot(TRUTH[:-1], x) + offset))
            attempt_s = float(np.exp(rng.normal(2.0 if held else 1.5, 0.1)))
            time_s, cut_s = attempt_s + 5.0, rng.exponential(1 / cut_rate)
            rows.append(
                {"path": number // 6, "object": number, "occlusion": occlusion, **facts}
                | {"successes": successes, "failures": failures, "succeeded": held, "attempt_s": attempt_s}
                | {"time_s": min(time_s, cut_s), "is_finished": time_s <= cut_s}
            )
            if time_s > cut_s:
                rows[-1] |= {"succeeded": None, "attempt_s": np.nan}
                break
            successes, failures = successes + held, failures + (not held)
    return pd.DataFrame(rows)


def naive_objective(theta, trials):
    """The penalised log-likelihood, object by object, its integral by adaptive quadrature; nothing was cut."""
    total = 0.0
    for _, rows in trials.groupby("object"):
        x = [
            [1.0, row.occlusion, *((getattr(row, name) - CENTRES[name]) / SCALES[name] for name in CENTRES)]
            for row in rows.itertuples()
        ]
        sign = np.where(rows["succeeded"].astype(bool), 1.0, -1.0)

        def integrand(z, x=x, sign=sign):
            return np.prod(expit(sign * (np.array(x) @ theta[:-1] + np.exp(theta[-1]) * z))) * norm.pdf(z)

        total += np.log(quad(integrand, -9, 9, epsabs=1e-12)[0])
    prior = norm.logpdf(theta, [0, 0, 0, 0, 0, np.log(0.5)], [5, 5, 5, 2, 2, 1]).sum()
    return -(total + prior)


def test_the_regression_is_the_maximum_of_its_likelihood():
    trials = drawn_trials(30, 0, cut_rate=1e-9)
    found = fit_grasping(trials, "none").estimate
    best = naive_objective(found, trials)
    rng = np.random.default_rng(1)
    for _ in range(12):
        assert naive_objective(found + 0.05 * rng.normal(size=6), trials) > best - 1e-6


@pytest.mark.slow
def test_the_truth_lies_within_its_intervals_as_often_as_they_say():
    z = []
    for seed in range(24):
        fit = fit_grasping(drawn_trials(500, 100 + seed, cut_rate=0.02))
        z.append((fit.estimate - TRUTH) / fit.standard_error)
    inside = (np.abs(z) < 1.96).mean(axis=0)
    print("share of intervals that hold the truth:", inside.round(2))
    assert (inside > 0.79).all()


def test_times_are_those_of_attempts_that_hold_and_that_miss():
    times = fit_times(drawn_trials(2000, 3))
    assert times.log_held_s == pytest.approx(2.0, abs=0.02)
    assert times.log_missed_s == pytest.approx(1.5, abs=0.02)
    assert times.log_std == pytest.approx(0.1, abs=0.01)
    assert times.rest_s == pytest.approx(5.0, abs=1e-6)


def test_attempts_that_take_long_are_cut_more_often_and_weighted_for_it():
    trials = drawn_trials(3000, 4, cut_rate=0.08)
    decided = trials[trials["is_finished"]]
    counted = np.log(decided["attempt_s"]).mean()
    weighted = fit_times(trials)
    held = 0.86
    truth = held * 2.0 + (1 - held) * 1.5
    assert counted < truth
    assert weighted.log_held_s == pytest.approx(2.0, abs=0.02)


def labels(*told):
    """One object's labels: hidden share, held or not, what it looked like."""
    occlusions, held, dirty = zip(*told, strict=True)
    return {"glance_occlusions": list(occlusions), "glance_held": list(held), "glance_dirty": list(dirty)}


def test_a_label_that_shows_nothing_new_is_no_news():
    rows = pd.DataFrame(
        [
            labels((0.5, False, False), (0.5, False, True), (0.2, False, False)),
            labels((0.5, False, False), (0.0, False, True), (0.0, True, False)),
            labels((0.0, False, True)),
            labels((0.6, False, False), (0.0, True, True)),
        ]
    )
    half, most = 0.5 * FACING_SHARE, 0.8 * FACING_SHARE
    assert intervals(rows) == [
        (pytest.approx(most), np.inf),
        (pytest.approx(half), pytest.approx(FACING_SHARE)),
        (0.0, pytest.approx(FACING_SHARE)),
        (pytest.approx(0.4 * FACING_SHARE), 1.0),
    ]


def naive_found_by(told):
    """Maximise the likelihood of the masses by a general optimiser."""
    knots = [0.0, *VIEWS]

    def chances(logits):
        mass = np.exp(logits - logits.max())
        return mass / mass.sum()

    def curve(mass, share):
        pieces = zip(pairwise(knots), mass[:-1], strict=True)
        return sum(m * np.clip((share - low) / (high - low), 0.0, 1.0) for (low, high), m in pieces)

    def negative(logits):
        mass = chances(logits)
        each = [(1.0 if np.isinf(high) else curve(mass, high)) - curve(mass, low) for low, high in told]
        return -np.log(np.maximum(each, 1e-300)).sum()

    best = min((minimize(negative, start, method="BFGS") for start in np.eye(6)), key=lambda one: one.fun)
    return np.cumsum(chances(best.x)[:-1]), best.fun, negative


def test_curves_are_the_most_likely_ones():
    rng = np.random.default_rng(5)
    told = []
    for _ in range(60):
        share = rng.choice([rng.uniform(0, FACING_SHARE), rng.uniform(FACING_SHARE, 1.0), np.inf])
        views = np.sort(rng.uniform(0.0, FACING_SHARE, 3))
        views = [0.0, *views, *([1.0] if rng.random() < 0.5 else [])]
        reached = [view for view in views if view >= share]
        told.append((max(v for v in views if v < share), reached[0]) if reached else (views[-1], np.inf))
    curve, *_ = naive_found_by(told)
    ours = found_by(told)
    np.testing.assert_allclose(ours, curve, atol=0.01)
    assert np.all(np.diff([0.0, *ours]) >= 0)


@pytest.fixture(scope="module")
def law():
    trials = drawn_trials(200, 6)
    dirty = labels((0.5, False, False), (0.0, False, True)) | {"is_dirty": True}
    hidden = labels((0.5, False, False), (0.0, True, True)) | {"is_dirty": True}
    clean = labels((0.0, False, False), (0.0, True, False)) | {"is_dirty": False}
    spotted = labels((0.0, False, True)) | {"is_dirty": False}
    glances = pd.DataFrame([dirty] * 5 + [hidden] * 3 + [clean] * 9 + [spotted])
    return Law(fit_grasping(trials), fit_times(trials), fit_seeing(glances), 9.5, np.array([-2.0, 0.0, 0.5]))


def test_a_world_under_the_law_holds_what_the_regression_says(law):
    world = law.config()
    facts = Facts(is_lying=True, width_m=0.095, room_m=0.01)
    x = np.array([1.0, 0.4, 1.0, 1.0, -1.0])
    expected = expit(x @ law.grasp.estimate[:-1] + 0.3)
    held = 1.0 - np.exp(world.grasping.log_failure(np.float64(0.4), law.grip(facts) + 0.3))
    assert held == pytest.approx(expected)
    assert world.transport_s == law.time.rest_s
    assert world.reward_wash_clean == -10.0


def test_a_law_is_read_as_it_was_written(law, tmp_path):
    write_law(law, tmp_path / "law", {"seed": 3})
    stored = read_law(tmp_path / "law")
    assert stored.record["seed"] == 3
    np.testing.assert_array_equal(stored.law.grasp.estimate, law.grasp.estimate)
    assert stored.law.time == law.time
    assert stored.law.seeing == law.seeing
    assert stored.law.limit_s == 9.5
    assert stored.law.grips.tolist() == law.grips.tolist()


def rewritten(law, folder, *, text=None, arrays=None, **record):
    """A law whose files agree with their digests, and say something else."""
    write_law(law, folder, {})
    told = json.loads((folder / LAW.record).read_text()) | record
    content = (text or json.dumps(told)).encode(), arrays or (folder / LAW.arrays).read_bytes()
    write_files(folder, *content, overwrite=True, kind=LAW)
    return folder


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (
            {"parameters": ["log_odds", "colour"]},
            r"law.json: the law tells grasps by .*'colour'\], .* other",
        ),
        ({"version": 9}, "law.json: version 9 is not 1"),
        ({"num_decided": "many"}, "law.json: num_decided is 'many', no count of attempts"),
        ({"text": "[1]"}, r"law.json: version \[1\] is not 1"),
        ({"text": "{"}, "law.json: it cannot be read"),
        ({"arrays": b"none"}, "law.safetensors: no numbers of a law"),
    ],
)
def test_a_law_of_other_objects_or_that_is_none_is_refused(law, tmp_path, what, message):
    with pytest.raises(PolicyError, match=message) as refused:
        read_law(rewritten(law, tmp_path / "law", **what))
    assert "make it anew by `halfseen cell calibrate`" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("length_m", [1e300, -1e6])
def test_what_is_no_length_on_a_table_is_refused(length_m):
    logs = read_logs(shipped_law() / "attempts")
    log = Logs(logs.stages, logs.paths, logs.objects.assign(room_m=length_m))
    with pytest.raises(LogError, match=r"path .*, stage 1: room_m is (1e\+300|-1e\+06), no length on a table"):
        trials(log, 10)


def test_an_attempt_of_weight_two_counts_as_two_and_a_cut_one_as_none():
    trials = drawn_trials(40, 2, cut_rate=0.05)
    decided = trials[trials["is_finished"]]
    with_cuts = fit_grasping(trials, "none").estimate
    np.testing.assert_allclose(with_cuts, fit_grasping(decided, "none").estimate, atol=1e-6)
    assert fit_grasping(trials).num_cut == (~trials["is_finished"]).sum()
