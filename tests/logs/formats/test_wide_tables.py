"""Tables of one row a trajectory, packed tables and JSON lines: what comes out was worked out by hand from the rows."""

import gzip
import json

import pytest

from event_files import GERMAN as EVENTS
from event_files import HISTORIAN, PATIENTS, STAGES, TRIAL, WIDE, ends, stages
from halfseen.errors import HalfseenWarning
from halfseen.logs.formats import mapping_of
from halfseen.reading import LARGEST_MB
from refusals import refused

DAY_S = 86400.0
OF_PATIENTS = [
    ("p1", 1, 7 * DAY_S, "low", 0.0, 50.0, 3.0),
    ("p1", 2, 14 * DAY_S, "high", 1.5, 50.0, 5.0),
    ("p2", 1, 7 * DAY_S, "high", 2.0, 61.0, 4.0),
    ("p3", 1, 7 * DAY_S, "low", 0.0, 47.0, 4.0),
    ("p3", 2, None, "low", None, 47.0, 6.0),
    ("p4", 1, None, "low", None, 47.0, 3.5),
]
ENDS = [
    ("p1", 14 * DAY_S, "finished", None),
    ("p2", 7 * DAY_S, "finished", None),
    ("p3", 10 * DAY_S, "cut", "moved"),
    ("p4", 3 * DAY_S, "cut", "withdrew"),
]
SEEN = PATIENTS.replace('"low",NA', '"low",3.5')


def test_a_trial_of_one_row_a_patient(read_table, draft):
    logs = read_table(SEEN, TRIAL)
    assert (stages(logs, "age", "sofa"), ends(logs)) == (OF_PATIENTS, ENDS)
    made = draft(SEEN, "wide = \"{name}.{stage}\"  # guess: 'dose', 'sofa', 'day' are by stage")
    again = read_table(SEEN, made)
    assert (stages(again, "age", "sofa"), ends(again)) == (OF_PATIENTS, ENDS)


def test_the_guess_of_names_prefers_those_of_patients_to_numbers_of_rows(draft):
    heading, *rows = SEEN.replace('"age"', '"site"').replace('"id"', '"patient"').splitlines()
    lines = [f'"",{heading}', *(f"{k},{row}".replace(",50,", f",s{k},") for k, row in enumerate(rows))]
    made = draft("\n".join(lines)).splitlines()
    assert made[made.index("[trajectory]") + 1].startswith('field = "patient"  # guess')


def by_name(pattern):
    """The trial with other names of its columns by stage."""
    heading, *rows = SEEN.splitlines(keepends=True)
    for stage in "12":
        for name in ("dose", "sofa", "day"):
            heading = heading.replace(f"{name}.{stage}", pattern.format(name=name, stage=stage))
    return heading + "".join(rows)


@pytest.mark.parametrize(
    "pattern",
    ["{name}_{stage}", "{name}{stage}", "{name} {stage}", "{name}_t{stage}", "{stage}_{name}", "V{stage}.{name}"],
)
def test_columns_by_stage_have_any_pattern(read_table, draft, pattern):
    logs = read_table(by_name(pattern), TRIAL.replace("{name}.{stage}", pattern))
    assert (stages(logs, "age", "sofa"), ends(logs)) == (OF_PATIENTS, ENDS)
    assert f'wide = "{pattern}"  # guess' in draft(by_name(pattern))


@pytest.mark.parametrize("unit", [" [d]", " (d)", "[d]"])
def test_a_unit_may_follow_the_stage(read_table, draft, unit):
    heading, rows = SEEN.split("\n", 1)
    for stage in "12":
        heading = heading.replace(f"day.{stage}", f"day.{stage}{unit}")
    text = f"{heading}\n{rows}"
    logs = read_table(text, TRIAL.replace('"day"', f'"day{unit}"'))
    assert (stages(logs, "age", "sofa"), ends(logs)) == (OF_PATIENTS, ENDS)
    assert 'wide = "{name}.{stage}"  # guess' in draft(text)


def test_times_rewards_and_endings_by_stage_and_names_by_row(read_table):
    text = "A1;X1;Y1;lost1;A2;X2;Y2;lost2\n1;0,5;1;0;-1;1,5;2,5;0\n-1;0,75;0;0;1;2;;1\n1;0,25;;1;;;;\n"
    mapping = """
wide = "{name}{stage}"
clock = {field = "stage", unit = "s", since = "trajectory"}
action = {field = "A"}
reward = {field = "Y"}
ending = {finished = "rewarded"}
covariates.X = {field = "X"}
"""
    logs = read_table(text, mapping)
    assert stages(logs, "X") == [
        (1, 1, 1.0, 1, 1.0, 0.5),
        (1, 2, 2.0, -1, 2.5, 1.5),
        (2, 1, 1.0, -1, 0.0, 0.75),
        (2, 2, None, 1, None, 2.0),
        (3, 1, None, 1, None, 0.25),
    ]
    assert ends(logs) == [(1, 2.0, "finished", None), (2, 2.0, "cut", "log ended"), (3, 1.0, "cut", "log ended")]
    flags = mapping.replace('finished = "rewarded"', 'finished = {field = "over"}, cut = {field = "lost"}')
    over = text.replace("lost2\n", "lost2;over\n").replace("2,5;0\n", "2,5;0;1\n").replace(";1\n", ";1;0\n")
    flagged = read_table(over.replace("2,5;0;1;0\n", "2,5;0;1\n").replace(";;;;\n", ";;;;;0\n"), flags)
    assert stages(flagged, "X") == stages(logs, "X")
    assert [row[2:] for row in ends(flagged)] == [("finished", None), ("cut", "lost"), ("cut", "lost")]


def test_a_reward_of_the_row_is_earned_once_even_if_values_replace_0(read_table):
    text = PATIENTS.replace(",1.5,", ",0,").replace(",2,", ",1,").replace('"low",NA', '"low",3.5')
    logs = read_table(text, TRIAL.replace('"y"', '"y", values = {"0" = -1, "1" = 1}'))
    assert [row[4] for row in stages(logs)] == [0.0, -1.0, 1.0, 0.0, None, None]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"{name}.{stage}"', '"{name}."', r"cell\.toml, wide: '\{name\}\.' does not hold \{name\} and \{stage\}"),
        ('"{name}.{stage}"', '"{name}_{stage}"', r"action\.field: 'dose' has no columns of two stages"),
        ('field = "day"', 'field = "age"', r"clock\.field: column 'age' has one time a row; name a column by stage"),
        ('field = "sofa"', 'field = "sofa.1"', r"covariates\.sofa\.field: there is no column 'sofa\.1'"),
        ('wide = "{name}.{stage}"', 'wide = "{name}.{stage}"\ntopic = "dose"', r"wide: it is for one row a trajectory"),
    ],
)  # fmt: skip
def test_a_mapping_that_does_not_fit_a_wide_table_is_refused(read_table, old, new, message):
    assert old in TRIAL
    with refused(message):
        read_table(SEEN, TRIAL.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"p2"', '"p1"', r"line 3, column 'id': 'p1' is also in .*line 2, but each row is a trajectory"),
        ('"low",3,7', "NA,3,7", r"line 2, column 'dose\.1': '' is no action, but 'dose\.2' or others"),
        ("5,14", "5,6", r"line 2, stage 2, column 'day': '6' is before that of the stage before; fix it, or set since"),
        ("5,14", "5,NA", r"line 2, stage 2, column 'day': '' is not a number"),
        ("sofa.1", "sofa.2", r"there are two columns 'sofa\.2'"),
        ("sofa.1", "sofa.01", None),
        ('"age"', '"sofa"', r"wide: column 'sofa' stands beside 'sofa\.1'; rename it"),
        ('"age"', '"sofa.02"', r"columns 'sofa\.0?2' and 'sofa\.0?2' are of one stage"),
        ('"age"', '"sofa.0"', r"'sofa\.0' is of a stage before 'dose\.1', the first action"),
        ('"dose.2"', '"dose.3"', r"'dose' has the stages \[1, 3\], not all between"),
    ],
)  # fmt: skip
def test_a_wide_table_that_makes_no_stages_is_refused(read_table, old, new, message):
    assert old in SEEN
    mapping = TRIAL.replace('covariates.age = {field = "age"}\n', "")
    if message is None:
        assert len(read_table(SEEN.replace(old, new, 1), mapping).stages) == 6
        return
    with refused(message):
        read_table(SEEN.replace(old, new, 1), mapping)


def test_what_comes_after_the_last_action_and_rows_without_a_stage_are_reported(read_table):
    with pytest.warns(HalfseenWarning, match=r"column 'sofa\.3' comes after the last action; it is not read"):
        read_table(SEEN.replace('"age"', '"sofa.3"'), TRIAL.replace('covariates.age = {field = "age"}\n', ""))
    nobody = SEEN + '"p5",40,NA,NA,NA,NA,NA,NA,NA,"withdrew"\n'
    with pytest.warns(HalfseenWarning, match=r"line 6: no stage of it has a value; such rows are left out: 1"):
        assert ends(read_table(nobody, TRIAL)) == ENDS


def test_an_ending_by_reward_is_of_rows_of_stages(read_table):
    of_stages = STAGES.replace('field = "stop", finished = [""]', 'finished = "rewarded"')
    assert [row[2:] for row in ends(read_table(WIDE, of_stages))] == [("finished", None), ("cut", "log ended")]
    wrong = HISTORIAN.replace('topic = "Ende", field = "Text", finished = ["fertig"]', 'finished = "rewarded"')
    with refused(r"ending\.finished: only rows of stages tell it"):
        read_table(EVENTS, wrong)


def test_packed_tables_and_json_lines_are_the_same_rows(read_table, tmp_path, monkeypatch):
    expected = stages(read_table(EVENTS, HISTORIAN), "weight")
    packed = gzip.compress(EVENTS.encode("cp1252"))
    assert stages(read_table(packed, HISTORIAN, name="events.csv.gz"), "weight") == expected
    heading, *rows = (line.split(";") for line in EVENTS.splitlines())
    numbers = [
        {**dict(zip(heading, row, strict=True)), "Wert": float(row[4].replace(",", ".") or "nan")} for row in rows
    ]
    of_rows = [{name: cell for name, cell in row.items() if cell == cell and cell != ""} for row in numbers]
    lines = "".join(f"{json.dumps(row, ensure_ascii=False)}\n" for row in of_rows)
    assert stages(read_table(lines, HISTORIAN, name="events.jsonl"), "weight") == expected
    assert stages(read_table(gzip.compress(lines.encode()), HISTORIAN, name="e.jsonl.gz"), "weight") == expected
    assert 'topic = "Ereignis"' in mapping_of(tmp_path / "e.jsonl.gz")
    for text, message in (
        (lines + "[1]\n", r"line 14: it is not a JSON object; write one a line"),
        (lines + '{"a": 1', r"line 14: it is not JSON \("),
        (lines.replace('"Wert": 0.5', '"Wert": [0.5]'), r"column 'Wert' of .* holds lists or objects; convert it"),
    ):
        with refused(message):
            read_table(text, HISTORIAN, name="events.jsonl")
    with refused(r"it is not a complete table \("):
        read_table(packed[:-20], HISTORIAN, name="events.csv.gz")
    monkeypatch.setenv(LARGEST_MB, "1")
    (tmp_path / "large.csv").write_text("a;b\n" * 10**6)
    with refused(r"large\.csv: it is not a complete table \(it has 4 MB"):
        mapping_of(tmp_path / "large.csv")
    with refused(r"it is not a complete table \(unpacked, it has"):
        read_table(gzip.compress(b"a;b\n" * 10**6), HISTORIAN, name="events.csv.gz")
