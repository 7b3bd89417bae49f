"""Regression of times that were cut: what the examples simulate, estimate, say and draw, each against a reference."""

import re
import runpy
import subprocess
import sys
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from cut_regression.comparison import GRID, compare
from cut_regression.methods import METHODS, REG, cox_median
from cut_regression.settings import CUT_SHARES, CUT_SLOPE, SHAPE, TAU, Sample, Setting, TrueCuts
from cut_regression.words import contrast
from matplotlib.image import imread
from sksurv.linear_model import CoxPHSurvivalAnalysis
from sksurv.util import Surv
from threadpoolctl import threadpool_limits

from halfseen.censoring import Cox, censoring_weights
from halfseen.learning import CensoredSVR, survival_array

EXAMPLES = Path(__file__).parents[2] / "examples"
WAYS = ("linear", "quadratic"), (1, 10), ("uniform", "dependent"), CUT_SHARES
SETTINGS = [Setting(*way) for way in product(*WAYS)]


@pytest.mark.parametrize("setting", SETTINGS)
def test_the_wanted_share_is_cut_and_true_weights_recover_the_true_median(setting):
    """Of the weighted rows half lie below m(z), near any z, and the weights have mean 1 in all."""
    sample = setting.sample(150_000, np.random.default_rng(2))
    assert sample.cut_share == pytest.approx(setting.cut_share, abs=0.006)
    assert sample.covariates.shape == (150_000, setting.num_covariates)
    assert sample.time.min() > 0
    if setting.num_covariates > 1:
        return
    end, is_seen = np.minimum(sample.time, TAU), sample.is_finished | (sample.time >= TAU)
    weights = censoring_weights(end, is_seen, TrueCuts(setting), covariates=sample.covariates)
    assert weights.mean() == pytest.approx(1.0, abs=0.02)
    below = weights * (end <= setting.medians(sample.covariates))
    for low in (0.0, 0.4, 0.8):
        here = (sample.covariates[:, 0] >= low) & (sample.covariates[:, 0] < low + 0.2)
        assert below[here].sum() / here.sum() == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("setting", SETTINGS)
def test_cox_median_is_scikit_survivals(setting):
    sample = setting.sample(150, np.random.default_rng(3))
    asked = np.random.default_rng(4).uniform(size=(40, setting.num_covariates))
    peer = CoxPHSurvivalAnalysis(ties="efron").fit(sample.covariates, Surv.from_arrays(sample.is_finished, sample.time))
    expected = []
    for curve in peer.predict_survival_function(asked):
        below = curve.x[curve.y <= 0.5]
        expected.append(min(below[0], TAU) if len(below) else TAU)
    assert cox_median(sample)(asked) == pytest.approx(np.array(expected), abs=1e-9)


def test_cox_answers_tau_where_its_curve_stays_above_a_half():
    rng = np.random.default_rng(5)
    z = rng.uniform(size=(40, 1))
    sample = Sample(z, rng.uniform(0.1, 4.0, size=40), rng.uniform(size=40) < 0.2)
    ends_above = Cox().fit(sample.time, ~sample.is_finished, z).survival(np.full(40, np.inf), z) > 0.5
    assert 0 < ends_above.sum() < 40
    assert ((cox_median(sample)(z) == TAU) == ends_above).all()


def test_the_interval_is_that_of_the_paired_t_test():
    ours, other = np.array([0.1, 0.3, 0.2]), np.array([0.4, 0.5, 0.6])
    result = contrast(ours, other)
    # Differences −0.3, −0.2, −0.4: mean −0.3, standard error 0.1/√3, and t(0.975, 2) = 4.30265.
    assert result == pytest.approx((0.2, 0.5, -0.3 - 4.30265 * 0.1 / 3**0.5, -0.3 + 4.30265 * 0.1 / 3**0.5), abs=1e-5)


# The bias of each way, with samples large enough to tell, against its limit.

NUM_ROWS, NUM_SAMPLES = 1500, 4
HEAVY = [Setting(median, 1, cuts, 0.5) for median in ("linear", "quadratic") for cuts in ("uniform", "dependent")]
# The edges are left to the kernel.
INNER = (GRID >= 0.05) & (GRID <= 0.95)


@cache
def mean_curve(setting, method):
    """Mean estimate over samples at GRID [s]; λ is small and fixed, so that the bias is the weights'."""
    curves = []
    for r in range(NUM_SAMPLES):
        sample = setting.sample(NUM_ROWS, np.random.default_rng([7, r]))
        if method == "cox-times":
            curves.append(cox_median(sample)(GRID[:, None]))
            continue
        censoring = TrueCuts(setting) if method == "true" else method
        model = CensoredSVR(loss="absolute", censoring=censoring, tau=TAU, reg=1e-3, tol=1e-5)
        with threadpool_limits(1):
            model.fit(sample.covariates, survival_array(sample.time, sample.is_finished))
        curves.append(model.predict(GRID[:, None]))
    return np.mean(curves, axis=0)


def bias(setting, method):
    """Mean of |mean estimate − m(z)| over inner z [s]."""
    return np.abs(mean_curve(setting, method) - setting.medians(GRID[:, None]))[INNER].mean()


def limits(setting):
    """Medians that unweighted uncut rows and Kaplan–Meier weights tend to at GRID [s], by quadrature."""
    edges = np.linspace(0.0, TAU, 1501)
    middle, width = (edges[1:] + edges[:-1]) / 2, edges[1]
    alive = np.exp(-np.log(2.0) * (edges[None] / setting.medians(GRID[:, None])[:, None]) ** SHAPE)
    watched = np.array([setting.cut_survival(middle, np.full((len(middle), 1), z)) for z in GRID])
    hazard = np.exp(CUT_SLOPE * GRID)[:, None] / setting.cut_scale
    at_risk = (alive[:, 1:] + alive[:, :-1]) / 2 * watched
    kaplan_meier = np.exp(-np.cumsum((hazard * at_risk).mean(axis=0) / at_risk.mean(axis=0)) * width)
    mass = -np.diff(alive, axis=1) * watched
    mass = np.column_stack([mass, alive[:, -1] * watched[:, -1]])
    places = np.append(middle, TAU)
    return _medians(mass, places), _medians(mass / np.append(kaplan_meier, kaplan_meier[-1]), places)


def _medians(mass, places):
    share = np.cumsum(mass, axis=1) / mass.sum(axis=1, keepdims=True)
    return places[np.argmax(share >= 0.5, axis=1)]


@pytest.mark.slow
@pytest.mark.parametrize("setting", HEAVY)
def test_weights_take_most_of_the_bias_of_uncut_rows_away(setting):
    uncut = bias(setting, "none")
    assert uncut > 0.2
    assert bias(setting, "true") < uncut / 3
    # Cox's model of the times is near where it is nearly right.
    assert bias(setting, "cox-times") < 0.1 if setting.median == "linear" else bias(setting, "cox-times") > 0.4
    if setting.cuts == "uniform":
        assert max(bias(setting, "kaplan-meier"), bias(setting, "cox")) < uncut / 3
        return
    assert bias(setting, "cox") < 0.7 * bias(setting, "kaplan-meier") < 0.7 * uncut
    # The biases are those that theory foretells.
    foretold, truth = limits(setting), setting.medians(GRID[:, None])
    for method, limit in zip(("none", "kaplan-meier"), foretold, strict=True):
        assert np.abs(mean_curve(setting, method) - limit)[INNER].mean() < 0.1
    far, near = (np.abs(limit - truth).mean() for limit in foretold)
    assert far > 1.8 * near > 0.25


# Scripts.

NUM_LINES = {"linear_median": 2, "quadratic_median": 2, "dependent_cuts": 4, "ten_covariates": 8}
SCRIPTS = sorted(NUM_LINES)
SMALL = ("--repetitions", "1", "--rows", "60", "--seed", "3")


def run(script, *options):
    command = [sys.executable, EXAMPLES / f"{script}.py", *options]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_every_script_is_tested_and_listed():
    there = {path.stem for path in EXAMPLES.glob("*.py")}
    assert there == {*SCRIPTS, "tiger"}
    listed = re.findall(r"`python examples/(\w+)\.py`", (EXAMPLES / "README.md").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted(there)


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_prints_and_draws(script, tmp_path):
    out = tmp_path / "figures"
    first = run(script, *SMALL, "--out", str(out))
    figure = out / f"{script}.png"
    height, width = imread(figure).shape[:2]
    assert min(height, width) > 500

    head, names, *lines, at_tau, sentence, trajectory = first.splitlines()
    assert head.startswith("Mean |estimate − true median| [s] over one sample")
    assert names.split()[-6:] == ["Ĝ", "uncut", "only", "Cox", "times", "constant"]
    assert len(lines) == NUM_LINES[script]
    for line in lines:
        assert re.search(r" 60 +\d\d\.\d%( +\d\.\d{3}){7}$", line), line
    assert at_tau.startswith("Cox's curve of the times stays above ½ in ")
    assert sentence.startswith("With 60 rows, compared with the SVM on uncut rows only, ")
    assert "not told apart by one sample" in sentence
    assert trajectory == f"Figure: {figure}"


@pytest.mark.slow
def test_a_script_prints_and_draws_the_same_again(tmp_path):
    first, again = tmp_path / "first", tmp_path / "again"
    printed = [run(SCRIPTS[0], *SMALL, "--out", str(out)).replace(str(out), "") for out in (first, again)]
    assert printed[0] == printed[1]
    assert len({(out / f"{SCRIPTS[0]}.png").read_bytes() for out in (first, again)}) == 1


@pytest.mark.slow
def test_what_else_is_asked_for_changes_no_number():
    setting = Setting("linear", 1, "uniform", 0.5)
    few, more = compare([setting], [60], 1, 3, REG), compare([setting], [60, 80], 2, 3, REG)
    for method in METHODS:
        assert few.errors_of(setting, 60, method) == more.errors_of(setting, 60, method)[0]
    assert (more.sizes, more.num_repetitions) == ([60, 80], 2)


@pytest.mark.slow
def test_tiger_prints_the_exact_optimum_and_listens_until_it_is_sure(capsys):
    runpy.run_path(str(EXAMPLES / "tiger.py"), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == [
        "horizon 1: worth -1.0000, first listen",
        "horizon 2: worth -1.9500, first listen",
        "horizon 3: worth 2.3098, first listen",
    ]
    assert [line.rsplit(": ", 1)[1] for line in lines[4:]] == ["listen", "listen", "listen", "open right"]
