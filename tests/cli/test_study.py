import pytest
from click.testing import CliRunner

from halfseen.cli.study import study


def test_no_repetitions_are_refused_and_nothing_is_written(refused, tmp_path):
    assert refused("study", "--repetitions", 0, "--out", tmp_path / "study").startswith("halfseen: repetitions is 0; ")
    assert not any(tmp_path.iterdir())


def test_an_experiment_that_is_not_there_is_refused_with_those_that_are(refused):
    assert "--only rewards: there is no such experiment; there are reward, planning" in refused(
        "study", "--only", "rewards"
    )


def test_a_folder_that_cannot_be_written_is_refused_before_anything_is_looked_at(refused, tmp_path):
    (tmp_path / "file").write_text("")

    assert "cannot be written" in refused("study", "--out", tmp_path / "file" / "study")


def test_a_cloud_that_is_not_there_is_refused_by_name(refused, tmp_path):
    assert "no_such_table.pcd" in refused("study", "--out", tmp_path / "study", tmp_path / "no_such_table.pcd")


def test_a_law_that_is_not_there_is_refused_by_name(refused, tmp_path):
    assert "no_such_law" in refused("study", "--out", tmp_path / "study", "--law", tmp_path / "no_such_law")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    "option",
    ["--out", "--repetitions", "--only", "--seed", "--law", "--resume", "--workers", "--engine", "--address", "--json"],
)
def test_help_shows_an_example_and_every_option(option):
    shown = CliRunner().invoke(study, ["--help"]).output

    assert "Example: halfseen study --out" in shown
    assert option in shown
