import json
import os
from pathlib import Path

import numpy as np
import pytest

from halfseen.perception import Cloud, perceive, read_cloud
from halfseen.perception.kind import other_things_in_words

BESIDE = Path(__file__).parents[3] / "shared" / "clouds"
FOLDER = Path(os.environ.get("HALFSEEN_CLOUDS", BESIDE))
IS_THERE = (FOLDER / "index.json").is_file()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not IS_THERE, reason="HALFSEEN_CLOUDS names no folder of real captures"),
]
# Names only: the files are test data of their own and no part of the project.
ALONE_NPZ = ["blue_mug", "red_mug", "white_mug", "cylinder", "green_bowl", "white_bowl", "mustard"]
ALONE = [*(f"{name}.npz" for name in ALONE_NPZ), "table_scene_mug_stereo_textured.pcd", "gpd_table_mug.pcd"]
CLUTTERED = ["ycbv1", "ycbv2", "ycbv3", "ycbv4", "ycbv5"]


def num_on_table(name: str) -> int:
    index = json.loads((FOLDER / "index.json").read_text())
    return next(entry["objects_on_table"] for entry in index if entry["file"].startswith(name))


@pytest.mark.parametrize("name", ALONE)
def test_a_lone_object_is_one_object(name):
    view = perceive(read_cloud(FOLDER / name))
    assert len(view.objects) == num_on_table(name) == 1
    assert view.objects[0].occlusion < 0.02


@pytest.mark.parametrize("name", CLUTTERED)
def test_clutter_is_counted_to_within_one(name):
    view = perceive(read_cloud(FOLDER / f"{name}.npz"))
    assert abs(len(view.objects) - num_on_table(name)) <= 1


@pytest.mark.parametrize("name", CLUTTERED)
def test_a_crop_to_the_table_shows_the_same_objects(name):
    cloud = read_cloud(FOLDER / f"{name}.npz")
    view = perceive(cloud)
    points = view.table.table_points(cloud.points_m)
    taken = np.concatenate([points[seen.pixels, :2] for seen in view.objects])
    low, high = taken.min(axis=0) - 0.05, taken.max(axis=0) + 0.05
    is_kept = (points[:, 2] > -0.02) & (points[:, :2] > low).all(axis=1) & (points[:, :2] < high).all(axis=1)
    cropped = Cloud(np.where(is_kept[:, None], cloud.points_m, 0.0), cloud.shape, cloud.intrinsics, "crop")
    again = perceive(cropped)
    assert again.table.normal @ view.table.normal > np.cos(np.deg2rad(2.5))
    assert abs(len(again.objects) - num_on_table(name)) <= 1


@pytest.mark.parametrize("name", [*ALONE, *(f"{one}.npz" for one in CLUTTERED)])
def test_cups_raise_no_alarm_and_clutter_of_other_things_does(name):
    index = {entry["file"]: entry for entry in json.loads((FOLDER / "index.json").read_text())}
    told = other_things_in_words(perceive(read_cloud(FOLDER / name)))
    if index[name]["cups"]:
        assert told == ""
    # Cans and bowls of a cup's size are cups to it.
    elif name.startswith(("mustard", "ycbv1", "ycbv2", "ycbv4", "ycbv5")):
        assert told
