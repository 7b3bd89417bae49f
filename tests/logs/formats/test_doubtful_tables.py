"""Tables of which a careless reader makes another log: names, times and files that are taken for what they are not."""

import datetime
from contextlib import nullcontext

import numpy as np
import pyarrow as pa
import pytest

from event_files import AMERICAN, BEGUN, GERMAN, GERMAN_ENDS, GERMAN_STAGES, HISTORIAN, PLC, STAGES, WIDE, ends, stages
from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs.formats import mapping_of, read_event_table
from halfseen.logs.missing import KEEP
from refusals import refused

ENDED = AMERICAN.replace('begin = "time"FORMAT', 'begin = "began", format = "FORMAT"')
"""A mapping of stages whose times have a format."""


@pytest.fixture
def read_files(tmp_path):
    """Read several files by one mapping."""

    def write_and_read(texts, mapping):
        for name, text in texts.items():
            (tmp_path / name).write_text(text)
        (tmp_path / "cell.toml").write_text(mapping)
        return read_event_table([tmp_path / name for name in texts], tmp_path / "cell.toml")

    return write_and_read


def test_hours_of_half_a_day_need_their_half(read_table):
    text = "began;time;run;tool;worth;over\n{};{};1;a;2;yes\n".format(
        *["01/02/2025 11:59:50 AM", "01/02/2025 12:00:05 PM"]
    )
    logs = read_table(text, ENDED.replace("FORMAT", "%d/%m/%Y %I:%M:%S %p"))
    assert ends(logs) == [(1, 15.0, "finished", None)]
    with refused(r"cell\.toml, clock\.format: %p has no effect with %H, .*; use %I instead of %H", ArgumentError):
        read_table(text, ENDED.replace("FORMAT", "%d/%m/%Y %H:%M:%S %p"))
    with refused(r"cell\.toml, clock\.format: %I is an hour from 1 to 12, which needs %p", ArgumentError):
        read_table(text, ENDED.replace("FORMAT", "%d/%m/%Y %I:%M:%S AM"))
    assert ends(
        read_table(text.replace(" AM", " p").replace(" PM", " p"), ENDED.replace("FORMAT", "%d/%m/%Y %H:%M:%S p"))
    )


def test_dates_without_a_year_do_not_run_on_over_a_new_year(read_table):
    text = (
        "began;time;run;tool;worth;over\n31.12. 23:59:40;31.12. 23:59:50;1;a;2;\n{0} 10:00:00;{0} 10:00:05;2;a;2;yes\n"
    )
    mapping = ENDED.replace("FORMAT", "%d.%m. %H:%M:%S").replace('["yes"]', '["yes", ""]')
    logs = read_table(text.format("30.12."), mapping)
    assert [row[1] for row in ends(logs)] == [10.0, 5.0]
    with refused(r"line 3, column 'time': '01\.01\. 10:00:05' comes after '31\.12\. 23:59:50', but .* no year"):
        read_table(text.format("01.01."), mapping)


def test_days_of_a_spreadsheet_are_a_unit_and_guessed_as_such(read_table, draft):
    # 0.00005787037 days are 5 s, to a millionth of a second.
    text = "von;bis;Lauf;Griff;Ertrag;Abbruch\n45961,5;45961,50005787037;7;Sauger;2,5;\n"
    text += "45961,75;45961,7502;8;Zange;;Halt\n"
    made = draft(text, 'unit = "d"  # guess: s, ms, us, ns, min, h or d')
    logs = read_table(text, made)
    assert logs.end_s.round(4).tolist() == [5.0, 17.28]
    assert logs.trajectories["cause"].tolist() == [None, "Halt"]


def test_stages_that_go_on_at_once_are_reported(read_table):
    rows = "began;time;run;tool;worth;over\n1 {};1 10:00:10;1;a;2;\n1 {};1 10:00:20;1;b;2;yes\n"
    mapping = ENDED.replace("FORMAT", "%d %H:%M:%S")
    with pytest.warns(HalfseenWarning, match="line 3: the stage begins before the one above ends, as in 1 of 2 rows"):
        read_table(rows.format("10:00:00", "10:00:05"), mapping)
    for begins in (("10:00:00", "10:00:09"), ("10:00:00", "10:00:00")):  # rounded; of the trajectory
        assert ends(read_table(rows.format(*begins), mapping)) == [(1, 20.0, "finished", None)]


def test_rows_of_days_that_overlap_count_once(read_files):
    heading, *rows = GERMAN.splitlines(keepends=True)
    days = {"1.csv": heading + "".join(rows[:7]), "2.csv": heading + "".join(rows[3:])}
    with pytest.warns(HalfseenWarning, match=r"2\.csv, line 2: it repeats one of another file; such .* skipped: 4"):
        assert ends(read_files(days, HISTORIAN)) == GERMAN_ENDS


RESPELLED = [
    ("Ende;fertig;", "Ende;FERTIG;", r"line 8, column 'Text': 'FERTIG' differs from 'fertig' of the mapping only"),
    ("Griff;Säule;", "Griff;säule;", r"line 3, column 'Text': 'säule' differs from 'Säule' of the mapping only"),
    ("Not-Halt", "Strom weg", None),
    ("Not-Halt", "NOT-HALT", r"'NOT-HALT' differs from 'Not-Halt' of the mapping only in spelling; name it there, too"),
]


@pytest.mark.parametrize(("old", "new", "message"), RESPELLED)
def test_a_text_that_the_mapping_spells_otherwise_is_refused(read_table, old, new, message):
    if message is None:  # another word
        assert ends(read_table(GERMAN.replace(old, new), HISTORIAN))[1][3] == "Strom weg"
        return
    with refused(message, LogError):
        read_table(GERMAN.replace(old, new, 1), HISTORIAN)
    named = HISTORIAN.replace('["fertig"]', '["fertig", "FERTIG"]').replace('"Säule" =', '"säule" = "x", "Säule" =')
    read_table(GERMAN.replace(old, new, 1), named.replace('{"Not-Halt', "{NOT-HALT = 'x', \"Not-Halt"))


def test_an_event_that_the_mapping_spells_otherwise_is_warned_of(read_table):
    message = r"1 events 'GEWICHT' are not mapped, and differ from 'Gewicht' only in spelling"
    with pytest.warns(HalfseenWarning, match=message):
        logs = read_table(GERMAN.replace("Gewicht;;0,75", "GEWICHT;;0,75"), HISTORIAN)
    assert logs.stages["weight"].tolist()[:2] == [0.5, 0.5]
    both = HISTORIAN.replace('topic = "Gewicht"', 'topic = ["Gewicht", "GEWICHT"]')
    assert stages(read_table(GERMAN.replace("Gewicht;;0,75", "GEWICHT;;0,75"), both), "weight") == GERMAN_STAGES


def test_whole_names_that_a_missing_value_made_fractions_are_whole(read_table):
    text = (
        WIDE.replace("\nb,", "\n2.0,").replace("a,suction", "1,3.0").replace("a,soft", "1.0,4").replace("soft", "4.0")
    )
    logs = read_table(text.replace("suction", "3"), STAGES)
    assert [row[:4] for row in stages(logs)] == [(1, 1, 1.5, 3), (1, 2, 4.0, 4), (2, 1, 2.0, 4), (2, 2, None, 3)]
    firmware = read_table(WIDE.replace("suction", "1.5").replace("soft", "1.0"), STAGES)
    assert firmware.stages["action"].tolist() == ["1.5", "1.0", "1.0", "1.5"]


@pytest.mark.parametrize("name", ["1.23457E+17", "1,2e+05", "1e+22"])
def test_names_that_were_rounded_are_refused(read_table, name):
    for column in ("run", "tool"):
        text = WIDE.replace({"run": "b,", "tool": ",soft"}[column], {"run": f'"{name}",', "tool": f',"{name}"'}[column])
        with refused(rf"column '{column}': '{name[0]}.*' is a rounded number that may stand for several names"):
            read_table(text, STAGES)
    assert read_table(WIDE.replace("b,", "1E5,"), STAGES).trajectory_ids.tolist() == ["1E5", "a"]


def test_rows_of_one_name_that_stand_apart_are_warned_of(read_table, read_files):
    day = "run,tool,seconds left,ms,worth,stop\n1,soft,9,1500,1,\n2,soft,9,2500,1,\n"
    apart = r"line 2: rows of trajectory 1 are not adjacent, as in 2 of 2 trajectories"
    with pytest.warns(HalfseenWarning, match=rf"file tuesday\.csv, {apart}.* join the logs"):
        read_files({"monday.csv": day, "tuesday.csv": day.replace("00", "50")}, STAGES)
    night = {"monday.csv": day, "tuesday.csv": day.replace("1,soft,9,1500,1,\n", "").replace("2500", "4500")}
    assert [row[1] for row in ends(read_files(night, STAGES))] == [1.5, 4.5]
    heading, *rows = GERMAN.splitlines(keepends=True)
    mixed = heading + "".join(sorted(rows, key=lambda row: row.split(";")[0][14:19]))  # of two robots, by one clock
    with pytest.warns(HalfseenWarning, match="rows are sorted by time"):
        assert stages(read_table(mixed, HISTORIAN), "weight") == GERMAN_STAGES


@pytest.mark.parametrize(("again", "is_reported"), [("27T10:05", False), ("29T10:00", True)])
def test_events_of_one_name_that_are_days_apart_are_warned_of(read_table, again, is_reported):
    row = "2025-10-{0}:0{1};{2};{3};{4};{5}\n".format
    text = "Zeit;Lauf;Ereignis;Text;Wert\n"
    for time, run in (("27T10:00", 1), ("27T10:01", 2), (again, 1)):
        cells = [("Gewicht", "", "1.5"), ("Griff", "x", ""), ("Ablage", "", "2.5")] + [("Ende", "fertig", "")] * (
            run == 2
        )
        text += "".join(row(time, k, run, *each) for k, each in enumerate(cells))
    message = (
        "line 9: rows of trajectory 1 have long pauses, as in 1 of 2 trajectories, and each counts as one: if names"
    )
    with pytest.warns(HalfseenWarning, match=message) if is_reported else nullcontext():
        read_table(text, HISTORIAN.replace('"Zeit"', '"Zeit", zone = "UTC"').replace('"Säule" = "column"', 'x = "y"'))


def test_each_of_several_files_is_a_trajectory_unless_a_column_tells(read_files, tmp_path):
    episode = "tool,seconds left,ms,worth,stop\nsoft,9,1500,1,\nsoft,8,{}\n"
    mapping = STAGES.replace('trajectory = {field = "run"}\n', "")
    logs = read_files({"ep1.csv": episode.format("2500,2,"), "ep2.csv": episode.format("3000,,halt")}, mapping)
    assert ends(logs) == [("ep1.csv", 2.5, "finished", None), ("ep2.csv", 3.0, "cut", "halt")]
    assert [row[:3] for row in stages(logs)] == [
        ("ep1.csv", 1, 1.5),
        ("ep1.csv", 2, 2.5),
        ("ep2.csv", 1, 1.5),
        ("ep2.csv", 2, None),
    ]
    assert ends(read_files({"ep1.csv": episode.format("2500,2,")}, mapping)) == [("ep1.csv", 2.5, "finished", None)]
    for folder in ("monday", "tuesday"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "ep1.csv").write_text(episode.format("2500,2,"))
    files = [tmp_path / folder / "ep1.csv" for folder in ("monday", "tuesday")]
    assert read_event_table(files, tmp_path / "cell.toml").trajectory_ids.tolist() == list(map(str, files))


def test_a_copy_of_a_file_is_refused(read_files):
    copied = {"a.csv": WIDE, "b.csv": WIDE.replace("b,", "c,"), "a (1).csv": WIDE}
    with refused(r"a \(1\)\.csv: its rows are those of .*a\.csv; leave one of the two files out"):
        read_files(copied, STAGES.replace('"trajectory"', '"stage"'))


def test_files_may_have_their_columns_in_another_order(read_files):
    turned = "stop,worth,ms,seconds left,tool,run\n,1,1500,9,soft,c\n"
    logs = read_files({"one.csv": WIDE, "two.csv": turned}, STAGES)
    assert stages(logs, "left")[-1] == ("c", 1, 1.5, "soft", 1.0, 9.0)
    with refused(
        r"two\.csv: its columns differ from those of .*one\.csv \('left', 'seconds left'\); convert each "
        "separately"
    ):
        read_files({"one.csv": WIDE, "two.csv": turned.replace("seconds left", "left")}, STAGES)


@pytest.mark.parametrize(
    ("name", "text", "differs"),
    [
        ("b.csv", "run;tool;seconds left;ms;worth;stop\nc;soft;9;1500;1;\n", "another separator"),
        (
            "b.jsonl",
            '{"run":"c","tool":"soft","seconds left":9,"ms":1500,"worth":1,"stop":""}\n',
            "another kind of file",
        ),
    ],
)
def test_files_that_are_written_otherwise_are_named_as_such(read_files, name, text, differs):
    with refused(rf"{name}: its columns differ from those of .*a\.csv \({differs}\); convert each separately"):
        read_files({"a.csv": WIDE, name: text}, STAGES)


def test_an_ending_in_every_row_is_reported_as_such(read_table):
    message = r"after its ending at 2 s; .*; fix the times, leave column 'stop' empty in all rows but the last, or have"
    with refused(message):
        read_table(WIDE.replace("2000,1,", "2000,1,operator"), STAGES)


WHOLE = {
    "run": ["a", "a", "b"],
    "tool": ["soft", "soft", "hard"],
    "seconds left": [9.0, 8.0, 7.0],
    "ms": [1500, 4000, 2500],
    "worth": [1.0, 2.0, None],
    "stop": [None, None, "operator"],
}


@pytest.fixture
def read_parquet(read_table):
    return lambda missing=None, **columns: read_table(pa.table(WHOLE | columns), STAGES, missing=missing)


@pytest.mark.parametrize(
    "values",
    [
        [[1], [2], [3]],
        [{"x": 1}, {"x": 2}, {"x": 3}],
        [datetime.timedelta(seconds=s) for s in (1, 2, 3)],
        [b"\xff"] * 3,
    ],
)
def test_a_column_without_a_text_form_is_passed_over_unless_it_is_mapped(read_parquet, tmp_path, values):
    assert ends(read_parquet(more=values)) == [("a", 4.0, "finished", None), ("b", 2.5, "cut", "operator")]
    result = [line for line in mapping_of(tmp_path / "t.parquet").splitlines() if "which is not read" in line]
    assert len(result) == 1
    assert result[0].startswith("# Column 'more' holds ")
    for column, key in (("seconds left", r"covariates\.left\.field"), ("ms", r"clock\.field")):
        with refused(rf"cell\.toml, {key}: column '{column}' of .* holds (list|struct|duration|binary)", ArgumentError):
            read_parquet(**{column: values})


@pytest.mark.parametrize(("kind", "most", "step"), [("float32", 2.0**24, 2), ("float64", 2.0**53, 2)])
def test_fractions_that_round_whole_numbers_are_warned_of(read_parquet, kind, most, step):
    assert len(ends(read_parquet(serial=np.array([1, most - 1, 2], kind)))) == 2
    with pytest.warns(
        HalfseenWarning, match=rf"column 'serial': it holds {kind}, which rounds .* multiples of {step};"
    ):
        read_parquet(serial=np.array([1, -most, 2], kind))


@pytest.mark.parametrize("cell", ["NaN", "n/a", "NULL", "-", "#VALUE!", "NaT"])
def test_what_looks_missing_is_reported_as_such(read_table, cell):
    message = rf"column 'seconds left': '{cell}' is not a number.* if it is missing, leave it empty, or set missing = "
    for old in ("9.5", "6.25"):
        with refused(message):
            read_table(WIDE.replace(old, cell, 1), STAGES)
    mapping = STAGES.replace('"seconds left"}', f'"seconds left", values = {{"{cell}" = nan}}}}')
    assert ends(read_table(WIDE, mapping)) == ends(read_table(WIDE, STAGES))
    with refused(r"trajectory 'a', stage 1: covariate left is null"):
        read_table(WIDE.replace("9.5", cell, 1), mapping)


def test_a_suffix_may_be_in_capitals(read_table):
    assert stages(read_table(WIDE, STAGES, name="WIDE.CSV")) == stages(read_table(WIDE, STAGES))
    with refused(r"BOOK\.XLS: such workbooks are not read"):
        read_table("", STAGES, name="BOOK.XLS")


ORDERS = """\
Export
Datum;Uhrzeit;Anlage;Meldung;Text;Wert
24.10.2025;22:00:00;Zelle3;AUFTRAG_START;A1;
24.10.2025;22:00:01;Zelle3;GEWICHT;;1,25
24.10.2025;22:00:02;Zelle3;GREIFER_WAHL;Sauger;
24.10.2025;22:00:04;Zelle3;GRIFF_ERGEBNIS;gut;
24.10.2025;22:00:05;Zelle3;AUFTRAG_ENDE;fertig;
24.10.2025;22:01:00;Zelle3;AUFTRAG_START;A2;
24.10.2025;22:01:01;Zelle3;GEWICHT;;1,5
24.10.2025;22:01:02;Zelle3;GREIFER_WAHL;Zange;
24.10.2025;22:01:03;Zelle3;AUFTRAG_ENDE;Not-Halt;
"""
"""Events whose name is first of an order, then of what happened, beside a column that is always the same."""


def test_the_mapping_of_events_passes_over_a_column_that_never_changes(read_table, draft):
    made = draft(ORDERS).replace('# values = {"gut" = 1.0}', 'values = {"gut" = 2.0}')
    logs = read_table(ORDERS, made.replace("# zone", "zone"))
    assert ends(logs) == [("A1", 5.0, "finished", None), ("A2", 3.0, "cut", "Not-Halt")]
    assert stages(logs, "GEWICHT") == [("A1", 1, 4.0, "Sauger", 2.0, 1.25), ("A2", 1, None, "Zange", None, 1.5)]


def test_stages_side_by_side_are_reported_of_in_the_mapping(draft):
    message = "wide = \"{name} {stage}\"  # guess: 'Griff', 'Dauer' are by stage"
    draft("Nr;Griff 1;Dauer 1;Griff 2;Dauer 2\n1;Sauger;1,5;Zange;2,5\n2;Zange;2,5;;\n", message)
    joints = "run,joint_1,joint_2,tool_1,tool_2,action,t\na,1,2,x,y,go,1\na,1,2,y,x,go,2\n"
    for text in (WIDE, PLC, joints):
        assert "wide = " not in draft(text)


def test_a_controllers_events_begin_trajectories_in_many_files_too(read_files):
    heading, *rows = PLC.splitlines(keepends=True)
    logs = read_files({"a.csv": heading + "".join(rows[:6]), "b.csv": heading + "".join(rows[6:])}, BEGUN)
    assert ends(logs) == [(1, 4.0, "finished", None), (2, 4.0, "cut", "log ended")]


@pytest.mark.parametrize("words", [("true", "false"), ("True", "False"), ("TRUE", "FALSE")])
def test_truth_values_are_no_categories(read_table, read_parquet, words):
    yes, no = words
    text = WIDE.replace("9.5", yes).replace(",8,", f",{no},")
    logs = read_table(text.replace("6.25", no), STAGES)
    assert logs.stages["left"].dtype == bool
    assert logs.stages["left"].tolist() == [True, False, True, False]
    assert read_parquet(**{"seconds left": [True, False, None]}, missing=KEEP).stages["left"].isna().sum() == 1
    as_text = read_table(text.replace("6.25", no), STAGES.replace('left"}', 'left", type = "text"}'))
    assert as_text.stages["left"].tolist() == [yes, no, yes, no]


def test_files_without_rows_are_passed_over_with_a_warning(read_files):
    heading = WIDE.splitlines()[0]
    with pytest.warns(HalfseenWarning, match=r"b\.csv: 2 of 3 files have no rows, and are skipped; this is the first"):
        logs = read_files({"a.csv": WIDE, "b.csv": f"{heading}\n", "c.csv": ""}, STAGES)
    assert stages(logs) == stages(read_files({"a.csv": WIDE}, STAGES))
    with (
        pytest.warns(HalfseenWarning, match="1 of 1 files"),
        refused("all its tables are empty; give at least one with rows"),
    ):
        read_files({"b.csv": heading}, STAGES)


def test_a_minus_of_typesetters_is_one(read_table):
    logs = read_table(WIDE.replace("9.5", "\u22129.5").replace("-1", "\u22121"), STAGES)
    assert logs.stages["left"].tolist() == [-9.5, 8.0, -9.5, 6.25]
    assert logs.stages["reward"].tolist()[1] == -1.0


@pytest.mark.parametrize("cell", ["1.76441E+10", "1.764405e+09", "2E7"])
def test_times_of_few_digits_are_warned_of(read_table, cell):
    text = WIDE.replace("1500", cell).replace("4000", f"9{cell[1:]}")
    with pytest.warns(HalfseenWarning, match=r"column 'ms': times such as .* are rounded; export them with all digits"):
        read_table(text, STAGES)
    assert read_table(WIDE.replace("1500", "1.5e3"), STAGES).elapsed_s()[0, 0] == 1.5


@pytest.mark.parametrize(
    ("time", "line"),
    [
        ("26-NOV-25 10:00:0{}", 'format = "%d-%b-%y %H:%M:%S"  # guess'),
        ("11/26/2025 10:00:0{}.125 PM", 'format = "%m/%d/%Y %I:%M:%S.%f %p"  # guess'),
        ("176440500000{}", 'unit = "ms"  # guess: s, ms, us, ns, min, h or d'),
        ("176440500000{}000", 'unit = "us"  # guess: s, ms, us, ns, min, h or d'),
        ("176440500{}.5", 'unit = "s"  # guess: s, ms, us, ns, min, h or d'),
    ],
)
def test_times_of_other_programs_are_guessed(draft, time, line):
    draft(f"run;time;tool;worth\n1;{time.format(0)};a;1\n1;{time.format(5)};b;2\n", line)


def test_one_byte_of_another_encoding_does_not_change_all_other_letters(read_table):
    content = GERMAN.encode() + "2025-10-26T02:21:00+01:00;9;Störung;;\n".encode("cp1252")
    with refused(r"line 15: bytes b'\\xf6' are not UTF-8, though other bytes are; fix them, or set table\.encoding"):
        read_table(content, HISTORIAN)
    said = HISTORIAN + 'table = {encoding = "cp1252"}'
    assert read_table(content, said).stages["action"].tolist()[0] == "S\u00c3\u00a4ule"
    assert read_table(GERMAN.encode("cp1252"), HISTORIAN).stages["action"].tolist()[0] == "column"


RESTARTED = """\
t;tag;v
0;BEGIN;
1;LOOK;0.5
2;PICK;soft
4;OK;
90;LOOK;0.25
3;LOOK;0.125
3.5;BEGIN;
4;LOOK;0.75
5;PICK;hard
7;NOK;
8;END;done
"""
"""A controller that lost its power in the first trajectory, and counts from 0 again."""


def test_a_clock_that_starts_again_is_not_mixed_with_what_it_counted_before(read_table):
    with pytest.warns(HalfseenWarning) as caught:
        logs = read_table(RESTARTED, BEGUN)
    said = [str(each.message).split("events.csv", 1)[1] for each in caught]
    assert said[0].startswith(", line 7: the clock restarts where a trajectory begins, 1 times in all;")
    assert said[1].startswith(": 1 values come before the first beginning of a trajectory; they are left out")
    assert ends(logs) == [(1, 90.0, "cut", "log ended"), (2, 4.5, "finished", None)]
    assert stages(logs, "clutter") == [
        (1, 1, 4.0, "soft", 1.0, 0.5),
        (1, 2, None, None, None, 0.25),
        (2, 1, 3.5, "hard", -0.5, 0.75),
    ]


def test_a_late_row_and_rows_out_of_order_are_no_new_start(read_table):
    rows = PLC.splitlines(keepends=True)
    late = "".join([*rows[:7], "103;LOOK;0.75\n", *rows[7:]])
    with pytest.warns(
        HalfseenWarning, match="line 8: the time is before that of the row above; rows are sorted by time"
    ):
        assert ends(read_table(late, BEGUN)) == ends(read_table(PLC, BEGUN))
    turned = "".join([rows[0], *rows[7:], *rows[2:7]])
    with pytest.warns(HalfseenWarning, match="the clock restarts where a trajectory begins"):
        found = read_table(turned, BEGUN)
    assert [row[1:] for row in ends(found)] == [row[1:] for row in ends(read_table(PLC, BEGUN))][::-1]
    dates = [row if k == 0 else f"17{row[:3]}00000{row[3:]}" for k, row in enumerate(turned.splitlines(keepends=True))]
    with pytest.warns(HalfseenWarning, match="rows are sorted by time"):
        assert [row[2:] for row in ends(read_table("".join(dates), BEGUN))] == [
            row[2:] for row in ends(read_table(PLC, BEGUN))
        ]


def test_a_stage_that_was_written_twice_is_warned_of_where_no_clock_tells(read_table):
    text = "run,step,tool,s,worth,stop\na,1,x,2.5,1,\na,2,y,1.5,1,\na,2,y,1.5,1,\na,3,x,2,1,done\nb,1,x,2,1,done\n"
    mapping = """
        clock = {field = "s", unit = "s", since = "stage"}
        trajectory = {field = "run"}
        action = {field = "tool"}
        reward = {field = "worth"}
        ending = {field = "stop", finished = ["done"]}
    """
    message = "line 4: it repeats the one above, and counts as a stage of its own; if it was written twice, delete it"
    with pytest.warns(HalfseenWarning, match=message):
        assert len(read_table(text, mapping).stages) == 5
    assert len(read_table(text.replace("a,2,y,1.5,1,\n", "", 1), mapping).stages) == 4
