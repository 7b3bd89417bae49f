"""Tables as R, pandas, databases and historians export them: what comes out was worked out by hand from the rows."""

import warnings

import numpy as np
import pyarrow as pa
import pytest

from event_files import STAGES, WIDE, ends, stages
from halfseen.errors import HalfseenWarning
from halfseen.suggestions import alike
from refusals import refused

PLAIN = STAGES.replace('covariates.left = {field = "seconds left"}\n', "")
SEEN = PLAIN + 'covariates.c = {field = "c"}\n'
DATED = """
clock = {field = "end", begin = "begin"FORMAT}
trajectory = {field = "run"}
action = {field = "tool"}
reward = {field = "worth"}
ending = {field = "over", finished = ["yes"]}
"""


def dated(begin, end):
    return f"run,begin,end,tool,worth,over\na,{begin},{end},x,1,yes\n"


def seen(*cells):
    return "run,tool,ms,worth,stop,c\n" + "".join(f"r{k},x,1500,1,,{cell}\n" for k, cell in enumerate(cells))


@pytest.mark.parametrize("offset", ["+02", "+0200", "+02:00"])
def test_an_offset_may_be_of_whole_hours(read_table, draft, offset):
    """PostgreSQL and DuckDB write timestamptz so."""
    text = dated(f"2025-10-26 02:59:50.25{offset}", f"2025-10-26 02:00:10.5{offset.replace('2', '1')}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ends(read_table(text, DATED.replace("FORMAT", ""))) == [("a", 20.25, "finished", None)]
    assert 'field = "end"' in draft(text)


@pytest.mark.parametrize("zones", [("", "Z"), ("-05:00", "")])
def test_beginnings_and_ends_have_a_zone_or_neither_has(read_table, zones):
    begin, end = zones
    text = dated(f"2025-01-02T10:00:00{begin}", f"2025-01-02T16:00:05{end}")
    with refused(r"'2025-01-02T1\d:00:0\d' has no zone, but column '(begin|end)' has; set clock\.zone"):
        read_table(text, DATED.replace("FORMAT", ""))
    assert ends(read_table(text, DATED.replace("FORMAT", ', zone = "Etc/GMT+5"')))[0][1] in (3605.0, 21605.0)


@pytest.mark.parametrize(
    ("begin", "end", "form"),
    [
        ("20250102100000", "20250102100130", "%Y%m%d%H%M%S"),
        ("20250102T1000Z", "20250102T1001Z", "%Y%m%dT%H%M%z"),
    ],
)
def test_dates_without_separators_have_a_format(read_table, draft, begin, end, form):
    with refused(rf"is a date without separators; set clock\.format = \"{form}\""):
        read_table(dated(begin, end), DATED.replace("FORMAT", ""))
    assert f'format = "{form}"  # guess' in draft(dated(begin, end))
    mapping = DATED.replace("FORMAT", f', format = "{form}"' + ("" if "z" in form else ', zone = "UTC"'))
    assert ends(read_table(dated(begin, end), mapping))[0][1] in (60.0, 90.0)


def test_a_zone_is_not_read_from_its_name(read_table):
    """pandas drops it, or raises what only its own libraries know."""
    text = dated("2025-10-26 02:59:50 CEST", "2025-10-26 02:00:10 CET")
    with refused(r"clock\.format: %Z is the name of a zone, which is not read; use %z for offsets, or set clock\.zone"):
        read_table(text, DATED.replace("FORMAT", ', format = "%Y-%m-%d %H:%M:%S %Z"'))


def test_the_index_of_pandas_and_r_is_a_column(read_table, draft):
    heading, *rows = WIDE.splitlines(keepends=True)
    text = f'"",{heading}' + "".join(f"{k},{row}" for k, row in enumerate(rows))
    assert stages(read_table(text, STAGES), "left") == stages(read_table(WIDE, STAGES, name="plain.csv"), "left")
    assert "row" not in [line.split("=")[0].strip(" []") for line in draft(text).splitlines()]
    by_row = read_table(text.replace(",", ";"), PLAIN.replace('field = "run"', 'field = "row"'))
    assert by_row.trajectories["trajectory"].tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("text", ["NA", "nan", "<NA>", "NULL", "#NV", "#REF!", "#DIV/0!", "<null>"])
@pytest.mark.parametrize("column", ["tool", "c", "run"])
def test_a_text_for_missing_is_no_name(read_table, column, text):
    table = seen("red", text, "blue") if column == "c" else seen("red", "red", "blue")
    table = table.replace("r1,x", {"tool": f"r1,{text}", "c": "r1,x", "run": f"{text},x"}[column])
    message = rf"line 3, column '{column}': '{text}' may mean that nothing is there: set missing = \[\"{text}\"\] in"
    with refused(message):
        read_table(table, SEEN)
    if column != "c":
        return
    named = SEEN.replace('"c"}', f'"c", values = {{"{text}" = "none"}}}}')
    assert stages(read_table(table, named), "c")[1][-1] == "none"
    assert stages(read_table(table, SEEN + f'table.missing = ["{text}"]'), "c")[1][-1] is None


@pytest.mark.parametrize("text", [r"\N", "(null)", "[NULL]", "Null", "NONE", "undefined", "n.a."])
def test_a_mark_for_nothing_in_any_letters_is_no_cause(read_table, text):
    table = f"run,tool,ms,worth,stop\na,x,10,1,{text}\nb,x,20,1,ok\n"
    with refused(r"line 2, column 'stop': .*may mean that nothing is there: set missing = \["):
        read_table(table, PLAIN)


@pytest.mark.parametrize("codes", [("1", "0"), ("2", "1"), ("yes", "no")])
def test_a_status_of_codes_none_of_which_means_finished_is_doubted(read_table, codes):
    table = "run,tool,ms,worth,stop\na,x,10,1,{0}\nb,x,20,,{1}\nc,x,30,1,{0}\n".format(*codes)
    with pytest.warns(HalfseenWarning) as caught:
        read_table(table, PLAIN.replace('[""]', "[]"))
    assert f"'stop' has no finished trajectory, and cuts by {', '.join(sorted(codes))}; if" in str(caught[-1].message)


def test_no_cause_of_a_cut_is_a_mark_for_nothing(read_table):
    """R writes NA where nothing was filled in: two finished trajectories, and one that was lost."""
    text = "run,tool,ms,worth,stop\na,x,10,1,NA\nb,x,20,1,NA\nc,x,20,NA,moved\n"
    logs = read_table(text, PLAIN + 'table.missing = ["NA"]')
    assert ends(logs) == [("a", 0.01, "finished", None), ("b", 0.02, "finished", None), ("c", 0.02, "cut", "moved")]
    for mark in ("NA", "None", "-"):
        with refused(rf"line 2, column 'stop': '{mark}' may mean that nothing is there: .* in values, or in finished"):
            read_table(text.replace("NA\nc", f"{mark}\nc").replace("1,NA", f"1,{mark}").replace("NA,", ","), PLAIN)
        named = PLAIN.replace('[""]', f'["{mark}"]')
        found = ends(read_table(text.replace("1,NA", f"1,{mark}").replace("NA,", ","), named))
        assert [row[2] for row in found] == ["finished", "finished", "cut"]


def test_flags_are_words_of_other_languages_too(read_table):
    mapping = PLAIN.replace('field = "stop", finished = [""]', 'finished = {field = "done"}')
    for yes, no in (("WAHR", "FALSCH"), ("vrai", "faux"), ("Y", "N"), ("Sí", "No")):
        text = f"run,tool,ms,worth,done\na,x,10,1,{no}\na,x,20,1,{yes}\nb,x,20,1,{no}\n"
        assert [row[2:] for row in ends(read_table(text, mapping))] == [("finished", None), ("cut", "log ended")]


def test_a_whole_number_that_no_float_holds_is_refused(read_table):
    large = 2**53 + 1
    with refused(rf"line 2, column 'c': '{large}' is a whole number that no float holds; if it is a name, set type"):
        read_table(seen(large, large - 1), SEEN)
    logs = read_table(seen(large, large - 1), SEEN.replace('"c"}', '"c", type = "text"}'))
    assert logs.stages["c"].tolist() == [str(large), str(large - 1)]
    assert read_table(seen(large - 1, 10**18), SEEN).stages["c"].tolist() == [2.0**53, 1e18]
    columns = {
        "run": ["a"],
        "tool": ["x"],
        "ms": [1500],
        "worth": [1.0],
        "stop": [""],
        "c": pa.array([2**63 + 1], pa.uint64()),
    }
    with refused(rf"row 1, column 'c': '{2**63 + 1}' is a whole number that no float holds"):
        read_table(pa.table(columns), SEEN)


EVENTS = """
topic = "what"
clock = {field = "t"}
trajectory = {field = "run"}
action = {topic = "act", field = "text"}
reward = {topic = "res", field = "val"}
ending = {topic = "end", field = "text", finished = ["done"]}
covariates.w = {topic = "see", field = "val"}
"""


@pytest.mark.parametrize("is_each", [True, False])
def test_rows_may_stand_newest_first_within_each_trajectory(read_table, is_each):
    """The last three events of a trajectory have one second, so that only the order of rows tells theirs."""
    message = (0, "see;;5"), (1, "act;x;"), (2, "res;;1"), (3, "see;;6"), (3, "act;y;"), (4, "res;;2"), (4, "end;done;")
    runs = [[f"2025-01-0{day}T00:00:0{s}Z;r{day};{what}\n" for s, what in message] for day in (1, 2)]
    text = "".join(row for run in runs for row in (run[::-1] if is_each else run))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        logs = read_table(f"t;run;what;text;val\n{text}", EVENTS)
    assert stages(logs, "w") == [
        (f"r{day}", *row) for day in (1, 2) for row in ((1, 2.0, "x", 1.0, 5.0), (2, 4.0, "y", 2.0, 6.0))
    ]


def test_one_clock_for_trajectories_of_one_stage_is_warned_of(read_table):
    rows = [f"r{k},x,{1500 * (k + 1)},1,\n" for k in range(5)]
    message = r"column 'ms': times continue from one trajectory to the next"
    with pytest.warns(HalfseenWarning, match=message):
        read_table("run,tool,ms,worth,stop\n" + "".join(rows), PLAIN)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_table("run,tool,ms,worth,stop\n" + "".join(rows[:4]), PLAIN)
        read_table("run,tool,ms,worth,stop\n" + "".join(rows[::-1]), PLAIN)


def test_a_trajectory_whose_stages_all_end_at_0_was_not_cut_as_it_began(read_table):
    with refused(r"trajectory 7: end_s 0\.0 is not a valid end"):
        read_table("run,tool,ms,worth,stop\n7,x,0,1,\n7,x,0,1,\n", PLAIN)


def test_characters_without_width_are_spelling():
    assert alike(["red", "\ufeffred", "red\u200b", "blue"]) == [["red", "red\u200b", "\ufeffred"]]


@pytest.mark.parametrize("time", ["1970-01-01T00:00:00Z", "1899-12-30T00:00:00Z"])
def test_a_clock_that_was_not_set_is_refused(read_table, time):
    rows = [f"{time};r1;see;;5", "2025-01-01T00:00:01Z;r1;act;x;", "2025-01-01T00:00:02Z;r1;end;done;"]
    with refused(rf"line 2, column 't': '{time}' is a date that a clock has before it is set, and others are of this"):
        read_table("t;run;what;text;val\n" + "\n".join(rows), EVENTS.replace('{topic = "res"', '{topic = "act"'))


@pytest.mark.parametrize("column", ["run", "tool"])
def test_names_that_a_type_rounded_are_refused(read_table, column):
    columns = {"run": ["a"] * 3, "tool": ["x"] * 3, "ms": [1, 2, 3], "worth": [1.0] * 3, "stop": [""] * 3}
    columns[column] = pa.array(np.array([2**24, 2**24 + 2, 2**24 + 4], np.float32))
    with (
        pytest.warns(HalfseenWarning, match="which rounds 16777220 to multiples of 2"),
        refused(rf"row 1, column '{column}': '16777216' is a rounded number that may stand for several names"),
    ):
        read_table(pa.table(columns), PLAIN)


@pytest.mark.parametrize(
    ("encoding", "word"), [("shift_jis", "把持"), ("gbk", "抓取"), ("iso8859_2", "chwyć"), ("mac_roman", "Säule")]
)
def test_a_mapping_names_any_encoding(read_table, encoding, word):
    text = f"run;tool;ms;worth;stop\na;{word};10;1;\n"
    logs = read_table(text, PLAIN + f'table.encoding = "{encoding}"', encoding)
    assert logs.stages["action"].tolist() == [word]
    for unknown in ("klingon", "base64", "hex"):
        with refused(rf"cell\.toml, table\.encoding: '{unknown}' is unknown; use one of Python's"):
            read_table(text, PLAIN + f'table.encoding = "{unknown}"')


def test_times_in_thousands_name_the_remedy(read_table):
    text = "run;tool;ms;worth;stop\na;x;1.000,5;1;\nb;x;2.500,25;1;\n"
    with refused(r"line 2, column 'ms': '1\.000,5' is not a number with decimal mark '\.'; set table\.thousands ="):
        read_table(text, PLAIN)
    assert read_table(text, PLAIN + 'table.thousands = "."').end_s.tolist() == [1.0005, 2.50025]


def test_durations_may_be_hours_minutes_and_seconds(read_table):
    """A stopwatch writes the first three; pandas the fourth."""
    lasted = ["0:00:01,5", "00:01:30", "26:10:00.25", "2 days 00:00:01.500000"]
    rows = [f"r{k};x;{text};1;\n" for k, text in enumerate(lasted)]
    mapping = PLAIN.replace(', unit = "ms"', "")
    logs = read_table("run;tool;ms;worth;stop\n" + "".join(rows), mapping)
    assert logs.end_s.tolist() == [1.5, 90.0, 94200.25, 172801.5]
    for text in ("1:61", "0:61:00", "-0:00:01", "12"):
        with refused(rf"line 2, column 'ms': '{text}' counts since a beginning; set clock\.unit"):
            read_table(f"run;tool;ms;worth;stop\na;x;{text};1;\n", mapping)


def test_durations_in_two_parts_have_the_unit_of_the_first(read_table):
    def read(texts, clock=""):
        rows = [f"r{k};x;{text};1;\n" for k, text in enumerate(texts)]
        return read_table("run;tool;ms;worth;stop\n" + "".join(rows), PLAIN.replace(', unit = "ms"', clock))

    assert read(["1:30", "75:00,5", "1:00:05"], ', unit = "min"').end_s.tolist() == [90.0, 4500.5, 3605.0]
    assert read(["1:30", "1:00:05"], ', unit = "h"').end_s.tolist() == [5400.0, 3605.0]
    with refused("line 2, column 'ms': '1:30' has two parts; set clock.unit = \"min\" for minutes and seconds, or"):
        read(["1:30"])
    with refused('line 2, .* set clock.unit = "min" or "h", that of its first part'):
        read(["1:30"], ', unit = "s"')
    with refused("line 3, column 'ms': '45' has no colon or is no duration, but others are"):
        read(["1:30", "45"], ', unit = "min"')
