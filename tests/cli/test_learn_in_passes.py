"""`halfseen learn` on a log that is read part by part tells and decides what it does on one in memory."""

import json
from functools import partial

import numpy as np
import pytest
import shell

from halfseen.errors import LogError
from halfseen.evaluation import held_out
from halfseen.logs import LogStream, stream
from halfseen.logs.formats.csv_folder import write_csv
from halfseen.policies.folder import read_policy
from small_logs import flat_log, table_log

run = partial(shell.run, "learn")


@pytest.fixture
def by_sevens(monkeypatch):
    monkeypatch.setattr(LogStream.__init__, "__defaults__", (7,))


def assert_alike(one, other):
    """The same but for rounding."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert list(one) == list(other)
        one, other = list(one.values()), list(other.values())
    if isinstance(one, list):
        assert len(one) == len(other)
        for first, second in zip(one, other, strict=True):
            assert_alike(first, second)
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=1e-6, nan_ok=True)
    else:
        assert one == other


@pytest.mark.slow
@pytest.mark.parametrize("log", [flat_log, table_log], ids=["named actions", "tables"])
@pytest.mark.parametrize("stages", ["separate", "pooled"])
def test_all_that_is_told_is_the_same(log, stages, tmp_path, by_sevens):
    log().write(tmp_path / "logs")
    told = {}
    for way in ("in-memory", "in-passes"):
        shown = run(tmp_path / "logs", "--out", tmp_path / way, "--stages", stages, f"--{way}", "--json")
        told[way] = json.loads(shown.stdout)
    for report in told.values():
        del report["policy"]
    assert_alike(told["in-passes"], told["in-memory"])
    policies = [read_policy(tmp_path / way).policy for way in told]
    np.testing.assert_allclose(policies[0].coefficients, policies[1].coefficients, rtol=1e-5, atol=1e-6)


def test_many_stages_are_read_in_passes_and_few_are_not(tmp_path, monkeypatch):
    folder = _written(flat_log(), tmp_path)[0]
    assert not isinstance(stream.opened(folder), LogStream)
    monkeypatch.setattr(stream, "MOST_STAGES_IN_MEMORY", 10)
    assert isinstance(stream.opened(folder), LogStream)
    assert not isinstance(stream.opened(folder, in_passes=False), LogStream)


def test_other_forms_are_not_read_in_passes(tmp_path):
    write_csv(flat_log(), tmp_path / "csv")
    with pytest.raises(LogError, match="only folders of Parquet files are read in passes; make one of it"):
        stream.opened(tmp_path / "csv", in_passes=True)


def test_a_verdict_on_some_of_the_trajectories_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(held_out, "MOST_JUDGED", 30)
    report = json.loads(run(*_written(flat_log(), tmp_path), "--reg", 0.1, "--in-passes", "--json").stdout)
    assert "the verdict is of policies learned from 30 of the 40 trajectories, drawn at random" in report["notes"]


def _written(logs, tmp_path):
    logs.write(tmp_path / "logs")
    return tmp_path / "logs", "--out", tmp_path / "policy"
