"""Two arms against one: what is kept from call to call, and which tables are compared."""

import json

import pytest
from two_arms import ONE, TWO, print_told, ratio, runs_in, told_of

OF = {"seed": 1, "rule": "everything"}


def runs(*seconds, cut=()):
    counts = {"num_cups": 1, "num_racked": 1, "num_toppled": 0, "num_fallen": 0}
    return [
        {"seconds": each, "cause": "deadlock" if k in cut else None, "reward": 0.0, "luck": 0.0, **counts}
        for k, each in enumerate(seconds)
    ]


def test_what_another_call_has_found_is_kept_if_it_is_of_the_same_tables(tmp_path):
    file = tmp_path / "found.json"
    assert runs_in(file, OF) == {}
    plans = {ONE: told_of(runs(10.0, 20.0), None), TWO: told_of(runs(5.0), None)}
    file.write_text(json.dumps({**OF, "plans": plans}))
    assert runs_in(file, OF) == {ONE: runs(10.0, 20.0), TWO: runs(5.0)}
    with pytest.raises(SystemExit, match=r"holds tables of .*'seed': 1.*choose another --out"):
        runs_in(file, OF | {"seed": 2})


def test_tables_that_both_have_cleared_are_compared():
    found = ratio(runs(5.0, 1.0, 8.0), runs(10.0, 40.0, 10.0, 99.0, cut=(1,)))
    assert found is not None
    assert (found["tables"], found["value"], found["largest"]) == (2, 13.0 / 20.0, 0.8)
    assert ratio(runs(5.0, cut=(0,)), runs(10.0)) is None


def test_tables_that_were_cut_are_printed_and_are_in_no_time(capsys):
    told = told_of(runs(5.0, 100.0, 7.0, cut=(1,)), runs(10.0, 10.0, 12.0))
    print_told(TWO, told)
    printed = capsys.readouterr().out
    assert "cut 1 by deadlock" in printed
    assert "6.0 s a table" in printed
    assert told["ratio"]["value"] == 12.0 / 22.0
