"""Logs of version 1, in which a trajectory was a path."""

import json
import re
import zlib

import pandas as pd
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from halfseen.cli import halfseen
from halfseen.errors import LogError
from halfseen.logs import LogRecorder, Logs, read_logs
from halfseen.logs.formats import is_older, read_older, write_csv
from refusals import refused
from small_logs import flat_log, table_log


def former(text):
    """Words of today as version 1 had them."""
    return text.replace("trajectories", "paths").replace("trajectory", "path").replace('"version": 2', '"version": 1')


def parquet_of_version_1(log, folder):
    log.write(folder)
    for file in folder.glob("*.parquet"):
        table = pq.read_table(file)
        file.unlink()
        pq.write_table(table.rename_columns([former(name) for name in table.column_names]), folder / former(file.name))
    (folder / "logs.json").write_text(former((folder / "logs.json").read_text()))


def csv_of_version_1(log, folder):
    write_csv(log, folder)
    for file in list(folder.iterdir()):
        text = former(file.read_text())
        file.unlink()
        (folder / former(file.name)).write_text(text)


def journal_of_version_1(log, folder):
    with LogRecorder(folder) as recorder:
        for name in range(2):
            trajectory = recorder.begin_trajectory(shift="night")
            trajectory.begin_stage({"x": 0.5 + name}, action="A", probability=0.5)
            trajectory.complete_stage(reward=1.0, elapsed_s=1.5)
            trajectory.finish(elapsed_s=2.0) if name else trajectory.cut("battery", elapsed_s=2.0)
    file, checksum, lines = folder / "journal.jsonl", 0, []
    for line in file.read_text().splitlines():
        event = json.loads(line)[1]
        body = former(json.dumps(event, separators=(",", ":"))).replace('"version":2', '"version":1').encode()
        checksum = zlib.crc32(body, checksum)
        lines.append(b'["%08x",%b]\n' % (checksum, body))
    file.write_bytes(b"".join(lines))


WRITERS = {"parquet": parquet_of_version_1, "csv": csv_of_version_1}


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize("log", [flat_log(), table_log()], ids=["flat", "tables"])
def test_what_version_1_wrote_is_read_as_it_was(tmp_path, form, log):
    WRITERS[form](log, tmp_path / "logs")
    assert is_older(tmp_path / "logs")
    again = read_older(tmp_path / "logs")
    assert again.tables.keys() == log.tables.keys()
    for name, table in log.tables.items():
        pd.testing.assert_frame_equal(again.tables[name], table, check_dtype=False)


def test_a_journal_of_version_1_is_read_and_its_holes_stay_holes(tmp_path):
    journal_of_version_1(None, tmp_path / "logs")
    whole = read_older(tmp_path / "logs")
    assert whole.trajectories[["shift", "cause"]].to_numpy().tolist() == [["night", "battery"], ["night", None]]
    assert whole.stages["x"].tolist() == [0.5, 1.5]
    journal = tmp_path / "logs" / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(b"\0" * len(line) if b"battery" in line else line for line in lines))
    with pytest.warns(UserWarning, match=r"2 of 7 lines fail their checksum"):
        assert read_older(tmp_path / "logs").trajectories["cause"].tolist() == ["crash"]


@pytest.mark.parametrize("form", [*WRITERS, "journal"])
def test_version_1_is_refused_with_the_command_that_converts_it(tmp_path, form):
    folder = tmp_path / "logs"
    {**WRITERS, "journal": journal_of_version_1}[form](flat_log(), folder)
    with pytest.raises(LogError) as caught:
        read_logs(folder)
    command = re.search(r"convert it: halfseen (convert \S+ --out )NEW$", str(caught.value))[1]
    result = CliRunner().invoke(halfseen, [*command.split(), str(tmp_path / "new")], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert not is_older(tmp_path / "new")
    assert read_logs(tmp_path / "new").num_trajectories in (2, 40)


BROKEN = {
    "logs.json": [b"[", b"[]", b'{"format": "halfseen-logs", "rows": 7}'],
    "paths.parquet": [b"", b"PAR1", b"no table at all"],
    "stages.parquet": [b"x" * 99],
}


@pytest.mark.parametrize(("name", "content"), [(name, one) for name, all_of in BROKEN.items() for one in all_of])
def test_what_is_broken_is_refused_with_its_folder(tmp_path, name, content):
    parquet_of_version_1(flat_log(), tmp_path / "logs")
    (tmp_path / "logs" / name).write_bytes(content)
    with refused(f"^{tmp_path / 'logs'}.*", LogError):
        read_older(tmp_path / "logs")
    command = ["convert", str(tmp_path / "logs"), "--out", str(tmp_path / "new")]
    assert isinstance(CliRunner().invoke(halfseen, command).exception, LogError)
    assert not (tmp_path / "new").exists()


def test_a_table_without_rows_and_a_covariate_called_paths_keep_their_columns(tmp_path):
    log = flat_log()
    parquet_of_version_1(Logs(log.stages.assign(width=1.0), log.trajectories), tmp_path / "logs")
    file = tmp_path / "logs" / "stages.parquet"
    table = pq.read_table(file)
    pq.write_table(table.rename_columns([{"width": "paths"}.get(name, name) for name in table.column_names]), file)
    assert "paths" in read_older(tmp_path / "logs").stages
    pq.write_table(table.slice(0, 0), file)
    with refused(f"^{tmp_path / 'logs'}.*it has 0 rows where", LogError):
        read_older(tmp_path / "logs")


def test_a_journal_that_is_too_large_to_be_read_is_refused_in_one_line(tmp_path):
    """It is not yet known to be of version 1."""
    with (tmp_path / "journal.jsonl").open("wb") as file:
        file.truncate(65_000_000_000)
    with refused("journal.jsonl: it cannot be read .it has 65,000 MB", LogError):
        is_older(tmp_path)
