"""Logs of several robots: a clock that may stand, and no two at one object."""

import pandas as pd
import pytest

from halfseen.errors import LogError
from halfseen.logs import Logs, read_logs


def log(objects=(0, 1, 2), robots=("left", "right", "left"), elapsed_s=(0.0, 2.0, 5.0)):
    stages = {
        "path": 0,
        "stage": range(1, 4),
        "elapsed_s": elapsed_s,
        "action": "WASH",
        "object": objects,
        "reward": 1.0,
        "robot": robots,
    }
    paths = {"path": [0], "end_s": [elapsed_s[-1]], "ending": ["finished"]}
    return Logs(pd.DataFrame(stages), pd.DataFrame(paths))


def test_a_clock_may_stand_where_two_robots_are_free_at_once(tmp_path):
    logs = log()
    assert logs.elapsed_s().tolist() == [[0.0, 2.0, 5.0]]
    assert "robot" not in logs.stage_covariates
    logs.write(tmp_path / "log")
    assert read_logs(tmp_path / "log").stages["robot"].tolist() == ["left", "right", "left"]


def test_of_one_robot_it_runs():
    stages = log().stages.drop(columns="robot")
    with pytest.raises(LogError, match=r"elapsed_s 0.0 is no time after the path's beginning"):
        Logs(stages, {"path": [0], "end_s": [5.0], "ending": ["finished"]})


TURNS = ("right", "left", "right")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"elapsed_s": (0.0, 2.0, 1.0)}, r"elapsed_s 1.0 is before the 2.0 of stage 2"),
        (
            {"objects": (0, 0, 2), "elapsed_s": (1.0, 2.0, 5.0)},
            "stage 2: robot 'right' begins with object 0, which robot 'left' is at since",
        ),
        (
            {"objects": (0, 0, 1), "robots": TURNS, "elapsed_s": (2.0, 3.0, 5.0)},
            "stage 2: robot 'left' begins with object 0",
        ),
        ({"robots": ("left", None, "left")}, "robot is null"),
    ],
)
def test_clocks_that_fall_two_at_one_object_and_stages_of_nobody_are_refused(given, message):
    with pytest.raises(LogError, match=message):
        log(**given)


@pytest.mark.parametrize(
    "given",
    [
        # At 2 s both are free; left decides first, and takes what right has just let go of.
        {"objects": (0, 0, 1), "robots": TURNS, "elapsed_s": (2.0, 2.0, 5.0)},
        {"objects": (0, 1, 1), "robots": ("left", "right", "right")},
        {"objects": (0, 1, 0), "robots": ("left", "left", "right")},
    ],
)
def test_one_after_the_other_is_well(given):
    assert log(**given).num_paths == 1
