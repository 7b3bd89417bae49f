"""The pictures beside a law: whole, of the numbers that were counted, and none of its digests' business."""

from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from attempt_logs import attempt_log
from halfseen.cell.calibration.calibrate import HORIZON, law_of
from halfseen.cell.calibration.held_figure import held_shares
from halfseen.cell.calibration.labels_figure import Count, counted
from halfseen.cell.calibration.law_folder import read_law, write_law
from halfseen.cell.calibration.trials import trials
from halfseen.perception.labels import FACING_SHARE
from halfseen.world.seeing import PersistentSeeing

PICTURES = {"held.svg", "held.png", "labels.svg", "labels.png"}


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    logs = attempt_log(30)
    law = law_of(logs)
    folder = tmp_path_factory.mktemp("pictures") / "law"
    write_law(law, folder, {}, logs=logs)
    return folder, law, logs


def test_pictures_lie_beside_the_numbers_and_no_digest_knows_of_them(kept, tmp_path):
    folder, law, logs = kept
    assert {path.name for path in folder.iterdir()} == {
        *PICTURES,
        "attempts",
        "law.json",
        "law.safetensors",
        "law.sha256",
    }
    for name in ("held.svg", "labels.svg"):
        assert ElementTree.parse(folder / name).getroot().tag.endswith("svg")
    write_law(law, tmp_path / "again", {}, logs=logs)
    for name in PICTURES:
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()
        (tmp_path / "again" / name).unlink()
    np.testing.assert_array_equal(read_law(tmp_path / "again").law.grasp.estimate, law.grasp.estimate)


def test_every_grouping_counts_every_decided_attempt(kept):
    tried = trials(kept[2], HORIZON)
    panels = held_shares(kept[1].grasp.estimate, tried)
    assert set(panels) == {"hidden share", "pose", "width [cm]", "room beside it [cm]"}
    decided = tried[tried["is_finished"]]
    for shares in panels.values():
        assert sum(share.num_attempts for share in shares.values()) == len(decided)
    assert panels["pose"]["lying"].num_attempts == decided["is_lying"].sum()


def test_objects_are_counted_at_their_first_label_and_when_they_are_held():
    seeing = PersistentSeeing(FACING_SHARE, (0.5 * FACING_SHARE, FACING_SHARE, 1.0), (0.3, 0.5, 0.9), (0.0, 0.1, 0.2))
    rows = pd.DataFrame(
        {
            "glance_occlusions": [[0.0, 0.0], [0.0], [0.8, 0.0], [0.8]],
            "glance_held": [[False, True], [False], [False, True], [False]],
            "glance_dirty": [[False, True], [True], [True, False], [False]],
        }
    )
    assert counted(rows, seeing) == [
        Count(pytest.approx(0.2 * FACING_SHARE), 1, 2),
        Count(pytest.approx(FACING_SHARE), 1, 2),
        Count(1.0, 2, 2),
    ]
