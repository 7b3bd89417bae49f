"""What is kept of the shipped tables is what perception sees of them today."""

import numpy as np
import pytest

from halfseen.cell.calibration.law_folder import read_law
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.cell.tables_seen import look_again, tables_seen
from halfseen.cli.scenes import scenes_of
from halfseen.scene import table_paths


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
