import numpy as np
import pytest
from trials import ACTIONS, FULL, two_stage_trial

from halfseen.errors import ArgumentError, PositivityError
from halfseen.learners import CensoredQLearner, DoublyRobust, Weighted
from halfseen.logs import Logs, LogStream
from halfseen.tables import BetaGrasp, TableTask
from halfseen.world import Scene, TableWorld, UniformPolicy


@pytest.fixture(scope="module")
def trial():
    return two_stage_trial()


@pytest.fixture(scope="module")
def tables():
    scene = Scene(np.array([[0.0, 0.6], [0.0, 0.0]]))
    return TableWorld().simulate(scene, UniformPolicy(), episodes=60, seed=0, cut_share=0.3)


def streamed(logs, folder, paths_at_once):
    logs.write(folder, overwrite=True)
    return LogStream(folder, paths_at_once)


@pytest.mark.parametrize(
    "options",
    [
        {"reg": 0.0},
        {"reg": "cv"},
        {"reg": "cv", "stages": "pooled"},
        {"reg": 0.1, "censoring": "cox", "covariates": ["s1_1", "s1_2"], "actions": {1: ACTIONS, 2: ["B", "A"]}},
        {"reg": 0.1, "censoring": Weighted(truncate_at=2.0)},
        {"reg": 0.1, "censoring": "none"},
    ],
    ids=str,
)
def test_passes_learn_what_memory_does(trial, tmp_path, options):
    options = {"actions": ACTIONS, "covariates": FULL, **options}
    whole = CensoredQLearner.of_paper(2, **options).fit(trial)
    parts = CensoredQLearner.of_paper(2, **options).fit(streamed(trial, tmp_path / "logs", 90))
    np.testing.assert_allclose(parts.q_functions_.coefficients, whole.q_functions_.coefficients, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(parts.q_functions_.reg, whole.q_functions_.reg)
    np.testing.assert_array_equal(parts.weights_, whole.weights_)
    assert parts.diagnostics_ == whole.diagnostics_


@pytest.mark.slow
def test_tables_too(tables, tmp_path):
    """Their features are in single precision, the sums are not."""
    options = {"reduces_variance": False, "censoring": "kaplan-meier", "reg": 0.1}
    whole = CensoredQLearner.for_table(10, **options).fit(tables)
    parts = CensoredQLearner.for_table(10, **options).fit(streamed(tables, tmp_path / "t", 25))
    np.testing.assert_allclose(parts.q_functions_.coefficients, whole.q_functions_.coefficients, rtol=1e-7, atol=1e-7)


def test_a_kernels_landmarks_are_sought_in_the_first_part(trial, tmp_path):
    options = {"q_function": "kernel", "reg": 1e-3, "actions": ACTIONS, "covariates": ["s1_1", "s2_1"]}
    whole = CensoredQLearner.of_paper(2, **options).fit(trial)
    parts = CensoredQLearner.of_paper(2, **options).fit(streamed(trial, tmp_path / "logs", 1000))
    np.testing.assert_allclose(parts.q_values(trial.stages, 1), whole.q_values(trial.stages, 1), atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"censoring": Weighted(by="stage")}, "a model of the cuts by stage needs the whole log in memory"),
        ({"censoring": DoublyRobust()}, "censoring=DoublyRobust(…) needs the whole log"),
        ({"censoring": "buckley-james"}, "censoring=BuckleyJames(…) needs the whole log"),
        ({"actions": TableTask(), "covariates": []}, "reduces_variance=True needs the whole log"),
        (
            {"actions": TableTask(BetaGrasp(), reduces_variance=False), "covariates": []},
            "grasp=BetaGrasp(), which is not fitted, needs the whole log",
        ),
        ({"horizon": 1}, "horizon is 1, but a path has 2 stages; raise horizon"),
    ],
)
def test_what_needs_the_whole_log_is_refused(trial, tmp_path, options, message):
    stream = streamed(trial, tmp_path / "logs", 100)
    with pytest.raises(ArgumentError) as refusal:
        CensoredQLearner.of_paper(**{"horizon": 2, "actions": ACTIONS, "covariates": FULL, **options}).fit(stream)
    assert message in str(refusal.value)


def test_all_cut_is_not_identified(trial, tmp_path):
    stages = trial.stages.groupby("path").head(1).assign(elapsed_s=None, reward=None)
    cut = Logs(stages, trial.paths.assign(ending="cut", cause=None))
    with pytest.raises(PositivityError, match="all 400 paths were cut"):
        CensoredQLearner.of_paper(2, ACTIONS, FULL).fit(streamed(cut, tmp_path / "logs", 100))
