"""The later part of a log, by a name or a date."""

from datetime import datetime

import pandas as pd
import pytest

from halfseen.logs.joining import since
from refusals import refused
from small_logs import log_of

DAYS = pd.to_datetime(["2026-03-01 00:00", "2026-03-02 06:00", "2026-03-02 18:00"])


def dated(names=(5, 7, 9), zone=None):
    return log_of({"began": DAYS.tz_localize(zone)}, trajectory=list(names))


@pytest.mark.parametrize(
    ("when", "kept"),
    [("7", [7, 9]), (7, [7, 9]), ("5", [5, 7, 9]), ("2026-03-02", [7, 9]), (datetime(2026, 3, 2, 12), [9])],
)
@pytest.mark.parametrize("zone", [None, "UTC"])
def test_what_came_later_is_kept(when, kept, zone):
    assert since(dated(zone=zone), when).trajectory_ids.tolist() == kept


def test_names_may_be_text():
    assert since(log_of(trajectory=["a", "b", "c"]), "b").trajectory_ids.tolist() == ["b", "c"]


def test_what_is_not_there_is_refused_with_what_is():
    with refused("since is 8, and the log has no such trajectory; give the name of one, 5 to 9, or a date by its"):
        since(dated(), 8)
    with refused("give the name of one, 5 to 9, or a date"):
        since(dated(), "2027-01-01")
    with refused("give the name of one, 'a' to 'b'$"):
        since(log_of(trajectory=["a", "b"]), "2026-03-02")
