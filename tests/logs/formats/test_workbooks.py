"""Sheets of workbooks: XlsxWriter 3.2 wrote the file as Excel does; what comes out was worked out by hand."""

import re
import warnings
import zipfile
from pathlib import Path

import openpyxl
import pytest
from openpyxl.utils.datetime import MAC_EPOCH, WINDOWS_EPOCH

from event_files import TRIAL, ends, stages
from halfseen.errors import HalfseenWarning
from halfseen.logs.formats import mapping_of, read_event_table
from halfseen.logs.formats.table_cells import read_cells
from halfseen.logs.formats.table_mapping import TextLayout
from halfseen.logs.formats.workbooks import rows_of_sheet
from refusals import refused

BOOK = Path(__file__).with_name("trial.xlsx")
"""A sheet of three patients beside one of notes, and one of events below two other lines."""
OF_TRIAL = TRIAL.replace('covariates.age = {field = "age"}\n', "").replace('"reason"', '"lost"')
EVENTS = """
topic = "what"
table = {sheet = "Events", heading = 3}
clock = {field = "t", zone = "UTC"}
trajectory = {field = "run"}
action = {topic = "act", field = "text"}
reward = {topic = "res", field = "val"}
ending = {topic = "end", field = "text", finished = ["done"]}
covariates.w = {topic = "see", field = "val"}
"""
DAY_S = 86400.0


def read(folder, mapping, file=BOOK):
    (folder / "cell.toml").write_text(mapping)
    return read_event_table(file, folder / "cell.toml")


def changed(folder, part, old, new):
    """The workbook with another text in one of its parts."""
    with zipfile.ZipFile(BOOK) as book, zipfile.ZipFile(folder / "other.xlsx", "w", zipfile.ZIP_DEFLATED) as other:
        assert part in book.namelist()
        for name in book.namelist():
            content = book.read(name)
            if name == part:
                assert old in content
                content = content.replace(old, new)
            other.writestr(name, content)
    return folder / "other.xlsx"


def test_cells_are_text_as_they_are_shown():
    cells = read_cells(BOOK, TextLayout(sheet="Runs")).columns
    assert {name: cells[name][0] for name in ("when", "tod", "date", "dur", "ok", "big", "pct", "formula", "held")} == {
        "when": "2025-10-26T02:59:50.500",
        "tod": "01:02:03",
        "date": "2025-01-02",
        "dur": "1.25",
        "ok": "true",
        "big": "1.234567890123457e+18",
        "pct": "0.25",
        "formula": "2",
        "held": "3",
    }
    assert (cells["sofa.1"], cells["ok"]) == (["3", "4", "4.1"], ["true", "false", "true"])


@pytest.mark.parametrize("epoch", [WINDOWS_EPOCH, MAC_EPOCH])
def test_durations_of_days_in_a_format_of_times_are_durations(tmp_path, epoch):
    book = openpyxl.Workbook()
    book.epoch = epoch
    for cell in ("took", 90 / DAY_S, 1.0, 25.5 / 24):
        book.active.append([cell])
    for row in book.active["A2:A4"]:
        row[0].number_format = "h:mm:ss"
    book.save(tmp_path / "t.xlsx")
    found = read_cells(tmp_path / "t.xlsx", TextLayout(separator=None)).columns["took"]
    assert found == ["00:01:30", "1 days 00:00:00", "1 days 01:30:00"]


def test_a_heading_of_every_page_is_refused(tmp_path):
    book = openpyxl.Workbook()
    for row in (["took", "tool"], [1, "a"], ["took", "tool"], [2, "b"]):
        book.active.append(row)
    book.save(tmp_path / "t.xlsx")
    with refused(r"t\.xlsx, row 3: the heading stands here, too, as where another table was put below; delete it"):
        read_cells(tmp_path / "t.xlsx", TextLayout())


def test_a_trial_and_events_of_a_workbook_are_logs(tmp_path):
    with pytest.warns(HalfseenWarning, match="of its sheets 'Runs', 'Events', 'Notes', the first is read"):
        logs = read(tmp_path, OF_TRIAL)
    assert stages(logs, "sofa") == [
        ("p1", 1, 7 * DAY_S, "low", 0.0, 3.0),
        ("p1", 2, 14 * DAY_S, "high", 1.5, 5.0),
        ("p2", 1, 7 * DAY_S, "high", 2.0, 4.0),
        ("p3", 1, 7 * DAY_S, "low", 0.0, 4.1),
        ("p3", 2, None, "low", None, 6.0),
    ]
    assert [row[2:] for row in ends(logs)] == [("finished", None), ("finished", None), ("cut", "moved")]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        events = read(tmp_path, EVENTS)
    assert stages(events, "w") == [("r1", 1, 2.25, "x", 1.1, 5.0)]
    assert ends(events) == [("r1", 3.0, "finished", None)]


def test_a_mapping_is_made_of_a_sheet_below_other_lines(tmp_path):
    """The sheet of events becomes the first."""
    with pytest.warns(HalfseenWarning):
        assert 'wide = "{name}.{stage}"' in mapping_of(BOOK)
    file = changed(tmp_path, "xl/_rels/workbook.xml.rels", b"sheet1.xml", b"sheet2.xml")
    with pytest.warns(HalfseenWarning):
        made = mapping_of(file).splitlines()
    assert made[made.index("[table]") + 1] == "heading = 3  # guess: the line that names the columns"


def test_days_since_1904_are_dates_four_years_later(tmp_path):
    file = changed(tmp_path, "xl/workbook.xml", b"<workbookPr ", b'<workbookPr date1904="1" ')
    assert read_cells(file, TextLayout(sheet="Runs")).columns["date"][0] == "2029-01-03"


def test_what_is_no_sheet_is_refused(tmp_path):
    with refused(r"trial\.xlsx, table\.sheet: there is no sheet 'Run'; there are 'Runs', 'Events', 'Notes'"):
        read(tmp_path, OF_TRIAL + 'table.sheet = "Run"')
    with refused(r"row 3: it has 5 cells, and the heading has 1; fix or delete it, or set table\."):
        read(tmp_path, EVENTS.replace(", heading = 3", ""))
    (tmp_path / "broken.xlsx").write_bytes(BOOK.read_bytes()[:3000])
    for file in (tmp_path / "broken.xlsx", changed(tmp_path, "xl/worksheets/sheet1.xml", b"</row>", b"</roe>")):
        with refused(r"\.xlsx: it is not a complete table \("):
            read(tmp_path, OF_TRIAL + 'table.sheet = "Runs"', file)


def test_texts_are_without_how_they_are_spoken_and_rows_and_cells_may_lack_their_place(tmp_path):
    shared = b'<si><r><t>p</t></r><r><t>1</t></r><rPh sb="0" eb="1"><t>spoken</t></rPh></si>'
    file = changed(tmp_path, "xl/sharedStrings.xml", b"<si><t>p1</t></si>", shared)
    assert rows_of_sheet(file, "Runs")[2][0] == "p1"
    bare = changed(tmp_path, "xl/worksheets/sheet3.xml", b'r="A1"', b"")
    assert rows_of_sheet(bare, "Notes") == rows_of_sheet(BOOK, "Notes")


def test_cells_far_apart_and_entities_without_end_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("halfseen.logs.formats.workbooks.MOST_CELLS", 200)
    with refused(r"\.xlsx: it is not a complete table \(a sheet of more than 200 cells; export it as CSV\)"):
        read(
            tmp_path,
            OF_TRIAL + 'table.sheet = "Runs"',
            changed(tmp_path, "xl/worksheets/sheet1.xml", b'"R2"', b'"ZZ2"'),
        )
    nested = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 100}">' for k in range(1, 6))
    bomb = f'<!DOCTYPE b [<!ENTITY e0 "boom">{nested}]><sst><si><t>&e5;</t></si></sst>'.encode()
    with zipfile.ZipFile(BOOK) as book:
        texts = book.read("xl/sharedStrings.xml")
    # expat's words, or those of lxml where it is installed.
    with refused(r"it is not a complete table \(.*(amplification|could not read strings)"):
        read(tmp_path, OF_TRIAL + 'table.sheet = "Runs"', changed(tmp_path, "xl/sharedStrings.xml", texts, bomb))


def test_formulas_that_nobody_computed_are_warned_of(tmp_path):
    """openpyxl and pandas write formulas alone; Excel writes an empty text as their value."""
    book = openpyxl.Workbook()
    for row in (["run", "stop"], ["a", '=IF(1,"ok","")'], ["b", "=B2"]):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    with pytest.warns(HalfseenWarning, match="formulas without a value count as empty, that of B2 first of 2; open"):
        assert rows_of_sheet(tmp_path / "a.xlsx", None)[2] == ["a", ""]

    def rewritten(pattern, by):
        part = "xl/worksheets/sheet1.xml"
        with zipfile.ZipFile(tmp_path / "a.xlsx") as old, zipfile.ZipFile(tmp_path / "b.xlsx", "w") as new:
            for name in old.namelist():
                content = old.read(name)
                new.writestr(name, re.sub(pattern, by, content) if name == part else content)
        return rows_of_sheet(tmp_path / "b.xlsx", None)[2]

    # As other programs write XML.
    prefix, changed_names = rb' xmlns="|<(/?)(?=[a-z])', lambda at: b' xmlns:x="' if at[1] is None else b"<%sx:" % at[1]
    for pattern, by in ((prefix, changed_names), (rb'<c r="', rb'<c s="0" r="')):
        with pytest.warns(HalfseenWarning, match="that of B2 first of 2; open"):
            assert rewritten(pattern, by) == ["a", ""]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert rewritten(rb'(<c r="B[23]")', rb'\1 t="str"') == ["a", ""]
