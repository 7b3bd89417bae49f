"""Which process makes which repetition."""

from halfseen.study.runner import next_of


def test_a_process_stays_with_its_own_then_begins_another_then_helps():
    assert next_of([1, 0, 0], [6, 8, 40], None) == 1
    assert next_of([1, 3, 0], [6, 8, 40], 1) == 1
    assert next_of([1, 8, 0], [6, 8, 40], 1) == 2
    assert next_of([2, 8, 35], [6, 8, 40], 1) == 2
    assert next_of([1, 8, 40], [6, 8, 40], 1) == 0
    assert next_of([6, 8, 40], [6, 8, 40], 1) is None
