"""P(DIRTY) beside the truth: how it is counted, and that it holds for cups that are seen in part."""

import numpy as np
import pandas as pd
import pytest
from half_seen import LOGS, beside_truth, fresh, groups, washed
from scipy.special import logit

from halfseen.cell.calibration.law_folder import read_law, shipped_law
from halfseen.cell.table_state import Belief
from halfseen.logs import read_logs


@pytest.fixture(scope="module")
def belief():
    law = read_law(shipped_law()).law
    return Belief(law.config(), law.grip)


def rows_of(said, is_dirty, cups):
    return pd.DataFrame({"log_odds": logit(said), "is_dirty": is_dirty, "table": 0, "cup": cups})


def test_cups_that_are_there_once_count_as_independent():
    found = beside_truth(rows_of(np.full(4, 0.5), [True, True, True, False], range(4)))
    assert (found["cups"], found["said"], found["found"]) == (4, 0.5, 0.75)
    assert found["z"] == pytest.approx(1.0 / np.sqrt(4 * 0.25))


def test_many_sets_of_stains_on_one_cup_count_as_that_cup():
    found = beside_truth(rows_of(np.full(4, 0.5), [True, True, False, True], [0, 0, 1, 1]))
    assert (found["labels"], found["cups"]) == (4, 2)
    assert found["z"] == pytest.approx(1.0 / np.sqrt(1.0**2 + 0.0**2))


def test_what_was_lifted_and_what_was_seen_whole_is_not_half_seen():
    rows = rows_of(np.full(3, 0.5), [True, False, True], range(3)).assign(
        is_lying=False,
        glance_occlusions=[[0.4], [0.4, 0.0], [0.4, 0.0]],
        glance_held=[[False], [False, False], [False, True]],
        glance_dirty=[[False], [False, False], [False, True]],
    )
    found = groups(rows)
    counts = {name: found[name]["labels"] for name in ("all", "whole", "half-seen", "held up")}
    assert counts == {"all": 3, "whole": 1, "half-seen": 1, "held up": 1}


def test_rewards_tell_what_was_dirty(belief):
    rows = washed(read_logs(LOGS), belief)
    assert (len(rows), int(rows["is_dirty"].sum())) == (1611, 1179)


@pytest.mark.slow
def test_what_is_said_of_half_seen_cups_is_found_on_fresh_tables(belief):
    rows = pd.concat([fresh(index, 40, 10, 1, belief) for index in range(8)], ignore_index=True)
    found = groups(rows)
    print(pd.DataFrame(found).T.round(3))
    assert found["half-seen"]["labels"] > 200
    for name in ("all", "whole", "half-seen", "half-seen, nothing found", "half-seen, found"):
        assert abs(found[name]["z"]) < 3.5, name
        assert found[name]["found"] == pytest.approx(found[name]["said"], abs=0.08), name


def test_sets_of_stains_are_drawn_apart_and_each_cup_is_dirty_as_often_as_the_prior_says(belief):
    rows = fresh(0, 41, 5, 0, belief)
    assert rows.groupby("cup")["is_dirty"].mean().tolist() == [0.6] * rows["cup"].nunique()
    assert rows.groupby("stains")["is_dirty"].mean().nunique() > 1
    assert rows.groupby("cup")["glance_occlusions"].agg(lambda each: len({tuple(one) for one in each})).eq(1).all()
