"""The law that ships, beside the attempts that ship with it, and the logs of the physical cell."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from attempt_logs import attempt_log
from halfseen.cell.calibration.calibrate import HORIZON, law_of
from halfseen.cell.calibration.clustered_share import shares_by
from halfseen.cell.calibration.held_figure import held_shares
from halfseen.cell.calibration.labels_figure import Count, counted
from halfseen.cell.calibration.law_folder import ATTEMPTS, read_law, write_law
from halfseen.cell.calibration.occlusion_bins import occlusion_bins
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.cell.calibration.trials import trials
from halfseen.cell.tables_seen import look_again, tables_seen
from halfseen.cli.scenes import scenes_of
from halfseen.logs import read_logs
from halfseen.perception.labels import FACING_SHARE
from halfseen.scene import table_paths
from halfseen.tables.grasp.inputs import checked_attempts
from halfseen.world.seeing import PersistentSeeing

EXAMPLE = Path(__file__).parents[2] / "examples" / "physical_cell" / "logs"
"""Logs of 700 tables."""


def test_its_attempts_give_it_again_to_the_last_bit(tmp_path):
    logs = read_logs(shipped_law() / ATTEMPTS)
    assert len(logs.stages) >= 6000
    write_law(law_of(logs), tmp_path / "again", {})
    assert (tmp_path / "again" / "law.safetensors").read_bytes() == (shipped_law() / "law.safetensors").read_bytes()
    law = read_law(shipped_law()).law
    assert law.grasp.num_decided + law.grasp.num_cut == len(trials(logs, HORIZON))


def test_where_a_tenth_of_the_attempts_is_the_share_that_held_is_known_to_three_hundredths():
    tried = trials(read_logs(shipped_law() / ATTEMPTS), HORIZON)
    decided = checked_attempts(tried)
    met = tried.iloc[decided.row]
    bins, nothing = occlusion_bins(met["occlusion"].to_numpy()), np.zeros(len(met))
    found = shares_by(bins, decided.succeeded, nothing, decided.weight, met["path"].to_numpy())
    full = [share for share in found.values() if share.num_attempts >= 0.1 * len(met)]
    assert len(full) == 4
    assert all((share.high - share.low) / 2 <= 0.03 for share in full)


def test_the_logs_of_the_cell_are_of_700_tables_of_which_some_were_cut():
    logs = read_logs(EXAMPLE)
    # At one table no object was in view before it was cut, so that nothing was decided.
    assert logs.num_paths == 699
    assert 0.3 < logs.summary().cut_share < 0.6
    assert set(logs.paths["cause"].dropna()) == {"emergency-stop", "sensor-lost", "time-out"}


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


@pytest.mark.slow
def test_what_is_kept_is_what_is_seen():
    for kept, seen in zip(tables_seen(), look_again(), strict=True):
        assert kept.plain.name == seen.plain.name
        np.testing.assert_allclose(kept.plain.hides, seen.plain.hides, rtol=0, atol=1e-9)
        for before, now in zip(kept.facts, seen.facts, strict=True):
            assert before == pytest.approx(now, abs=1e-9)


@pytest.mark.parametrize("law", [None, "shipped"])
def test_a_table_that_is_kept_is_as_one_that_is_looked_at(law):
    law = None if law is None else read_law(shipped_law()).law
    kept, (seen,) = scenes_of([], law)[7], scenes_of([table_paths()[7]], law)
    assert kept.name == seen.name
    np.testing.assert_allclose(kept.hides, seen.hides, rtol=0, atol=1e-9)
    np.testing.assert_allclose(kept.grip, seen.grip, rtol=0, atol=1e-9)
    np.testing.assert_allclose(kept.places_m, seen.places_m, rtol=0, atol=1e-6)
