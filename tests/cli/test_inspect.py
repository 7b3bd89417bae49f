import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from halfseen import cli
from halfseen.cli.inspect import inspect
from halfseen.logs import Logs


@pytest.fixture
def folder(tmp_path):
    logs = Logs(
        stages={
            "path": [1, 1, 2, 2, 3],
            "stage": [1, 2, 1, 2, 1],
            "elapsed_s": [2.0, 5.0, 2.0, None, 2.0],
            "action": ["LIFT", "WASH", "WASH", None, "FINISH"],
            "reward": [-0.1, 5.0, -1.0, None, 0.0],
        },
        paths={"path": [1, 2, 3], "end_s": [5.0, 3.0, 2.0], "ending": ["finished", "cut", "finished"]},
    )
    logs.write(tmp_path / "logs")
    return tmp_path / "logs"


def test_says_one_plain_sentence_first_then_the_numbers(folder):
    result = CliRunner().invoke(inspect, [str(folder)], catch_exceptions=False)
    lines = result.output.splitlines()
    assert lines[0] == "3 paths of up to 2 stages and 5 s: 2 finished, 1 cut (33%)."
    assert "causes of cuts  unknown 1" in lines
    assert "actions         WASH 2, FINISH 1, LIFT 1" in lines
    assert "nothing seen    beyond 5 s" in lines
    assert lines[-2:] == [
        "    1          3                    3.0            1.00",
        "    2          1                    1.0            2.00",
    ]


def test_says_what_the_weights_rest_on(folder):
    output = CliRunner().invoke(inspect, [str(folder)], catch_exceptions=False).output
    assert "Too little: 2 finishes are worth 1.8 equally weighted ones." in output
    assert "Largest weights: 2 (path 1, 5 s), 1 (path 3, 2 s)." in output


def test_json_carries_the_same_numbers(folder):
    result = CliRunner().invoke(inspect, [str(folder), "--json"], catch_exceptions=False)
    report = json.loads(result.output)
    assert (report["num_paths"], report["num_cut"], report["causes"]) == (3, 1, {"unknown": 1})
    assert report["weights"][1] == {
        "stage": 2,
        "num_completed": 1,
        "effective_sample_size": 1.0,
        "largest_weight": 2.0,
    }


def test_json_tells_whose_the_largest_weights_are(folder):
    result = CliRunner().invoke(inspect, [str(folder), "--json"], catch_exceptions=False)
    positivity = json.loads(result.output)["positivity"]
    assert not positivity["is_sound"]
    assert positivity["heaviest"][0] == {"path": "1", "time_s": 5.0, "weight": 2.0}


def test_help_has_an_example():
    assert "halfseen inspect logs" in CliRunner().invoke(inspect, ["--help"]).output


@pytest.mark.parametrize("arguments", [["nowhere"], []])
def test_bad_input_is_told_in_one_line_with_status_two(arguments, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["halfseen", "inspect", *arguments])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert len(told.err.splitlines()) == 1


def test_from_the_shell(folder):
    command = [sys.executable, "-m", "halfseen.cli", "inspect"]
    good = subprocess.run([*command, str(folder)], capture_output=True, text=True, check=True)
    assert good.stdout.startswith("3 paths")
    assert good.stderr == ""
    (folder / "stages.parquet").write_bytes(b"PAR1 and no more")
    bad = subprocess.run([*command, str(folder)], capture_output=True, text=True, check=False)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert "stages.parquet: it is no whole Parquet file" in bad.stderr
    assert len(bad.stderr.splitlines()) == 1
