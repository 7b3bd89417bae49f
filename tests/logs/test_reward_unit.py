import json

import pytest

from halfseen.errors import LogError
from halfseen.evaluation.second_order import with_second_order
from halfseen.learning.named_task import NamedActions
from halfseen.logs import Logs, LogStream, read_logs, write_stream
from halfseen.logs.formats import read_csv, write_csv
from halfseen.logs.joining import joined
from small_logs import flat_log


@pytest.fixture
def logs():
    return flat_log(num_paths=8).in_unit("Körbe")


def renamed(logs, shift):
    return Logs(
        logs.stages.assign(path=logs.stages["path"] + shift),
        logs.paths.assign(path=logs.paths["path"] + shift),
        reward_unit=logs.reward_unit,
    )


def test_the_unit_goes_where_the_log_goes(logs, tmp_path):
    logs.write(tmp_path / "logs")
    write_csv(logs, tmp_path / "csv")
    write_stream([logs], tmp_path / "stream")
    task = NamedActions({1: ["A", "B"], 2: ["A", "C"]}, ["x1"])
    same = [
        read_logs(tmp_path / "logs"),
        read_csv(tmp_path / "csv"),
        read_logs(tmp_path / "csv"),
        read_logs(tmp_path / "stream"),
        *LogStream(tmp_path / "logs"),
        logs.select([0, 3]),
        joined([logs, renamed(logs, 8)]),
        with_second_order(task, logs)[1],
    ]
    assert {one.reward_unit for one in same} == {"Körbe"}
    assert json.loads((tmp_path / "logs" / "logs.json").read_text(encoding="utf-8"))["reward_unit"] == "Körbe"


def test_a_log_without_a_unit_is_what_it_was(tmp_path):
    logs = flat_log(num_paths=4)
    logs.write(tmp_path / "logs")
    assert set(json.loads((tmp_path / "logs" / "logs.json").read_text())) == {"format", "version", "rows"}
    assert read_logs(tmp_path / "logs").reward_unit is None
    assert logs.in_unit(" parts ").reward_unit == "parts"
    assert logs.in_unit(" parts ").in_unit(None).reward_unit is None
    assert logs.reward_unit is None


TEXTS = ["", "  ", "two\nlines", "x" * 25]


@pytest.mark.parametrize("unit", TEXTS)
def test_what_is_no_short_text_is_refused_in_one_line(unit):
    with pytest.raises(LogError, match=r"reward_unit is .*; give a text of one line") as told:
        flat_log(num_paths=4).in_unit(unit)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("unit", [*TEXTS, 3, ["parts"]])
def test_a_manifest_whose_unit_is_no_short_text_is_refused(unit, tmp_path):
    flat_log(num_paths=4).write(tmp_path / "logs")
    manifest = tmp_path / "logs" / "logs.json"
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"reward_unit": unit}))
    with pytest.raises(LogError, match=r"logs.json: reward_unit is"):
        read_logs(tmp_path / "logs")


def test_two_units_do_not_join(logs, tmp_path):
    other = renamed(logs, 8).in_unit("parts")
    with pytest.raises(LogError, match="rewards are in 'Körbe' and in 'parts'"):
        joined([logs, other])
    with pytest.raises(LogError, match="rewards are in"):
        write_stream([logs, other], tmp_path / "stream")
    assert joined([logs, other.in_unit(None)]).reward_unit == "Körbe"
