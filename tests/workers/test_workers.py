"""Pieces come back, all of them and once, whichever robot makes them and whatever happens to these."""

import os
import signal
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cloudpickle
import numpy as np
import pytest

from halfseen.errors import ArgumentError, WorkerError
from halfseen.workers import Workers
from halfseen.workers.pool import made, versions
from refusals import refused_type

ENGINES = [Workers(1), Workers(2), pytest.param(Workers(2, "dask"), marks=pytest.mark.slow)]
ENGINES += [pytest.param(Workers(2, "ray"), marks=pytest.mark.slow)]
# The workers of a cluster cannot import tests.
cloudpickle.register_pickle_by_value(sys.modules[__name__])
WORKED = [Workers(2), *ENGINES[2:]]


def squared(number: int) -> int:
    return number**2


def slowly_squared(number: int) -> int:
    time.sleep(0.3)
    return number**2


def drawn(number: int) -> bytes:
    """Sums of which the bits depend on the number of threads that add up."""
    rows = np.random.default_rng(number).normal(size=(300, 300))
    return (rows @ rows @ np.linalg.inv(rows)).tobytes()


def process_of(number: int) -> int:
    return os.getpid()


def refused(number: int) -> int:
    if number == 2:
        raise ArgumentError("number is 2; take 3")
    return number


def killed_once(mark: Path, number: int) -> int:
    """End the worker without a word, the first time that it gets to 3."""
    if number == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def always_killed(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def out_of_memory(number: int) -> int:
    raise MemoryError


@pytest.mark.slow
@pytest.mark.parametrize("workers", ENGINES)
def test_every_piece_comes_back_once_with_the_bits_of_one_process(workers):
    with Workers(1).ready() as alone, workers.ready() as pool:
        assert dict(pool.each(squared, range(12))) == {number: number**2 for number in range(12)}
        assert list(pool.in_order(squared, range(12))) == [number**2 for number in range(12)]
        assert list(pool.each(squared, [])) == []
        assert list(pool.in_order(drawn, range(4))) == list(alone.in_order(drawn, range(4)))


def test_nobody_else_begins_for_little_work(monkeypatch):
    # Little it is on a machine that stops for a while, too.
    monkeypatch.setattr("halfseen.workers.pool.time", SimpleNamespace(monotonic=lambda: 0.0))
    with Workers().ready_if_worth() as pool:
        assert list(pool.in_order(process_of, range(6))) == [os.getpid()] * 6


def test_workers_begin_where_much_is_left_and_those_that_were_asked_for_at_once(monkeypatch):
    monkeypatch.setattr("halfseen.workers.workers.num_cores", lambda: 2)
    with Workers(2).ready_if_worth() as pool:
        assert os.getpid() not in list(pool.in_order(process_of, range(3)))
    monkeypatch.setattr("halfseen.workers.pool.WORTH_S", 0.0)
    with Workers().ready_if_worth() as pool:
        first, *others = pool.in_order(process_of, range(6))
        assert first == os.getpid()
        assert os.getpid() not in others
        assert os.getpid() not in list(pool.in_order(process_of, range(3)))


@pytest.mark.parametrize("workers", ENGINES)
def test_an_error_that_a_user_can_mend_comes_back_as_it_is(workers):
    with workers.ready() as pool:
        with pytest.raises(ArgumentError, match=r"^number is 2; take 3$"):
            list(pool.each(refused, range(6)))
        assert dict(pool.each(squared, range(3))) == {0: 0, 1: 1, 2: 4}


@pytest.mark.parametrize("workers", WORKED)
def test_the_piece_of_a_killed_worker_is_made_again(workers, tmp_path):
    with workers.ready() as pool:
        assert sorted(pool.each(partial(killed_once, tmp_path / "killed"), range(8))) == [(k, k) for k in range(8)]
    assert (tmp_path / "killed").exists()


@pytest.mark.slow
@pytest.mark.parametrize("workers", WORKED)
def test_a_piece_that_kills_every_worker_is_given_up(workers, monkeypatch):
    # They take long to come back.
    monkeypatch.setattr("halfseen.workers.pool.MOST_LOST", 3)
    with workers.ready() as pool, pytest.raises(WorkerError, match=r"were lost 3 times.* give --workers a smaller"):
        list(pool.each(always_killed, range(2)))


@pytest.mark.slow
def test_a_cluster_that_stays_without_workers_is_given_up(monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("halfseen.workers.engines.EMPTY_S", 1.0)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster,
        Workers(engine="dask", address=cluster.scheduler_address).ready() as pool,
        pytest.raises(WorkerError, match=r"were lost 10 times.*FutureCancelledError"),
    ):
        list(pool.each(squared, range(2)))


@pytest.mark.parametrize("workers", WORKED)
def test_a_worker_without_memory_says_so(workers):
    with workers.ready() as pool, pytest.raises(WorkerError, match="out of memory; give --workers a smaller number"):
        list(pool.each(out_of_memory, range(2)))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")
def test_a_node_of_two_goes_and_the_other_makes_what_it_had():
    ray_cluster = pytest.importorskip("ray.cluster_utils")
    cluster = ray_cluster.Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        second = cluster.add_node(num_cpus=1)
        with Workers(engine="ray", address=cluster.address).ready() as pool:
            assert pool.num_workers == 2
            found = {}
            for number, result in pool.each(slowly_squared, range(12)):
                found[number] = result
                if len(found) == 3:
                    cluster.remove_node(second, allow_graceful=False)
        assert found == {number: number**2 for number in range(12)}
    finally:
        cluster.shutdown()


@pytest.mark.slow
@pytest.mark.parametrize(("engine", "address"), [("ray", "127.0.0.1:9"), ("dask", "127.0.0.1:9"), ("dask", "there")])
def test_an_address_at_which_nobody_answers_is_reported(engine, address):
    message = rf"^--address {address}: no (Ray|Dask) .* answers there \(.*\); start one"
    with pytest.raises(WorkerError, match=message), Workers(engine=engine, address=address).ready():
        pass


@pytest.mark.parametrize(
    ("result", "words"),
    [
        ({"engine": "spark"}, "--engine spark: choose among processes, ray, dask"),
        ({"address": "there"}, "--address there: processes of this machine have no address; name an --engine"),
        ({"engine": "ray", "address": "there", "num": 2}, "--workers 2: the cluster at there sets its own number"),
        ({"num": 0}, "--workers 0: give a whole number, at least 1"),
        ({"num": 2.5}, "--workers 2.5: give a whole number, at least 1"),
    ],
)
def test_workers_that_there_cannot_be_are_refused(result, words):
    with refused_type(f"^{words}"):
        Workers(**result)


def test_other_versions_and_what_a_worker_cannot_import_are_reported_by_name():
    here = versions()
    other = {**here, "numpy": "1.0"}
    nothing, nowhere = (np.frombuffer(each, dtype=np.uint8) for each in (b"", b"cnowhere_at_all\nsquared\n."))
    assert f"numpy {np.__version__} instead of 1.0; install the same" in str(made(other, nothing, 0, 0).error)
    message = str(made(here, nowhere, 0, 0).error)
    assert message.startswith("a worker cannot import nowhere_at_all, which is needed here; install it there")
