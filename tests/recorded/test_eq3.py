"""Eq. 3 is what it was when it was recorded (see README.md): within 1e-9 of the size of each array.

Where features are made in float32, other compilers round them otherwise, and the fit tells; where a regression of a
late stage rests on few rows, the order in which a processor adds tells: there within `ROUNDED`. The same tables with
the features of the recording (`GivenTables`) are held to 1e-9.
"""

import json
import re
from functools import cache

import numpy as np
import pytest

from halfseen.evaluation import evaluate
from halfseen.learning import bootstrap
from halfseen.logs import read_logs
from recorded.eq3_cases import CASES, FOLDERS, HERE, fitted, numbers_of, q_of_cell, signs_of

CLOSE = 1e-9
ROUNDED = {"tables": 1e-4, "team": 1e-4, "cell/separate-imputed": 2e-8}
"""Of the size of each array, by log or case."""


@cache
def recorded():
    with np.load(HERE / "eq3.npz") as arrays:
        return {name: arrays[name] for name in arrays.files}


@cache
def recorded_lists():
    return json.loads((HERE / "eq3.json").read_text())


def assert_close(found, expected, what, close=CLOSE):
    finite = expected[np.isfinite(expected)]
    size = np.abs(finite).max(initial=0.0)
    np.testing.assert_allclose(found, expected, rtol=close, atol=close * size, err_msg=what)


@pytest.mark.parametrize("name", CASES)
def test_a_fit_is_what_was_recorded(name):
    learner = fitted(name)
    expected = {key.rsplit("/", 1)[1]: value for key, value in recorded().items() if key.startswith(f"{name}/")}
    found = numbers_of(learner, expected)
    if name.startswith(("cell", "trial")):
        found |= q_of_cell(learner)
    assert found.keys() == expected.keys()
    np.testing.assert_array_equal(found.pop("reg"), expected.pop("reg"))
    close = ROUNDED.get(name, ROUNDED.get(CASES[name][0], CLOSE))
    for what, value in expected.items():
        assert_close(found[what], value, what, close)
    assert list(map(numbers_in, learner.chosen_)) == list(map(numbers_in, recorded_lists()[name]["chosen"]))
    for what in ("largest_weight", "effective_sample_size"):
        np.testing.assert_allclose(getattr(learner.diagnostics_, what), recorded_lists()[name][what], rtol=CLOSE)


@pytest.fixture(scope="module")
def cell():
    return fitted("cell/pooled-imputed")


@pytest.mark.slow
def test_bootstrap_draws_are_what_was_recorded(cell):
    again = bootstrap(cell, read_logs(FOLDERS["cell"]), 20)
    found = np.asarray(again.replicates.coefficients) * signs_of(cell, recorded()["cell/pooled-imputed/coefficients"])
    assert found.shape[0] == 20
    assert_close(found[:3], recorded()["cell/bootstrap/coefficients"], "coefficients")


def test_an_evaluation_is_what_was_recorded(cell):
    """But for the doubly robust value, whose weights are of states now, and what follows from it."""
    found = json.loads(json.dumps(evaluate(cell.policy_, read_logs(FOLDERS["later"])).as_dict()))
    expected = recorded_lists()["cell/evaluation"]
    for name in ("importance_sampling", "fitted_q", "logging", "support", "num_trajectories", "level", "reward_unit"):
        assert_same(found[name], expected[name])


def numbers_in(text):
    """What a sentence says, whatever its words."""
    return re.findall(r"-?[0-9]+[.]?[0-9]*", text)


def assert_same(found, expected, close=CLOSE):
    """Numbers are close, those in sentences are the same."""
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for key in expected:
            assert_same(found[key], expected[key], close)
    elif isinstance(expected, list):
        assert len(found) == len(expected)
        for pair in zip(found, expected, strict=True):
            assert_same(*pair, close)
    elif isinstance(expected, float):
        np.testing.assert_allclose(found, expected, rtol=close, atol=close)
    elif isinstance(expected, str):
        assert numbers_in(found) == numbers_in(expected)
    else:
        assert found == expected
