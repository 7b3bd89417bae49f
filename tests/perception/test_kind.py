from dataclasses import replace

import numpy as np
import pytest

from drawn_boxes import boxes_cloud
from halfseen.perception import perceive, read_cloud
from halfseen.perception.kind import HIGHEST_M, LOWEST_M, other_things, other_things_in_words
from halfseen.perception.solids import Hull
from halfseen.scene import table_paths


@pytest.fixture(scope="module")
def cups():
    return perceive(read_cloud(table_paths()[7]))


def changed(view, **of):
    """The view with some objects of another kind, by number: a Hull, or a height [m]."""
    objects = [
        replace(seen, solid=Hull(np.eye(3))) if of.get(f"o{seen.id}") == "hull" else seen for seen in view.objects
    ]
    heights = {k: h for k, h in ((seen.id, of.get(f"o{seen.id}")) for seen in objects) if isinstance(h, float)}
    return replace(view, objects=tuple(replace(one, height_m=heights.get(one.id, one.height_m)) for one in objects))


def test_boxes_are_no_cups():
    view = perceive(boxes_cloud())
    assert len(view.objects) == 2
    assert other_things(view) == (0, 1)
    assert other_things_in_words(view) == (
        "this is no table of cups, and of other things nothing was learned: 0 is no vessel by its shape; 1 is no "
        "vessel by its shape"
    )


def test_a_height_that_no_cup_has_is_enough(cups):
    assert other_things(changed(cups, o2=HIGHEST_M + 0.01)) == (2,)
    view = changed(cups, o0=LOWEST_M - 0.01)
    assert other_things_in_words(view) == (
        "not all on this table are cups, and of other things nothing was learned: 0 is 0.035 m high (a cup 0.045 to "
        "0.17)"
    )


def test_one_shape_among_cups_may_be_two_cups_that_were_taken_for_one(cups):
    assert other_things(changed(cups, o3="hull")) == ()
    assert other_things(changed(cups, o3="hull", o4="hull")) == (3, 4)
    assert other_things(changed(cups, o3="hull", o4=0.3)) == (3, 4)
