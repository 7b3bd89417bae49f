"""The later part of a log, by a name or a date."""

from datetime import datetime

import pandas as pd
import pytest

from halfseen.logs.later_part import since
from refusals import refused
from small_logs import log_of

DAYS = pd.to_datetime(["2026-03-01 00:00", "2026-03-02 06:00", "2026-03-02 18:00"])


def dated(names=(5, 7, 9), zone=None):
    return log_of({"began": DAYS.tz_localize(zone)}, trajectory=list(names))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("when", "kept"),
    [("7", [7, 9]), (7, [7, 9]), ("5", [5, 7, 9]), ("2026-03-02", [7, 9]), (datetime(2026, 3, 2, 12), [9])],
)
@pytest.mark.parametrize("zone", [None, "UTC"])
def test_what_came_later_is_kept(when, kept, zone):
    assert since(dated(zone=zone), when).trajectory_ids.tolist() == kept


@pytest.mark.parametrize("zone", ["", "Z", "+01:00"])
def test_dates_may_be_text(zone):
    logs = log_of({"began": [f"{day:%Y-%m-%dT%H:%M}{zone}" for day in DAYS], "scene": "a"}, trajectory=[5, 7, 9])
    assert since(logs, "2026-03-02").trajectory_ids.tolist() == [7, 9]
    assert since(logs, datetime(2026, 3, 2, 12)).trajectory_ids.tolist() == [9]


def test_a_day_without_a_zone_begins_by_the_columns_own_clock():
    """The second began on the 2nd in Berlin, and on the 1st in UTC."""
    began = pd.to_datetime(["2026-03-01 12:00", "2026-03-02 00:30", "2026-03-02 18:00"]).tz_localize("Europe/Berlin")
    for column in (began, [each.isoformat() for each in began]):
        logs = log_of({"began": column}, trajectory=[5, 7, 9])
        assert since(logs, "2026-03-02").trajectory_ids.tolist() == [7, 9]
        assert since(logs, "2026-03-02T00:00Z").trajectory_ids.tolist() == [9]


def test_a_trajectory_without_a_date_is_not_left_out_and_columns_that_disagree_are_refused():
    began = ["2026-03-01", None, "2026-03-03"]
    with refused("since is 2026-03-02, but began of trajectory 7 is missing; name a trajectory"):
        since(log_of({"began": began}, trajectory=[5, 7, 9]), "2026-03-02")
    both = log_of({"began": began, "ended": ["2026-03-01", "2026-03-02", "2026-03-03"]}, trajectory=[5, 7, 9])
    assert since(both, "2026-03-02").trajectory_ids.tolist() == [7, 9]
    built = log_of({"began": DAYS, "built": [*DAYS[:2], DAYS[0]]}, trajectory=[5, 7, 9])
    with refused("since is 2026-03-02, on which began and built disagree; name a trajectory"):
        since(built, "2026-03-02")


def test_names_may_be_text():
    assert since(log_of(trajectory=["a", "b", "c"]), "b").trajectory_ids.tolist() == ["b", "c"]


def test_what_is_not_there_is_refused_with_what_is():
    with refused("since is 8, and the log has no such trajectory; give the name of one, 5 to 9, or a date by its"):
        since(dated(), 8)
    with refused("give the name of one, 5 to 9, or a date"):
        since(dated(), "2027-01-01")
    # A mistyped trajectory is no year, and a day is not taken for a month.
    for when in ("1700", 1700, "02.03.2026", "03/02/2026", "now", "March 2026", "2026-03-32"):
        with refused(f"since is {when}, and the log has no such trajectory; .* as 2026-01-31"):
            since(dated(), when)
    with refused("give the name of one, 'a' to 'b'$"):
        since(log_of(trajectory=["a", "b"]), "2026-03-02")
