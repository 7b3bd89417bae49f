import pytest

from halfseen.study.runner import MOST_AT_ONCE, in_rows


@pytest.mark.parametrize(("num", "num_workers"), [(0, 2), (1, 2), (40, 2), (41, 3), (10_000, 2), (10_000, 1000)])
def test_rows_of_repetitions_hold_each_of_them_once_and_are_enough_for_all_workers(num, num_workers):
    rows = in_rows(list(range(num)), num_workers)
    assert [index for row in rows for index in row] == list(range(num))
    assert all(1 <= len(row) <= MOST_AT_ONCE for row in rows)
    assert len(rows) >= min(num, 8 * num_workers)
