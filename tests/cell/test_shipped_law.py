"""The law that ships, beside the attempts that ship with it, and the logs of the physical cell."""

from pathlib import Path

import numpy as np

from halfseen.cell.calibration.calibrate import HORIZON, law_of
from halfseen.cell.calibration.clustered_share import shares_by
from halfseen.cell.calibration.law_folder import ATTEMPTS, read_law, write_law
from halfseen.cell.calibration.occlusion_bins import occlusion_bins
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.cell.calibration.trials import trials
from halfseen.logs import read_logs
from halfseen.tables.grasp.inputs import checked_attempts

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
