"""Logs in an object store are read as those on disk; what a store does not give is told in one line."""

import fsspec
import numpy as np
import pytest
from click.testing import CliRunner

from halfseen.cli.convert import convert
from halfseen.cli.learn import learn
from halfseen.errors import LogError
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogStream, compact, read_logs
from halfseen.policies.folder import read_policy
from refusals import refused
from small_logs import flat_log, table_log


@pytest.fixture
def store(tmp_path):
    """A store in memory with two logs, and nothing else."""
    memory = fsspec.filesystem("memory")
    for name, log in (("flat", flat_log()), ("tables", table_log())):
        log.write(tmp_path / name)
        memory.put(str(tmp_path / name), f"/fleet/{name}", recursive=True)
    yield "memory://fleet"
    memory.rm("/fleet", recursive=True)


@pytest.mark.parametrize(("name", "log"), [("flat", flat_log), ("tables", table_log)])
def test_they_are_read(name, log, store):
    whole = log()
    for found in (read_logs(f"{store}/{name}"), next(iter(LogStream(f"{store}/{name}")))):
        for table, frame in whole.tables.items():
            assert found.tables[table].equals(frame)


def test_an_address_of_this_machine_is_one(tmp_path):
    flat_log().write(tmp_path / "logs")
    assert read_logs(f"file://{tmp_path}/logs").num_trajectories == flat_log().num_trajectories


def test_they_are_learned_from_in_passes(store, tmp_path):
    words = [f"{store}/flat", "--out", str(tmp_path / "policy"), "--streaming", "--no-verdict", "--reg", "0.1"]
    result = CliRunner().invoke(learn, words, catch_exceptions=False)
    assert result.stdout.startswith(f"{tmp_path / 'policy'}: learned from 40 trajectories")
    policy = read_policy(tmp_path / "policy").policy
    known = CensoredQLearner(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=0.1).fit(flat_log()).policy_
    np.testing.assert_allclose(policy.coefficients, known.coefficients, rtol=1e-6, atol=1e-9)


def test_one_is_converted_and_several_are_compacted(store, tmp_path):
    words = [f"{store}/flat", "--out", str(tmp_path / "here")]
    assert CliRunner().invoke(convert, words, catch_exceptions=False).exit_code == 0
    done = compact([f"{store}/flat", tmp_path / "here"], tmp_path / "all")
    assert done.num_trajectories == 2 * flat_log().num_trajectories
    assert read_logs(tmp_path / "all").trajectories["run"].iloc[0] == f"{store}/flat"


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("memory://fleet/none", "there is no such folder"),
        ("nosuch://bucket/logs", r"nosuch://bucket/logs: it cannot be opened \(Unsupported filesystem"),
    ],
)
def test_what_is_not_there_is_named(address, message, store):
    for read in (read_logs, LogStream):
        with refused(message, LogError):
            read(address)


@pytest.mark.parametrize("error", [PermissionError("Access Denied"), RuntimeError("no credentials\nsee the docs")])
def test_what_a_store_refuses_is_told(error, store, monkeypatch):
    def refuses(*_, **__):
        raise error

    monkeypatch.setattr(fsspec.filesystem("memory"), "_open", refuses)
    reason = str(error).splitlines()[0]
    with refused(rf"(^memory://fleet/flat: the store did not answer \(|cannot be read).*{reason}", LogError):
        read_logs(f"{store}/flat")
