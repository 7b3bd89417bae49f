import subprocess
import sys

import pytest
from click.testing import CliRunner

from halfseen.cli.study import study


def refused(*arguments):
    command = [sys.executable, "-m", "halfseen.cli", "study", *map(str, arguments)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 2
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    return lines[0]


def test_no_repetitions_are_refused_and_nothing_is_written(tmp_path):
    assert refused("--repetitions", 0, "--out", tmp_path / "study").startswith("halfseen: repetitions is 0; ")
    assert not any(tmp_path.iterdir())


def test_an_experiment_that_is_not_there_is_refused_with_those_that_are(tmp_path):
    assert "--only rewards: there is no such experiment; there are reward, planning" in refused("--only", "rewards")


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")

    assert "cannot be written" in refused("--out", tmp_path / "file" / "study")


def test_a_cloud_that_is_not_there_is_refused_by_name(tmp_path):
    assert "no_such_table.pcd" in refused("--out", tmp_path / "study", tmp_path / "no_such_table.pcd")


@pytest.mark.parametrize("option", ["--out", "--repetitions", "--only", "--seed", "--resume", "--jobs", "--json"])
def test_help_shows_an_example_and_every_option(option):
    shown = CliRunner().invoke(study, ["--help"]).output

    assert "Example: halfseen study --out" in shown
    assert option in shown
