"""Tables of events and of stages: what comes out was worked out by hand from the rows."""

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from event_files import (
    AMERICAN,
    BEGUN,
    GERMAN,
    GERMAN_ENDS,
    GERMAN_STAGES,
    HISTORIAN,
    PLC,
    STAGES,
    WIDE,
    ends,
    stages,
    write_events,
)
from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs.formats import read_event_mapping, read_event_table
from refusals import refused


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
def test_a_historians_events_across_the_change_of_clocks(read_table, encoding):
    logs = read_table(GERMAN, HISTORIAN, encoding)
    assert stages(logs, "weight") == GERMAN_STAGES
    assert ends(logs) == GERMAN_ENDS


def test_rows_may_stand_newest_first_or_mixed(read_table):
    heading, *rows = GERMAN.splitlines(keepends=True)
    assert stages(read_table(heading + "".join(rows[::-1]), HISTORIAN), "weight") == GERMAN_STAGES
    mixed = r"events\.csv, line \d+: the time is before that of the row above, as in \d rows; rows are sorted by time"
    with pytest.warns(HalfseenWarning, match=mixed):
        found = read_table(heading + "".join(rows[::2] + rows[1::2]), HISTORIAN)
    assert stages(found, "weight") == GERMAN_STAGES


def test_a_zone_gives_its_offset_to_times_that_have_none(read_table):
    text = "t;id;what;w\n{};1;a;\n{};1;r;2\n{};1;end;\n"
    mapping = """
topic = "what"
clock = {field = "t", zone = "Europe/Berlin", format = "%d.%m.%Y %H:%M:%S,%f"}
trajectory = {field = "id"}
action = {topic = "a"}
reward = {topic = "r", field = "w"}
ending = {topic = "end", finished = ["end"]}
"""
    night = [f"26.10.2025 {time}" for time in ("01:59:59,5", "03:00:00,0", "03:00:01,25")]
    logs = read_table(text.format(*night), mapping)
    assert stages(logs) == [(1, 1, 3600.5 + 3600.0, "a", 2.0)]
    assert ends(logs) == [(1, 7201.75, "finished", None)]
    twice = [night[0], "26.10.2025 02:30:00,0", night[2]]
    with refused(r"events\.csv, line 3, column 't': '26.10.2025 02:30:00,0' occurred twice or never in Europe/Berlin"):
        read_table(text.format(*twice), mapping)
    with pytest.warns(HalfseenWarning, match=r"column 't': times have no zone.*set clock.zone"):
        naive = read_table(text.format(*night), mapping.replace('zone = "Europe/Berlin", ', ""))
    assert stages(naive)[0][2] == 3600.5


@pytest.mark.parametrize(("separator", "name"), [(",", "wide.csv"), ("\t", "wide.tsv"), ("|", "wide.txt")])
def test_a_wide_table_of_stages_in_milliseconds(read_table, separator, name):
    logs = read_table(WIDE.replace(",", separator), STAGES, name=name)
    assert stages(logs, "left") == [
        ("a", 1, 1.5, "suction", 2.5, 9.5),
        ("a", 2, 4.0, "soft", -1.0, 8.0),
        ("b", 1, 2.0, "soft", 1.0, 9.5),
        ("b", 2, None, "suction", None, 6.25),
    ]
    assert ends(logs) == [("a", 4.0, "finished", None), ("b", 2.5, "cut", "operator")]


@pytest.mark.parametrize(("unit", "factor"), [("s", 1), ("ms", 1000), ("us", 10**6), ("ns", 10**9), ("min", 1 / 60)])
def test_times_count_in_any_unit_and_since_the_stage_too(read_table, unit, factor):
    rows = [("a", "x", 60 * factor, 1.0), ("a", "y", 150 * factor, 2.0)]
    text = "run,tool,took,worth\n" + "".join(f"{','.join(map(str, row))}\n" for row in rows)
    mapping = STAGES[: STAGES.index("ending")] + 'ending = {field = "over", finished = ["yes"]}'
    mapping = mapping.replace('"ms", unit = "ms", since = "trajectory"', f'"took", unit = "{unit}", since = "stage"')
    logs = read_table(
        text.replace("worth\n", "worth,over\n").replace("1.0\n", "1.0,\n").replace("2.0\n", "2.0,yes\n"), mapping
    )
    assert stages(logs) == [("a", 1, 60.0, "x", 1.0), ("a", 2, 210.0, "y", 2.0)]
    assert ends(logs) == [("a", 210.0, "finished", None)]


def test_a_stage_may_have_columns_of_its_beginning_and_its_end(read_table):
    text = "from,to,tool,worth,over\n2025-01-01T00:00:10Z,2025-01-01T00:00:12Z,x,1,\n"
    text += "2025-01-01T00:00:15Z,2025-01-01T00:00:19.5Z,y,2,yes\n"
    mapping = """
clock = {field = "to", begin = "from"}
action = {field = "tool"}
reward = {field = "worth"}
ending = {field = "over", finished = ["yes"]}
"""
    logs = read_table(text, mapping)
    assert stages(logs) == [(1, 1, 2.0, "x", 1.0), (1, 2, 9.5, "y", 2.0)]
    with refused(r"line 2, column 'to': '2025-01-01T00:00:02Z' is before its beginning"):
        read_table(text.replace("00:00:12Z", "00:00:02Z"), mapping)


OBSERVED = """
clock = {field = "t", unit = "s"}
trajectory = {field = "run"}
action = {field = "tool"}
reward = {field = "worth", row = "next"}
ending = {field = "over", finished = ["done"]}
covariates.x = {field = "x"}
"""
STAGES_OBSERVED = OBSERVED.replace(', row = "next"', "").replace('unit = "s"', 'unit = "s", since = "trajectory"')


def test_a_reward_may_stand_in_the_row_after_its_action(read_table):
    rows = ["1,0,.1,left,0,", "1,1,.2,right,1.5,", "1,2.5,.3,right,2.5,done", "2,7,.4,left,0,", "2,9,.5,right,-1,stop"]
    logs = read_table("run,t,x,tool,worth,over\n" + "\n".join(rows) + "\n", OBSERVED)
    assert logs.stages["action"].tolist() == ["left", "right", "left", "right"]
    assert logs.stages["reward"].tolist()[:3] == [1.5, 2.5, -1.0]
    assert logs.stages["elapsed_s"].tolist()[:3] == [1.0, 2.5, 2.0]
    assert logs.stages["x"].tolist() == [0.1, 0.2, 0.4, 0.5]
    assert ends(logs) == [(1, 2.5, "finished", None), (2, 2.0, "cut", "stop")]
    with refused(r'line 4: .* with no action before it; record every action, or set reward\.row = "next" if'):
        read_table("run,t,x,tool,worth,over\n1,1,.1,a,0,\n1,2,.2,b,1,\n1,3,.3,,2,done\n", STAGES_OBSERVED)
    with refused(r'line 3: .* has no reward; record a reward after every action, or set reward\.row = "next" if'):
        read_table("run,t,x,tool,worth,over\n1,1,.1,a,,\n1,2,.2,b,1,done\n", STAGES_OBSERVED)
    with pytest.warns(HalfseenWarning, match=r"line 2: its reward is left out, as in 1 first rows .* reward\.row"):
        read_table("run,t,x,tool,worth,over\n" + "\n".join(rows).replace("left,0", "left,4", 1) + "\n", OBSERVED)


def test_empty_cells_may_repeat_the_cell_above(read_table):
    merged = WIDE.replace("a,soft", ",soft").replace("b,suction", ",suction")
    with refused(r"column 'run': '' is not a valid trajectory; .* fill_down = \[\"run\"\] in \[table\]"):
        read_table(merged, STAGES)
    filled = STAGES + 'table.fill_down = ["run"]'
    assert read_table(merged, filled).trajectories.equals(read_table(WIDE, STAGES).trajectories)
    with refused("line 2, column 'run': '' has no cell above it to repeat"):
        read_table(merged.replace("a,suction", ",suction"), filled)


def test_a_plcs_log_with_begin_and_end_events(read_table):
    logs = read_table(PLC, BEGUN)
    assert stages(logs, "clutter") == [
        (1, 1, 3.5, "soft", 1.0, 0.25),
        (2, 1, 3.0, "hard", -0.5, 0.5),
        (2, 2, None, "soft", None, 0.75),
    ]
    assert ends(logs) == [(1, 4.0, "finished", None), (2, 4.0, "cut", "log ended")]
    with pytest.warns(HalfseenWarning, match="1 values come before the first beginning"):
        read_table(PLC.replace("MODE;3", "LOOK;0.5"), BEGUN)


def test_an_ending_that_never_comes_is_warned_of(read_table):
    with pytest.warns(HalfseenWarning, match=r"ending.topic: no event of .* is 'END'.*cut by 'log ended'"):
        logs = read_table(PLC.replace("105;END;done\n", ""), BEGUN)
    assert [row[2:] for row in ends(logs)] == [("cut", "log ended")] * 2


def test_parquet_and_arrow_tables_are_the_same_rows(tmp_path, read_table):
    table = write_events(tmp_path)
    (tmp_path / "cell.toml").write_text(HISTORIAN)
    for source in (tmp_path / "events.parquet", table):
        logs = read_event_table(source, tmp_path / "cell.toml")
        assert stages(logs, "weight") == GERMAN_STAGES
        assert ends(logs) == GERMAN_ENDS
    with refused(r"events\.parquet, row 2, column 'Text': '' is not a valid action"):
        empty = table.set_column(3, "Text", pa.array([None] * len(table), pa.string()))
        pq.write_table(empty, tmp_path / "events.parquet")
        read_event_table(tmp_path / "events.parquet", tmp_path / "cell.toml")


def american(date):
    return f"time,run,tool,worth,over\n{date} 10:00:00,1,a,1,\n03/05/2025 10:00:10,1,b,2,yes\n"


def test_the_order_of_day_and_month_is_never_guessed(read_table):
    ways = r"set clock.format, such as \"%d/%m/%Y %H:%M:%S\" or \"%m/%d/%Y %H:%M:%S\""
    with refused(rf"events\.csv, line 2, column 'time': '03/04/2025 10:00:00' is not an ISO time.*{ways}"):
        read_table(american("03/04/2025"), AMERICAN.replace("FORMAT", ""))
    days = {}
    for way in ("%m/%d/%Y", "%d/%m/%Y"):
        mapping = AMERICAN.replace("FORMAT", f', format = "{way} %H:%M:%S"').replace(
            'begin = "time"', 'begin = "began"'
        )
        text = (
            american("03/04/2025")
            .replace("time,", "time,began,")
            .replace("00,1,", "00,03/04/2025 09:59:50,1,")
            .replace("10,1,", "10,03/04/2025 09:59:50,1,")
        )
        days[way] = stages(read_table(text, mapping))[1][2]
    # From 4 to 5 March a day; from 3 April to 3 May thirty days, without a change of clocks in either.
    assert days == {"%m/%d/%Y": 86400.0 + 20.0, "%d/%m/%Y": 30 * 86400.0 + 20.0}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("1,25", "1.25", r"column 'Wert': '1\.25' has a point, but .*line 2, column 'Wert'"),
        ("1,25", "viel", r"line 4, column 'Wert': 'viel' is not a number with decimal mark ','; fix it, or set values"),
        ("1,25", "NaN", r"line 4, column 'Wert': 'NaN' is not a number"),
        ("1,25", "", r"line 4, column 'Wert': '' is not a number"),
        ("1,25", "1e999", r"line 4, column 'Wert': '1e999' is not a number"),
        ("26T02:00:01", "36T02:00:01", r"line 4, column 'Zeit': '2025-10-36.*' is not a time in format ISO8601"),
        ("2025-10-26T02:00:01+01:00", "", r"line 4, column 'Zeit': '' is not a time; every row needs one"),
        ("02:00:01+01:00", "02:00:01", r"line 4, column 'Zeit': '.*' has no zone, but others have"),
        ("7;Ablage;;1,25", ";Ablage;;1,25", r"line 4, column 'Lauf': '' is not a valid trajectory; give one"),
        ("Ablage;;1,25", "Ablage;;1,25;5", r"line 4: it has 6 cells between ';', and the heading has 5"),
        ("7;Griff;Kiste;", "7;Ablage;;1,0", r"line 6: trajectory 7, stage 2: reward 1.0 comes .* with no action"),
        ("7;Ablage;;1,25", "7;Griff;Kiste;", r"line 4: trajectory 7, stage 1: action 'Kiste' comes .* has no reward"),
        ("Säule;\n2025-10-26T02:00:01", '"Säule;\n2025-10-26T02:00:01', r"line 3: a quote opens .* is not closed"),
    ],
)  # fmt: skip
def test_a_bad_value_is_refused_with_its_line(read_table, old, new, message):
    assert old in GERMAN
    with refused(message, LogError):
        read_table(GERMAN.replace(old, new, 1), HISTORIAN)


def test_lines_are_counted_as_an_editor_does(read_table):
    text = WIDE.replace("a,soft", '\n"a",soft').replace("b,soft", 'b,"so\nft"').replace("6.25", "x")
    with refused(r"line 7, column 'seconds left': 'x' is not a number"):
        read_table(text, STAGES)
    assert stages(read_table("sep=,\n" + WIDE, STAGES)) == stages(read_table(WIDE, STAGES))
    with_notes = "exported by me\nat noon\n" + WIDE.replace("6.25", "x")
    with refused(r"line 7, column 'seconds left': 'x'"):
        read_table(with_notes, STAGES + "table = {heading = 3}")


def test_numbers_in_thousands_are_not_taken_for_fractions(read_table):
    text = (
        WIDE.replace(",", ";")
        .replace("9.5", "1.500")
        .replace("6.25", "2.250")
        .replace("2.5", "7")
        .replace(";8;", ";9;")
    )
    with refused(r"line 2, column 'seconds left': '1.500' may be a fraction or a number in thousands"):
        read_table(text, STAGES)
    logs = read_table(text, STAGES + 'table = {decimal = "."}')
    assert logs.stages["left"].tolist() == [1.5, 9.0, 1.5, 2.25]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"Griff"', '"Grif"', r"cell\.toml, action\.topic: no event of .* is 'Grif'; there are Ablage, Ende"),
        ('"Wert"', '"wert"', r"cell\.toml, reward\.field: there is no column 'wert' .*did you mean 'Wert'"),
        ('"Zeit"', '"Datum"', r"cell\.toml, clock\.field: there is no column 'Datum'"),
        ('"Zeit"', '"Lauf"', r"line 2, column 'Lauf': '7' is a number; set clock.unit"),
        ('"Zeit"}', '"Zeit", zone = "Berlin"}', None),
        ('"Zeit"}', '"Zeit", unit = "hr"}', r"cell\.toml, clock\.unit: invalid enum value 'hr'"),
        ('"Zeit"}', '"Zeit", unit = "s", format = "%d"}', r"clock\.format: dates have a format, and numbers a unit"),
        ('"Zeit"}', '"Zeit", since = "stage"}', r"cell\.toml, clock: begin, and since = 'stage'"),
        ('"Zeit"}', '"Zeit", since = "trajectory", begin = "Zeit"}', r"clock: since = 'trajectory' and begin = 'Zeit'"),
        ("{field = \"Zeit\"}", "{feld = \"Zeit\"}", r"cell\.toml, clock\.(field: it is missing|feld: it is unknown)"),
        ("action = ", "acton = ", r"cell\.toml, (action: it is missing; add it|acton: it is unknown)"),
        ("covariates.weight", "covariates.reward", r"covariates\.reward: stages have such a column already"),
        ('values = {"Säule" = "column"}', "values = 3", r"cell\.toml, action\.values: expected `object`, got `int`"),
        ('topic = "Ereignis"\n', "", r"cell\.toml, clock\.begin: it is missing"),
        ('topic = "Ereignis"', "topic = [", r"cell\.toml: it is not valid TOML"),
    ],
)  # fmt: skip
def test_a_mapping_that_does_not_fit_is_refused(read_table, old, new, message):
    assert old in HISTORIAN
    mapping = HISTORIAN.replace(old, new, 1)
    if message is None:  # the times have offsets, which count
        assert ends(read_table(GERMAN, mapping)) == GERMAN_ENDS
        return
    with refused(message):
        read_table(GERMAN, mapping)


def test_files_of_no_table_are_refused(read_table, tmp_path):
    with refused(r"book\.ods: such workbooks are not read; save it as \.xlsx, or the sheet as CSV UTF-8"):
        read_table("", HISTORIAN, name="book.ods")
    for text, message in (
        ("", r"there are no rows|none of the separators"),
        ("a;b\n", r"there are no rows below the heading"),
        ("a\n1\n", r"its heading has none of the separators"),
        ("a;a\n1;2\n", r"there are two columns 'a'"),
        ("a;;b\n1;2;3\n", r"column 2 has no name"),
        (
            b"a;b\n\0;1\n",
            r"line 2: it holds null characters; delete them if power was lost there; else set table.encoding",
        ),
        (b"a;b\n1;\x81\n", r"line 2: bytes b'\\x81' are not cp1252; set table.encoding"),
    ):
        with refused(message, LogError):
            read_table(text, HISTORIAN)
    with refused(r"none\.toml: it cannot be read", ArgumentError):
        read_event_mapping(tmp_path / "none.toml")


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16"])
def test_the_mapping_that_is_made_from_a_table_reads_it(read_table, draft, encoding):
    made = draft(
        GERMAN,
        "topic = \"Ereignis\"  # guess: such as 'Gewicht' and 'Griff'",
        'separator = ";"  # guess',
        'decimal = ","  # guess: decimal mark, "," or "."',
        f'encoding = "{encoding}"  # guess: utf-8, cp1252, utf-16, shift_jis, gbk, …',
        "field = \"Lauf\"  # guess: such as '7' and '8'",
        "field = \"Text\"  # guess: such as 'fertig' and 'Not-Halt'",
        encoding=encoding,
    )
    logs = read_table(GERMAN, made, encoding)
    assert [row[:3] for row in ends(logs)] == [row[:3] for row in GERMAN_ENDS]
    assert logs.trajectories["cause"].tolist()[1:] == ["Not-Halt", "log ended"]
    assert logs.stages["Gewicht"].tolist() == [0.5, 0.75, 1.0, 1.5]


def test_a_mapping_of_stages_and_of_a_plc_only_lacks_what_nobody_can_guess(read_table, draft):
    since = 'since = "trajectory"  # guess: numbers count from there, or from the "stage"'
    made = draft(WIDE, 'unit = "ms"  # guess: s, ms, us, ns, min, h or d', since)
    assert ends(read_table(WIDE, made)) == [("a", 4.0, "finished", None), ("b", 2.5, "cut", "operator")]
    made = draft(PLC, '# values = {"OK" = 1.0, "NOK" = 1.0}  # what each earns')
    made = made.replace('# values = {"OK" = 1.0, "NOK" = 1.0}', "values = {OK = 1, NOK = -0.5}")
    logs = read_table(PLC, made[: made.index("[covariates.MODE]")] + made[made.index("[covariates.LOOK]") :])
    assert ends(logs) == [(1, 4.0, "finished", None), (2, 4.0, "cut", "log ended")]
    assert logs.stages["reward"].tolist()[:2] == [1.0, -0.5]


def test_a_mapping_names_both_orders_of_day_and_month(draft):
    made = draft(american("03/04/2025")).splitlines()
    at = made.index("# The order of day and month cannot be guessed; choose one:")
    assert made[at + 1 : at + 3] == [
        '# format = "%d/%m/%Y %H:%M:%S"  # guess',
        '# format = "%m/%d/%Y %H:%M:%S"  # guess',
    ]
    draft(american("03/14/2025"), 'format = "%m/%d/%Y %H:%M:%S"  # guess')


def test_a_covariate_is_numbers_or_text_as_it_begins_or_as_it_is_said(read_table):
    def weights(cells, how=""):
        text = GERMAN
        for old, new in zip(("0,5", "0,75", "1,0", "1,5"), cells, strict=True):
            text = text.replace(f"Gewicht;;{old}\n", f"Gewicht;;{new}\n")
        return read_table(text, HISTORIAN.replace('field = "Wert"}\n', f'field = "Wert"{how}}}\n').replace(
            f'"Ablage", field = "Wert"{how}', '"Ablage", field = "Wert"'
        )).stages["weight"].tolist()  # fmt: skip

    assert weights(["leicht", "7", "8,5", "x"]) == ["leicht", "7", "8,5", "x"]
    assert weights(["007", "7", "8", "9"], ', type = "text"') == ["007", "7", "8", "9"]
    assert weights(["007", "7", "8", "9"]) == [7.0, 7.0, 8.0, 9.0]
    assert weights(["leicht", "7", "x", "x"], ", values = {leicht = 0.5, x = 2}") == [0.5, 7.0, 2.0, 2.0]
    assert weights(["1", "7", "x", "x"], ', values = {x = "much"}') == ["1", "7", "much", "much"]
    with refused(r"line 5, column 'Wert': 'x' is not a number with decimal mark ','"):
        weights(["1", "x", "7", "7"])
    with refused(
        r"line 2, column 'Wert': 'NULL' is not a number, but most of the column are; .* set missing = \[\"NULL\"\]"
    ):
        weights(["NULL", "1.234,5", "7", "7"])
    with refused(r"line 2, column 'Wert': '0,5 kg' is a number with a unit; export it without, or set type = \"text\""):
        weights(["0,5 kg", "1.234 kg", "7 kg", "7 kg"])
    for names in (["2 kg", "2 kg", "2 kg", "2 kg"], ["2 kg", "5 g", "2 kg", "5 g"], ["a1", "a2", "a3", "a4"]):
        assert weights(names) == names
    with refused(r"cell\.toml, covariates\.weight\.values: they are text; give numbers"):
        weights(["1", "x", "7", "7"], ', type = "number", values = {x = "much"}')


def test_one_clock_for_all_trajectories_is_warned_of(read_table):
    rows = [f"{run},{tool},{run * 10 + k},{run * 10 + k + 1},1,\n" for run in range(5) for k, tool in enumerate("xy")]
    text = "run,tool,started,ms,worth,stop\n" + "".join(rows)
    mapping = STAGES.replace('covariates.left = {field = "seconds left"}\n', "")
    with pytest.warns(
        HalfseenWarning, match=r"column 'ms': times continue from one trajectory .* by begin = \"started\", the"
    ):
        read_table(text, mapping)
    read_table(text, mapping.replace('since = "trajectory"', 'begin = "started"'))
