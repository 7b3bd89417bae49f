import multiprocessing
import os
import signal
import sys

import cloudpickle
import numpy as np
import pandas as pd
import pytest
from trials import ACTIONS, FULL, all_cut

from halfseen.censoring import KaplanMeier, StageClocks
from halfseen.errors import ArgumentError, LogError, PositivityError
from halfseen.learning import CensoredQLearner, DoublyRobust, Weighted, streaming
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.streaming import KeptParts, num_bytes_of
from halfseen.learning.task import Encoded
from halfseen.logs import LogStream
from halfseen.tables import BetaGrasp
from halfseen.workers import Workers
from halfseen.world import Scene, TableWorld, UniformPolicy


@pytest.fixture(scope="module")
def tables():
    scene = Scene(np.array([[0.0, 0.6], [0.0, 0.0]]))
    return TableWorld().simulate(scene, UniformPolicy(), episodes=60, seed=0, cut_share=0.3)


def streamed(logs, folder, trajectories_at_once):
    logs.write(folder, overwrite=True)
    return LogStream(folder, trajectories_at_once)


def squared_root(q_functions):
    """R Rᵀ: R itself may be turned."""
    root = q_functions.root
    return None if root is None else root @ np.swapaxes(root, -1, -2)


def assert_the_same(parts, whole, **tolerance):
    ours, theirs = parts.q_functions_, whole.q_functions_
    np.testing.assert_array_equal(ours.reg, theirs.reg)
    for part in (lambda q: q.coefficients, lambda q: q.outcome, squared_root):
        one, other = part(ours), part(theirs)
        assert (one is None) == (other is None)
        if other is not None:
            scale = max(np.abs(other).max(), 1.0)
            np.testing.assert_allclose(one / scale, other / scale, **tolerance)
    np.testing.assert_array_equal(parts.weights_, whole.weights_)
    for name, value in vars(whole.diagnostics_).items():
        wanted = pytest.approx(value, rel=1e-12) if isinstance(value, float) else value
        assert getattr(parts.diagnostics_, name) == wanted
    assert parts.chosen_ == whole.chosen_


OF_PAPER = {"q_function": "linear", "censoring": "kaplan-meier", "stages": "separate", "pessimism": 0.0}


SUMS_ALONE = [
    OF_PAPER | {"reg": 0.0},
    OF_PAPER,
    OF_PAPER | {"stages": "pooled"},
    OF_PAPER | {"stages": "trend"},
    OF_PAPER | {"reg": 0.1, "censoring": "cox", "covariates": ["s1_1", "s1_2"], "actions": {1: ACTIONS, 2: ["B", "A"]}},
    OF_PAPER | {"reg": 0.1, "censoring": Weighted(truncate_at=2.0)},
    OF_PAPER | {"reg": 0.1, "censoring": Weighted("cox", by="stage", truncate_at=9.0)},
    OF_PAPER | {"reg": 0.1, "censoring": Weighted(by="pooled")},
    OF_PAPER | {"reg": 0.1, "censoring": "none"},
]
BY_SAMPLE = [
    OF_PAPER | {"censoring": "buckley-james"},
    OF_PAPER | {"censoring": DoublyRobust(truncate_at=5.0), "stages": "pooled"},
    OF_PAPER | {"censoring": DoublyRobust("cox", by="stage", outcome_covariates=["s2_1"], truncate_at=5.0)},
    OF_PAPER | {"pessimism": 0.7, "covariates": ["s1_1", "s1_2"], "censoring": "cox"},
    OF_PAPER | {"q_function": "kernel", "reg": 1e-3, "covariates": ["s1_1", "s2_1"]},
    {"covariates": ["s1_1", "s2_1"]},
    {"covariates": ["s1_1", "s2_1"], "stages": "separate"},
    {"covariates": ["s1_1", "s2_1"], "stages": "trend"},
]
"""Something is fitted to a sample of the trajectories."""


@pytest.mark.parametrize(
    ("options", "most"),
    [*((each, 130) for each in SUMS_ALONE), *((each, most) for each in BY_SAMPLE for most in (5_000, 130))],
    ids=str,
)
def test_passes_learn_what_memory_does(known, tmp_path, options, most, monkeypatch):
    monkeypatch.setattr("halfseen.learning.sample.MOST_TRAJECTORIES", most)
    options = {"actions": ACTIONS, "covariates": FULL, **options}
    whole = CensoredQLearner(2, **options).fit(known)
    parts = CensoredQLearner(2, **options).fit(streamed(known, tmp_path / "logs", 90))
    assert_the_same(parts, whole, rtol=1e-9, atol=1e-9)


def test_weights_serve_where_actions_of_cuts_are_not_known(trial, tmp_path):
    learner = CensoredQLearner(2, ACTIONS, FULL, reg=0.1).fit(streamed(trial, tmp_path / "logs", 90))
    assert isinstance(learner.model_.targets, Weighted)


@pytest.mark.slow
@pytest.mark.parametrize("most", [5_000, 40], ids="a sample of {}".format)
@pytest.mark.parametrize(
    "options",
    [{"reduces_variance": False, "censoring": "kaplan-meier", "reg": 0.1}, {"grasp": BetaGrasp()}, {}],
    ids=["of the paper", "Beta", "as it is"],
)
def test_tables_too(tables, tmp_path, options, most, monkeypatch):
    """Their features are in single precision, the sums are not."""
    monkeypatch.setattr("halfseen.learning.sample.MOST_TRAJECTORIES", most)
    whole = CensoredQLearner.for_table(10, laws=None, **options).fit(tables)
    parts = CensoredQLearner.for_table(10, laws=None, **options).fit(streamed(tables, tmp_path / "t", 25))
    assert_the_same(parts, whole, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize(
    ("horizon", "changed", "error", "message"),
    [
        (1, lambda trial: trial, ArgumentError, "horizon is 1, but a trajectory has 2 stages; raise horizon"),
        (2, all_cut, PositivityError, "all 400 trajectories were cut"),
    ],
)
def test_a_log_that_cannot_be_learned_from_is_refused_in_memory_and_in_passes(
    trial, tmp_path, horizon, changed, error, message
):
    logs = changed(trial)
    for each in (logs, streamed(logs, tmp_path / "logs", 100)):
        with pytest.raises(error, match=message):
            CensoredQLearner.of_paper(horizon, ACTIONS, FULL).fit(each)


DEFAULT = {"covariates": ["s1_1", "s2_1"]}
OTHERS = [OF_PAPER, OF_PAPER | {"censoring": DoublyRobust("cox", by="stage", truncate_at=5.0)}]


def bits(learner):
    return [leaf.tobytes() for leaf in learner.q_functions_ if leaf is not None] + [learner.weights_.tobytes()]


@pytest.mark.slow
@pytest.mark.parametrize("options", [DEFAULT, *OTHERS], ids=["default", "paper", "doubly robust by stage"])
def test_one_worker_and_two_learn_the_same_bytes(known, tmp_path, options, monkeypatch):
    monkeypatch.setattr("halfseen.logs.folder.NUM_SHARDS", 3)
    stream = streamed(known, tmp_path / "logs", 40)
    learner = CensoredQLearner(2, **{"actions": ACTIONS, "covariates": FULL, **options})
    one = bits(learner.fit(stream))
    assert len(stream.shards()) > 2
    assert bits(learner.fit(stream, Workers(2))) == one


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["ray", "dask"])
def test_a_cluster_learns_the_same_bytes(known, tmp_path, engine):
    stream = streamed(known, tmp_path / "logs", 40)
    learner = CensoredQLearner(2, ACTIONS, **DEFAULT)
    assert bits(learner.fit(stream, Workers(2, engine))) == bits(learner.fit(stream))


class Killing(KaplanMeier):
    """Ends the worker that asks it first, without a word."""

    def __init__(self, mark=None):
        self.mark = mark

    def survival(self, u, covariates=None):
        if multiprocessing.parent_process() is not None and not self.mark.exists():
            self.mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().survival(u)


@pytest.mark.slow
def test_a_shard_of_a_killed_worker_is_summed_again(known, tmp_path, monkeypatch):
    monkeypatch.setattr("halfseen.logs.folder.NUM_SHARDS", 3)
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    stream = streamed(known, tmp_path / "logs", 40)
    options = {"actions": ACTIONS, "covariates": FULL, **OF_PAPER}
    one = bits(CensoredQLearner(2, **options).fit(stream))
    learner = CensoredQLearner(2, **options | {"censoring": Weighted(Killing(tmp_path / "killed"))})
    assert bits(learner.fit(stream, Workers(2))) == one
    assert (tmp_path / "killed").exists()


@pytest.mark.slow
def test_a_disk_without_room_changes_nothing(known, tmp_path, monkeypatch):
    stream = streamed(known, tmp_path / "logs", 90)
    learner = CensoredQLearner(2, ACTIONS, **DEFAULT, q_function="linear")
    one = bits(learner.fit(stream))
    monkeypatch.setattr(streaming, "MOST_SHARE", 0.0)
    assert bits(learner.fit(stream)) == one


@pytest.mark.slow
def test_a_bad_shard_names_its_trajectory(known, tmp_path):
    stream = streamed(known, tmp_path / "logs", 40)
    file = tmp_path / "logs" / "stages.parquet"
    table = pd.read_parquet(file)
    table.loc[table["trajectory"] == known.trajectory_ids[210], "reward"] = np.nan
    table.to_parquet(file, index=False)
    for workers in (None, Workers(2)):
        with pytest.raises(
            LogError, match=rf"logs: trajectory {known.trajectory_ids[210]}, stage 1: the stage is completed"
        ):
            CensoredQLearner(2, ACTIONS, **DEFAULT).fit(stream, workers)


def part(seed, ids=(2**53, 7)):
    clocks = StageClocks(
        trajectory_ids=np.array(ids, dtype=object if isinstance(ids[0], str) else None),
        elapsed_s=np.array([[1.0, np.nan], [0.5, 2.0]]),
        end_s=np.array([1.5, 2.0]),
        is_finished=np.array([False, True]),
        is_begun=np.broadcast_to(True, (2, 2)),
        covariates=np.zeros((2, 2, 0)),
        covariate_names=("age", "a longer name"),
    )
    encoded = Encoded(np.arange(8.0).reshape(2, 2, 1, 2), np.ones((2, 2, 2), dtype=bool), np.array([[0, 1], [1, 0]]))
    reward = np.random.default_rng(seed).normal(size=(2, 2))
    return TrajectoryArrays(clocks, encoded, np.ones((2, 2), dtype=bool), np.full((2, 2), np.nan), reward)


def assert_same(here, there):
    if isinstance(there, np.ndarray):
        assert here.dtype == there.dtype
        np.testing.assert_array_equal(here, there)
    elif isinstance(there, tuple):
        assert type(here) is type(there)
        for one, other in zip(here, there, strict=True):
            assert_same(one, other)
    else:
        assert here == there


@pytest.mark.parametrize("is_shared", [True, False], ids=["one folder", "one a worker"])
@pytest.mark.parametrize("ids", [("a", "ünïcode"), (2**53, 7)], ids=["texts", "numbers"])
def test_a_part_comes_back_as_it_was_and_nothing_is_left_on_the_disk(is_shared, ids, tmp_path, monkeypatch):
    if is_shared:
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with streaming.kept_parts(2, is_shared) as kept:
        for number in range(2):
            kept.keep("trajectories", number, part(0, ids))
            kept.keep("trajectories", number, part(number, ids))
            assert_same(kept.read("trajectories", number), part(number, ids))
        kept.forget("trajectories", 1)
        assert kept.read("trajectories", 1) is kept.read("rows", 0) is None
    assert not list(tmp_path.iterdir())


def test_what_has_no_room_is_not_kept(tmp_path):
    size = num_bytes_of(part(0))
    for most, is_kept in ((size - 1, False), (size, True)):
        kept = KeptParts(str(tmp_path), True, most)
        kept.keep("trajectories", 0, part(0))
        assert (kept.read("trajectories", 0) is not None) == is_kept == any(tmp_path.iterdir())
    assert num_bytes_of((np.broadcast_to(0.0, (3, 4)), None, np.zeros(2, dtype=np.int8))) == 3 * 4 * 8 + 2


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=repr)
def test_what_ends_while_writing_leaves_what_was_there(tmp_path, monkeypatch, error):
    """A disk that is full keeps nothing of a part, and says nothing; who is killed leaves the part of before."""
    kept = KeptParts(str(tmp_path), True, 10**6)
    kept.keep("trajectories", 0, part(0))

    def half_written(part, file):
        file.write_bytes(b"half a part")
        raise error

    monkeypatch.setattr("joblib.dump", half_written)
    try:
        kept.keep("trajectories", 0, part(1))
        assert [file.name for file in tmp_path.iterdir()] == ["trajectories-0"]
    except KeyboardInterrupt:
        assert isinstance(error, KeyboardInterrupt)
    assert_same(kept.read("trajectories", 0), part(0))
