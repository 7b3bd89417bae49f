"""Endings that are flags of the row that acts: what comes out was worked out by hand from the rows."""

import pytest

from event_files import ends, stages
from halfseen.errors import HalfseenWarning
from refusals import refused

FLAGGED = """\
run,tool,left,s,worth,terminated,truncated
a,suction,9.5,1.5,2.5,false,false
a,soft,8,4,-1,true,true
b,soft,9.5,2,1,no,0
b,suction,6.25,2.5,,no,1
c,soft,3,2,1,False,
d,soft,3,2,1,0.0,1.0
"""
BY_FLAGS = """
clock = {field = "s", unit = "s", since = "trajectory"}
trajectory = {field = "run"}
action = {field = "tool"}
reward = {field = "worth"}
ending = {finished = {field = "terminated"}, cut = {field = "truncated"}}
covariates.left = {field = "left"}
"""


STALE = "cut after a reward, and no row says what was seen then: the covariates of the row before stand for it"


@pytest.mark.filterwarnings("ignore:.*no row says what was seen then")
def test_an_ending_may_be_flags_of_the_row_that_acts(read_table, draft):
    logs = read_table(FLAGGED, BY_FLAGS)
    assert ends(logs) == [
        ("a", 4.0, "finished", None),
        ("b", 2.5, "cut", "truncated"),
        ("c", 2.0, "cut", "log ended"),
        ("d", 2.0, "cut", "truncated"),
    ]
    earned = [row[:5] for row in stages(logs) if row[4] is not None]
    assert earned == [
        ("a", 1, 1.5, "suction", 2.5),
        ("a", 2, 4.0, "soft", -1.0),
        ("b", 1, 2.0, "soft", 1.0),
        ("c", 1, 2.0, "soft", 1.0),
        ("d", 1, 2.0, "soft", 1.0),
    ]
    alone = read_table(FLAGGED, BY_FLAGS.replace(', cut = {field = "truncated"}', ""))
    assert [row[2:] for row in ends(alone)] == [("finished", None)] + [("cut", "log ended")] * 3
    made = draft(FLAGGED, "cut = {field = \"truncated\"}  # guess: such as 'false' and 'true'")
    assert ends(read_table(FLAGGED, made)) == ends(logs)
    named = read_table(FLAGGED, BY_FLAGS.replace('"truncated"}', '"truncated"}, values = {truncated = "horizon"}'))
    assert ends(named)[1] == ("b", 2.5, "cut", "horizon")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("finished = {", 'field = "terminated", finished = {', r"cell\.toml, ending: field and topic are of text"),
        ('finished = {field = "terminated"}, ', "", r"ending\.finished: it is not a flag, but cut is; set finished"),
        ('"truncated"', '"truncate"', r"ending\.cut\.field: there is no column 'truncate' .*did you mean 'truncated'"),
        ('"terminated"', '"worth"', r"line 2, column 'worth': '2.5' is neither true nor false"),
        ('"run"', '"tool"', r"the ending must be last by the clock; fix the times, leave flags terminated or truncated "
         "empty in all rows but the last, or have column 'tool' distinguish the trajectories"),
        ('trajectory = {field = "run"}\n', "", r"map \[trajectory\], the column of its name or the event that begins"),
        ('{field = "terminated"}, cut = {field = "truncated"}', '["true"], field = "terminated"',
         r"action comes at 4 s, after its ending .*; column 'terminated' is true or false, so set finished = \{field"),
    ],
)  # fmt: skip
def test_flags_that_do_not_fit_are_refused(read_table, old, new, message):
    assert old in BY_FLAGS
    *rows, _, _, _ = FLAGGED.replace("b,soft,9.5,2,", "b,soft,9.5,5,").replace("6.25,2.5", "6.25,6").splitlines()
    with refused(message):
        read_table("\n".join([*rows, "c,soft,3,7,1,no,no"]), BY_FLAGS.replace(old, new))


def test_what_was_seen_when_a_trajectory_was_cut_after_its_reward_is_asked_for(read_table):
    """Else the state before stands for the one after, as of a time limit in steps of Gymnasium."""
    rows = (
        "run,tool,left,s,worth,terminated,truncated\na,soft,5,1,1,no,no\na,soft,4,2,{},no,yes\n{}b,soft,5,1,1,yes,no\n"
    )
    with pytest.warns(HalfseenWarning, match=f"^.*events.csv: 1 trajectory was {STALE}; add a row with what was seen"):
        logs = read_table(rows.format(2, ""), BY_FLAGS)
    assert logs.stages["left"].tolist() == [5.0, 4.0, 4.0, 5.0]
    logs = read_table(rows.format(2, "").replace("2,no,yes\n", "2,no,no\na,,3,2,,no,yes\n"), BY_FLAGS)
    assert logs.stages["left"].tolist() == [5.0, 4.0, 3.0, 5.0]
    assert read_table(rows.format("", ""), BY_FLAGS).stages["left"].tolist() == [5.0, 4.0, 5.0]


def test_rows_with_the_newest_first_are_reported_to_be_sorted(read_table):
    first, *rows = FLAGGED.splitlines()
    with refused(
        r"after its ending at 4 s; the oldest row must be first, since times count from each stage; sort the "
    ):
        read_table("\n".join([first, *rows[:2][::-1]]), BY_FLAGS.replace('"trajectory"}', '"stage"}'))
    by_reward = BY_FLAGS.replace(
        '{finished = {field = "terminated"}, cut = {field = "truncated"}}', '{finished = "rewarded"}'
    )
    with refused(
        r"must be last by the clock; fix the times, give every row but the last a reward, or have column 'run'"
    ):
        read_table("\n".join([first, rows[0].replace("2.5", ""), rows[1]]), by_reward)
