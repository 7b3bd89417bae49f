import numpy as np
import pytest

from halfseen.censoring import weight_diagnostics
from halfseen.errors import ArgumentError


def test_equal_weights_are_worth_their_number():
    worth = weight_diagnostics([2.0, 2.0, 0.0, 2.0])
    assert worth.effective_sample_size == pytest.approx(3.0)
    assert (worth.num_weights, worth.num_seen, worth.largest_weight, worth.largest_at) == (4, 3, 2.0, (0,))
    assert worth.share_truncated == 0.0


def test_one_heavy_weight_leaves_little():
    worth = weight_diagnostics([[1.0, 1.0], [98.0, 0.0]])
    assert worth.effective_sample_size == pytest.approx(100**2 / (98**2 + 2))
    assert worth.largest_at == (1, 0)


def test_weights_at_the_bound_count_as_truncated():
    assert weight_diagnostics([1.0, 3.0, 4.0], truncate_at=4).share_truncated == pytest.approx(0.5)
    assert weight_diagnostics([1.0, 1.0 / (1.0 / 49.0)], truncate_at=49.0).share_truncated == pytest.approx(0.98)
    assert weight_diagnostics([1.0, 3.0], truncate_at=4).share_truncated == 0.0


@pytest.mark.parametrize("weights", [[0.0, 0.0], [], np.zeros((2, 0))])
def test_nothing_seen_is_worth_nothing(weights):
    worth = weight_diagnostics(weights)
    assert (worth.num_seen, worth.effective_sample_size, worth.largest_at) == (0, 0.0, None)
    assert str(worth) == f"None of {np.size(weights)} were seen, so there is nothing to weigh."


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_refuses_what_is_no_weight(value):
    with pytest.raises(ArgumentError, match=rf"weights\[0, 1\] is {value}"):
        weight_diagnostics([[1.0, value]])
