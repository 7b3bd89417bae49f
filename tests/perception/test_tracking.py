"""Objects are found again where they are nearest all together; what may be another one is told."""

from itertools import permutations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from halfseen.perception.tracking import FARTHEST_M, matched

PLACES = st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)), min_size=0, max_size=4, unique=True).map(
    lambda places: np.array([[*place, 0.05] for place in places]).reshape(-1, 3)
)


def best_by_hand(before_m, now_m):
    """Least total price over all ways to match or lose each object."""
    slots = [*range(len(now_m)), *[-1] * len(before_m)]
    prices = [
        sum(FARTHEST_M if which < 0 else np.linalg.norm(before_m[k] - now_m[which]) for k, which in enumerate(order))
        for order in permutations(slots, len(before_m))
    ]
    return min(prices)


@given(PLACES, PLACES)
def test_the_match_is_the_cheapest_of_all(before_m, now_m):
    found = matched(before_m, now_m)
    used = [which for which in found.now.tolist() if which >= 0]
    assert len(set(used)) == len(used)
    price = sum(
        FARTHEST_M if which < 0 else np.linalg.norm(before_m[k] - now_m[which]) for k, which in enumerate(found.now)
    )
    assert price <= best_by_hand(before_m, now_m) + 1e-9
    assert sorted([*used, *found.new(len(now_m))]) == list(range(len(now_m)))


def test_order_does_not_matter_lost_objects_are_lost_and_new_ones_new():
    before_m = np.array([[0.0, 0.0, 0.05], [0.1, 0.0, 0.05], [-0.2, 0.1, 0.05]])
    now_m = np.array([[0.102, 0.001, 0.05], [0.25, -0.2, 0.05], [0.001, 0.0, 0.05]])
    found = matched(before_m, now_m)
    assert found.now.tolist() == [2, 0, -1]
    assert found.new(3) == [1]
    assert not found.is_doubtful.any()


def test_one_that_was_knocked_is_found_again_and_two_that_may_be_swapped_are_doubtful():
    before_m = np.array([[0.0, 0.0, 0.05], [0.3, 0.0, 0.05]])
    assert matched(before_m, np.array([[0.3, 0.0, 0.05], [0.1, 0.1, 0.03]])).now.tolist() == [1, 0]
    near_m = np.array([[0.0, 0.0, 0.05], [0.06, 0.0, 0.05]])
    moved = matched(near_m, np.array([[0.025, 0.0, 0.05], [0.045, 0.0, 0.05]]))
    assert moved.now.tolist() == [0, 1]
    assert moved.is_doubtful.all()
