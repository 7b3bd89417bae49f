"""Tables as historians, spreadsheets and controllers export them: what comes out was worked out by hand."""

import re
from contextlib import nullcontext

import pytest

from event_files import AMERICAN, GERMAN, GERMAN_ENDS, GERMAN_STAGES, HISTORIAN, STAGES, WIDE, ends, stages
from halfseen.errors import ArgumentError, HalfseenWarning
from refusals import refused

MIDNIGHT = """\
Heure;Cycle;Événement;Libellé;Valeur
23:59:50,5;1;Poids;;1,5
23:59:51,0;1;Prise;ventouse;
23:59:58,0;1;Dépose;;2,5
00:00:01,0;1;Poids;;1.234,5
00:00:02,0;1;Prise;pince;
00:00:05,25;1;Dépose;;-1,5
00:00:06,5;1;Fin;terminé;
22:10:00,0;2;Poids;;3,5
22:10:01,0;2;Prise;pince;
"""
"""A night without dates; the second cycle is of the next evening, and breaks off at the end of the file."""
MIDNIGHT_STAGES = [
    (1, 1, 7.5, "ventouse", 2.5, 1.5),
    (1, 2, 14.75, "pince", -1.5, 1234.5),
    (2, 1, None, "pince", None, 3.5),
]
MIDNIGHT_ENDS = [(1, 16.0, "finished", None), (2, 1.0, "cut", "log ended")]


@pytest.mark.parametrize("is_newest_first", [False, True])
def test_times_of_day_run_on_over_midnight(read_table, draft, is_newest_first):
    heading, *rows = MIDNIGHT.replace("22:10", "17:10").splitlines(keepends=True)
    text = heading + "".join(rows[::-1] if is_newest_first else rows)
    made = draft(
        text,
        'format = "%H:%M:%S,%f"  # guess',
        'thousands = "."  # guess: between groups of three digits',
        encoding="utf-8-sig",
    )
    with pytest.warns(HalfseenWarning, match="times have no date, so those that fall back past midnight"):
        logs = read_table(text, made, "utf-8-sig")
    assert stages(logs, "Poids") == MIDNIGHT_STAGES
    assert ends(logs) == MIDNIGHT_ENDS


@pytest.mark.filterwarnings("ignore:.*times have no date")
def test_times_of_day_that_leave_the_day_open_are_refused(read_table, draft):
    made = draft(MIDNIGHT)
    with refused(r"line 9, column 'Heure': '22:10:00,0' comes after '00:00:06,5'.* name the column of dates"):
        read_table(MIDNIGHT, made)
    with refused(r"clock: the format has no day, which zone and begin need"):
        read_table(MIDNIGHT, made.replace('format = "%H', 'zone = "Europe/Paris"\nformat = "%H'))
    with refused(r"line 2, column 'Heure': '23:59:50,5' has no date; set clock.format, such as \"%H:%M:%S\""):
        read_table(MIDNIGHT, made.replace('format = "%H', '# format = "%H'))


SPLIT = """\
Linie 4
Zeitraum: 03.11.2025 bis 04.11.2025

Datum;Uhrzeit;Ereignis;Greifer;Gewicht [g];Ergebnis
03.11.2025;23:59:58.250;Start;;;
03.11.2025;23:59:58.250;Messung;;429,7;
03.11.2025;23:59:58.250;Griff;Zange;;
04.11.2025;00:00:03.750;Ablage;;;i.O.
04.11.2025;00:00:04.000;Ende;;;
05.11.2025;00:00:10.000;Start;;;
05.11.2025;00:00:10.000;Messung;;1.407,4;
05.11.2025;00:00:11.000;Griff;Sauger;;
05.11.2025;00:00:12.500;Ablage;;;n.i.O.
"""
"""Lines above the heading, date and time of day in two columns; the last trajectory breaks off between stages."""


def test_dates_and_times_of_day_in_two_columns_below_other_lines(read_table, draft):
    made = draft(
        SPLIT,
        "heading = 4  # guess: the line that names the columns",
        'thousands = "."  # guess: between groups of three digits',
        "field = [\"Datum\", \"Uhrzeit\"]  # guess: such as '03.11.2025 23:59:58.250' and '04.11.2025 00:00:03.750'",
        'format = "%d.%m.%Y %H:%M:%S.%f"  # guess',
        '# values = {"i.O." = 1.0, "n.i.O." = 1.0}  # what each earns',
    )
    made = made.replace('# zone = "Europe', 'zone = "Europe')
    with refused(r"line 8, column 'Ergebnis': 'i\.O\.' is not a number .*set values"):
        read_table(SPLIT, made)
    made = made.replace('# values = {"i.O." = 1.0, "n.i.O." = 1.0}', 'values = {"i.O." = 2, "n.i.O." = -1}')
    logs = read_table(SPLIT, made)
    # The last stage had begun: what was seen is known, and no action.
    assert stages(logs, "Messung") == [
        (1, 1, 5.5, "Zange", 2.0, 429.7),
        (2, 1, 2.5, "Sauger", -1.0, 1407.4),
        (2, 2, None, None, None, 1407.4),
    ]
    assert ends(logs)[0] == (1, 5.75, "finished", None)
    assert ends(logs)[1][2:] == ("cut", "log ended")
    with refused(r"line 8, column 'Datum': '' is not part of a time; every row needs one"):
        read_table(SPLIT.replace("04.11.2025;00:00:03.750", ";00:00:03.750"), made)


WORKS = """\
Datum;Beginn;Ende;Auftrag;Greifer;Gewicht [kg];Ertrag;Abbruch
03.11.2025;23:59:40;23:59:48;1;Sauger;1,5;2,50;
03.11.2025;23:59:50;23:59:53;1;Zange;1,5;-1,00;
04.11.2025;00:00:10;00:00:14;2;Zange;2,5;1,00;
04.11.2025;00:00:14;00:00:20;2;Sauger;2,5;;Not-Halt
"""
"""One row a stage, with times of day of its beginning and its end."""


def test_a_stage_begins_and_ends_at_times_of_day_of_one_date(read_table, draft):
    made = draft(
        WORKS,
        "field = [\"Datum\", \"Ende\"]  # guess: such as '03.11.2025 23:59:48' and '03.11.2025 23:59:53'",
        "begin = [\"Datum\", \"Beginn\"]  # guess: such as '03.11.2025 23:59:40' and '03.11.2025 23:59:50'",
        "field = \"Abbruch\"  # guess: such as 'Not-Halt'",
        'finished = [""]  # guess: endings that are not cuts, "" for an empty cell',
    )
    made = made.replace('# zone = "Europe', 'zone = "Europe')
    logs = read_table(WORKS, made)
    assert stages(logs, "Gewicht [kg]") == [
        (1, 1, 8.0, "Sauger", 2.5, 1.5),
        (1, 2, 13.0, "Zange", -1.0, 1.5),
        (2, 1, 4.0, "Zange", 1.0, 2.5),
        (2, 2, None, "Sauger", None, 2.5),
    ]
    assert ends(logs) == [(1, 13.0, "finished", None), (2, 10.0, "cut", "Not-Halt")]
    with refused(r"line 3, column 'Ende': '00:00:03' is before its beginning"):
        read_table(WORKS.replace("23:59:53", "00:00:03"), made)


def test_dates_without_the_times_that_stand_beside_them_are_refused(read_table):
    text = "Tag;Uhr;run;tool;worth;over\n2025-11-03;10:00:00;1;a;1;\n2025-11-03;10:00:10;1;b;2;yes\n"
    mapping = AMERICAN.replace('"time"FORMAT', '"Tag"').replace('field = "time"', 'field = "Tag"')
    names = r"clock\.field = \[\"Tag\", \"Uhr\"\]"
    with refused(rf"line 2, column 'Tag': '2025-11-03' has no time of day, and column 'Uhr' has; name both: {names}"):
        read_table(text, mapping)
    with refused(rf"line 2, column 'Uhr': '10:00:00' has no date; set {names} and clock\.format"):
        read_table(text, mapping.replace('"Tag"', '"Uhr"'))
    text = (
        text.replace("Uhr;", "Uhr;since;")
        .replace(":00;1;a", ":00;2025-11-03T09:59:59.5;1;a")
        .replace(":10;1;b", ":10;2025-11-03T10:00:05;1;b")
    )
    logs = read_table(
        text, mapping.replace('{field = "Tag", begin = "Tag"', '{field = ["Tag", "Uhr"], begin = "since"')
    )
    assert [row[2] for row in stages(logs)] == [0.5, 10.5]


@pytest.mark.parametrize(
    ("cells", "layout", "values"),
    [
        (("1.234,5", "2.345.678", "-1.000,25", "7,5"), 'thousands = "."', [1234.5, 2345678.0, -1000.25, 7.5]),
        (("1,234.5", "2,345,678", "-1,000.25", "7.5"), 'thousands = ","', [1234.5, 2345678.0, -1000.25, 7.5]),
        (("1'234.5", "2’345’678", "-1'000.25", "7.5"), "thousands = \"'\"", [1234.5, 2345678.0, -1000.25, 7.5]),
        (("1 234,5", "2\u00a0345\u202f678", "-1 000,25", "7,5"), 'thousands = " "', [1234.5, 2345678.0, -1000.25, 7.5]),
        (("1.234", "2.345", "5", "1.000.000"), 'thousands = "."', [1234.0, 2345.0, 5.0, 1e6]),
    ],
)  # fmt: skip
def test_a_mark_of_thousands_is_read_where_it_is_said(read_table, cells, layout, values):
    text = GERMAN.replace("1,25", "1").replace("-2,5", "2")
    for old, new in zip(("0,5", "0,75", "1,0", "1,5"), cells, strict=True):
        text = text.replace(f"Gewicht;;{old}\n", f"Gewicht;;{new}\n")
    logs = read_table(text, f"{HISTORIAN}\ntable = {{{layout}}}")
    assert logs.stages["weight"].tolist() == values
    if "." not in cells[0] or "," in cells[0]:
        with refused(r"is not a number with decimal mark .*; fix it, or set table\.thousands = |has a point, but"):
            read_table(text, HISTORIAN)


def test_a_comma_may_separate_cells_and_stand_in_their_fractions(read_table):
    quoted = "\n".join(",".join(f'"{cell}"' for cell in line.split(";")) for line in GERMAN.splitlines())
    assert stages(read_table(quoted, HISTORIAN), "weight") == GERMAN_STAGES
    # In thousands, or English fractions: the separator decides for these.
    english = GERMAN.replace("0,5", "0.5").replace("0,75", "0.75").replace("1,0", "1.0").replace("1,5", "1.500")
    quoted = english.replace("1,25", "1.25").replace("-2,5", "-2.5").replace("58,5", "58.5").replace(";", ",")
    assert stages(read_table(quoted, HISTORIAN), "weight") == GERMAN_STAGES


@pytest.mark.parametrize("cell", ["1.23,5", "12.34.567", ".234,5", "1234.567,8", "0.234,5", "1.234,5.6", "1..234"])
def test_what_is_not_grouped_by_three_is_no_number(read_table, cell):
    with refused("is not a number with decimal mark ','"):
        read_table(GERMAN.replace("1,25", cell), f"{HISTORIAN}\ntable = {{thousands = '.'}}")
    with refused(r"table\.thousands: it is also the decimal mark"):
        read_table(GERMAN, f"{HISTORIAN}\ntable = {{thousands = '.', decimal = '.'}}")


@pytest.mark.parametrize("event", ["Gewicht;;0,75", "Griff;Kiste;", "Ablage;;-2,5", "Ende;fertig;"])
def test_an_event_that_stands_there_twice_counts_once(read_table, event):
    line = next(line for line in GERMAN.splitlines() if line.endswith(event))
    with pytest.warns(HalfseenWarning, match=r"line \d: it repeats the one before it; such rows are skipped: 2"):
        logs = read_table(GERMAN.replace(line, "\n".join([line] * 3), 1), HISTORIAN)
    assert stages(logs, "weight") == GERMAN_STAGES
    assert ends(logs) == GERMAN_ENDS
    heading, row, *_ = WIDE.splitlines(keepends=True)
    with pytest.warns(HalfseenWarning, match="line 3: it repeats the one above, and counts as a stage of its own"):
        twice = read_table(heading + row + row, STAGES.replace('"trajectory"', '"stage"'))
    assert [stage[2] for stage in stages(twice)] == [1.5, 3.0]


@pytest.mark.parametrize(
    ("good", "bad"), [("Good", "Bad"), ("StatusCode(Good)", "StatusCode(BadNoData)"), ("192", "0")]
)
def test_values_of_bad_quality_are_reported_of(read_table, good, bad):
    heading, *rows = WIDE.splitlines()
    text = "\n".join([f"{heading},q", *(f"{row},{bad if k == 2 else good}" for k, row in enumerate(rows))])
    with pytest.warns(HalfseenWarning, match=r"column 'q': it is '.*' in 1 rows, whose values count like any others"):
        read_table(text, STAGES)
    read_table(text.replace(good, "7"), STAGES)


@pytest.mark.parametrize("is_reported", [True, False])
def test_times_of_day_that_are_written_as_numbers_are_reported_of(read_table, is_reported):
    times = [100 * (100 * 9 + 55 + k) + 7 * k % 60 + (60 if k == 3 and not is_reported else 0) for k in range(5)]
    times += [100 * (100 * 10 + k) + 7 * k % 60 for k in range(12)]
    text = "run,tool,s,worth,stop\n" + "".join(f"a,x,{time},1,\n" for time in times)
    mapping = STAGES.replace('"ms", unit = "ms"', '"s", unit = "s"').split("covariates")[0]
    message = r"times such as '95500' look like hours, minutes and seconds"
    with pytest.warns(HalfseenWarning, match=message) if is_reported else nullcontext():
        read_table(text, mapping)


def test_a_mapping_and_a_table_may_begin_with_the_mark_of_utf_8(read_table):
    for mapping in (HISTORIAN, f'{HISTORIAN}\ntable = {{encoding = "utf-8"}}'):
        assert (
            stages(read_table(GERMAN, "\ufeff" + mapping.replace("\n", "\r\n"), "utf-8-sig"), "weight") == GERMAN_STAGES
        )


def test_what_stands_after_the_action_of_its_own_time_is_warned_of(read_table):
    grip, weight = (next(line for line in GERMAN.splitlines() if line.endswith(end)) for end in ("Kiste;", ";0,75"))
    at_once = weight.replace("02:00:02", "02:00:03")
    early = GERMAN.replace(weight, at_once)
    assert stages(read_table(early, HISTORIAN), "weight") == GERMAN_STAGES
    late = GERMAN.replace(f"{weight}\n{grip}", f"{grip}\n{at_once}")
    with pytest.warns(HalfseenWarning, match=r"1 values of 'Gewicht' have the time of an action, but come after it"):
        found = read_table(late, HISTORIAN)
    assert stages(found, "weight")[1] == (7, 2, 15.0, "Kiste", -2.5, 0.5)
    first = "2025-10-26T02:59:50+02:00;7;Gewicht;;0,5\n"
    with refused(r"stage 1: no message of 'Gewicht' came before its action"):
        read_table(GERMAN.replace(first, ""), HISTORIAN)


def test_a_covariate_keeps_its_value_from_before_the_event_that_began_the_trajectory(read_table):
    # The first weight of each trajectory stands before its beginning; the third has none of its own.
    lines = re.sub(r"(?m)^(.*);(\d);Gewicht;;(0,5|1,0)$", r"\1;\2;Gewicht;;\3\n\1;\2;Anfang;;", GERMAN)
    lines = lines.replace("9;Gewicht;;1,5", "9;Anfang;;")
    keeping = HISTORIAN.replace('{field = "Lauf"}', '{topic = "Anfang"}')
    keeping = keeping.replace('"Gewicht", field = "Wert"}', '"Gewicht", field = "Wert", keeps = true}')
    found = read_table(lines, keeping)
    assert found.stages["weight"].tolist() == [0.5, 0.75, 1.0, 1.0]
    with refused(r"covariates\.weight\.keeps: it is for trajectories that begin with an event", ArgumentError):
        read_table(GERMAN, keeping.replace('{topic = "Anfang"}', '{field = "Lauf"}'))


SPANS = """\
Charge;Start_ms;Ende_ms;Greifer;p;Verdeckung;Ertrag;Abschluss;Fehlertext
1;21600000;21603100;suction;0,7;0,25;0,9876;ok;
2;21620871;21621200;soft;0,3;0,89;;operator;E7
"""
"""One row a stage, all of one clock, with outcomes beside what was seen."""


def test_what_is_known_only_after_an_action_is_guessed_as_no_covariate(read_table, draft):
    made = draft(SPANS, "# [covariates.Fehlertext]")
    assert 'values = {"0,9876"' not in made
    logs = read_table(SPANS, made)
    assert stages(logs, "Verdeckung", "probability") == [
        (1, 1, 3.1, "suction", 0.9876, 0.25, 0.7),
        (2, 1, None, "soft", None, 0.89, 0.3),
    ]
    assert ends(logs) == [(1, 3.1, "finished", None), (2, 0.329, "cut", "operator")]
    assert list(logs.stage_covariates) == ["Verdeckung"]


def test_dates_with_an_offset_are_guessed_as_times(draft):
    draft(GERMAN.replace("2025-10-26T", "26.10.2025 ").replace("58,5", "58"), 'format = "%d.%m.%Y %H:%M:%S%z"  # guess')
