"""Several logs as one."""

import pytest

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.joining import joined


def log(path, cause=None, **objects):
    ending = "finished" if cause is None else "cut"
    clock, reward = ([1.0], [2.0]) if cause is None else ([None], [None])
    stages = {"path": [path], "stage": [1], "elapsed_s": clock, "action": ["A"], "reward": reward, "x": [0.5]}
    paths = {"path": [path], "end_s": [1.5], "ending": [ending], "cause": [cause]}
    table = {"path": [path], "stage": [1], "object": [0], **objects} if objects else None
    return Logs(stages=stages, paths=paths, objects=table)


def test_paths_keep_all_that_is_known_of_them():
    whole = joined([log(3, tried=[[]]), log(1, "battery", tried=[[0.5, 1.0]])])
    assert whole.num_paths == 2
    assert whole.paths["cause"].isna().tolist() == [False, True]
    assert [list(each) for each in whole.objects["tried"]] == [[0.5, 1.0], []]


def test_parts_equal_the_whole_that_they_were_taken_from():
    whole = joined([log(1), log(2, "operator"), log(5)])
    again = joined([whole.select([5]), whole.select([1, 2])])
    for name, table in whole.tables.items():
        assert table.equals(again.tables[name])


def test_what_does_not_fit_together_is_refused():
    with pytest.raises(LogError, match="no log to join"):
        joined([])
    with pytest.raises(LogError, match="only some of the logs have objects"):
        joined([log(1), log(2, size=[1.0])])
    with pytest.raises(LogError, match="path 1"):
        joined([log(1), log(1)])
