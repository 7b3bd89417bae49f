"""What a look does not find again is hidden, or no longer there, or comes back."""

from functools import lru_cache

import numpy as np
import pytest

from halfseen.cell.memory import Memory
from halfseen.cell.table_state import Belief, no_grip, rows_of, state_of
from halfseen.cell.vanishing import has_vanished
from halfseen.cell.workcell import Workcell
from halfseen.scene.camera import look_at
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M, Table
from halfseen.scene.xtion import xtion_at
from halfseen.world import WorldConfig

CAMERA = xtion_at(look_at(np.array([0.0, -0.78, 1.24]), np.array([0.0, 0.0, TABLE_TOP_M])))
CUP, TALL = Cup(0.09, 0.042, 0.036), Cup(0.19, 0.07, 0.07)
FRONT, BACK, ASIDE = ((x, y, TABLE_TOP_M) for x, y in ((0.0, -0.10), (0.0, 0.02), (0.22, 0.0)))
BELIEF = Belief(WorldConfig(), no_grip)


@lru_cache
def seen(*cups):
    """A view of cups at their places, and where its table is."""
    table = Table(tuple(cup for cup, _ in cups), tuple(Pose(place) for _, place in cups), CAMERA)
    cell = Workcell(table, np.random.default_rng(0))
    return cell.look(), cell.world_from_table


def remembered(*looks):
    memory = Memory()
    for cups in looks:
        memory.update(*seen(*cups))
    return memory


def nearest(memory, place):
    return min(memory.objects, key=lambda known: np.linalg.norm(known.middle_m[:2] - place[:2]))


BOTH, ONE = ((CUP, BACK), (CUP, ASIDE)), ((CUP, ASIDE),)


def test_what_is_seen_past_is_lost_and_no_longer_on_the_table():
    memory = remembered(BOTH, ONE)
    gone = nearest(memory, BACK)
    assert (gone.is_lost, gone.is_gone, gone.is_racked) == (True, True, False)
    assert [known.is_lost for known in memory.objects].count(True) == 1
    number = memory.objects.index(gone)
    assert [row["location"] for row in rows_of(memory, BELIEF)][number] == "LOST"
    assert not np.asarray(state_of(memory, BELIEF, 10).is_on_table)[number]


def test_what_comes_back_where_it_was_is_the_same_object():
    memory = remembered(BOTH, ONE, BOTH)
    assert len(memory.objects) == 2
    assert not any(known.is_lost or known.seen is None for known in memory.objects)


def test_what_something_stands_before_is_hidden_and_has_not_vanished():
    was, now = seen((CUP, BACK), (TALL, ASIDE))[0], seen((TALL, FRONT), (CUP, ASIDE))[0]
    behind = max(was.objects, key=lambda each: each.centroid_m @ [-1.0, 0.0, 0.0])
    surface_m = was.image.points_m.reshape(-1, 3)[behind.pixels]
    assert not has_vanished(surface_m, now)
    assert has_vanished(surface_m, seen(*ONE)[0])


def test_what_is_in_hand_is_not_lost():
    memory = remembered(BOTH)
    held = nearest(memory, BACK)
    memory.update(*seen(*ONE), in_hand=[held])
    assert (held.seen, held.is_lost) == (None, False)


@pytest.mark.parametrize("place_m", [[0.0, 0.0, -1.0], [9.0, 0.0, 1.0]], ids=["behind the camera", "out of its view"])
def test_a_place_that_is_not_in_the_image_tells_nothing(place_m):
    view, _ = seen(*ONE)
    assert not has_vanished(np.array([place_m] * 5), view)


def test_what_comes_into_view_elsewhere_is_another_object():
    memory = remembered(BOTH, ONE, ((CUP, ASIDE), (CUP, FRONT)))
    assert [known.is_lost for known in memory.objects].count(True) == 1
    assert len(memory.objects) == 3
