import json
import os
from pathlib import Path

import numpy as np
import pytest

from halfseen.perception import Cloud, perceive, read_cloud
from halfseen.perception.view import other_things_in_words

BESIDE = Path(__file__).parents[3] / "shared" / "clouds"
FOLDER = Path(os.environ.get("HALFSEEN_CLOUDS", BESIDE))
IS_THERE = (FOLDER / "index.json").is_file()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not IS_THERE, reason="HALFSEEN_CLOUDS names no folder of real captures"),
]
ALONE = [
    f"{name}.npz" for name in ("blue_mug", "red_mug", "white_mug", "cylinder", "green_bowl", "white_bowl", "mustard")
]
ALONE += ["table_scene_mug_stereo_textured.pcd", "gpd_table_mug.pcd"]
CLUTTERED = [f"ycbv{number}.npz" for number in range(1, 6)]
OTHER_THINGS = ["mustard.npz", *(name for name in CLUTTERED if name != "ycbv3.npz")]
"""Cans and bowls of a cup's size are cups to it."""


@pytest.fixture(scope="module")
def index():
    return {entry["file"]: entry for entry in json.loads((FOLDER / "index.json").read_text())}


@pytest.mark.parametrize("name", [*ALONE, *CLUTTERED])
def test_a_lone_object_is_one_clutter_is_counted_to_within_one_and_what_is_no_cup_raises_an_alarm(index, name):
    view = perceive(read_cloud(FOLDER / name))
    assert abs(len(view.objects) - index[name]["objects_on_table"]) <= (name in CLUTTERED)
    if name in ALONE:
        assert len(view.objects) == 1
        assert view.objects[0].occlusion < 0.02
    result = other_things_in_words(view)
    assert result == "" if index[name]["cups"] else result or name not in OTHER_THINGS


@pytest.mark.parametrize("name", CLUTTERED)
def test_a_crop_to_the_table_shows_the_same_objects(index, name):
    cloud = read_cloud(FOLDER / name)
    view = perceive(cloud)
    points = view.table.table_points(cloud.points_m)
    taken = np.concatenate([points[seen.pixels, :2] for seen in view.objects])
    low, high = taken.min(axis=0) - 0.05, taken.max(axis=0) + 0.05
    is_kept = (points[:, 2] > -0.02) & (points[:, :2] > low).all(axis=1) & (points[:, :2] < high).all(axis=1)
    cropped = Cloud(np.where(is_kept[:, None], cloud.points_m, 0.0), cloud.shape, cloud.intrinsics, "crop")
    again = perceive(cropped)
    assert again.table.normal @ view.table.normal > np.cos(np.deg2rad(2.5))
    assert abs(len(again.objects) - index[name]["objects_on_table"]) <= 1
