"""The logs of two robots that come with halfseen are small, sound, and what the command beside them makes."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from halfseen.cli import halfseen
from halfseen.logs import read_logs
from halfseen.logs.inspection.suspicions import suspicions
from halfseen.team import read_team
from halfseen.team.recording import states_of
from halfseen.team.team_world import TeamWorld

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "two_robots"
MOST_BYTES = 200_000


@pytest.fixture(scope="module")
def logs():
    return read_logs(FOLDER / "logs")


def test_they_are_small_and_of_the_robots_beside_them(logs):
    assert sum(file.stat().st_size for file in (FOLDER / "logs").iterdir()) <= MOST_BYTES
    world = TeamWorld.of(read_team(FOLDER / "robots.toml"))
    assert states_of(logs, logs.horizon).robots.num_robots == world.team_config.num_robots == 2
    assert "attempt_by" in logs.objects.columns
    assert [each.sentence for each in suspicions(logs)] == []


def test_prose_tells_how_many_there_are(logs):
    for file in (FOLDER / "README.md", ROOT / "examples" / "README.md"):
        assert f"{logs.num_paths} tables that two robots cleared" in " ".join(file.read_text().split())
    assert 0.25 < logs.cut_share < 0.4


@pytest.mark.slow
def test_the_command_beside_them_makes_them(logs, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    command = re.findall(r"^halfseen (.*)$", (FOLDER / "README.md").read_text(), flags=re.MULTILINE)[0]
    words = shlex.split(command)
    words[words.index("--out") + 1] = str(tmp_path / "logs")
    assert CliRunner().invoke(halfseen, words, catch_exceptions=False).exit_code == 0
    again = read_logs(tmp_path / "logs")
    for column in ("path", "stage", "robot", "action", "0_does", "1_does"):
        assert again.stages[column].tolist() == logs.stages[column].tolist()
    for column in ("elapsed_s", "reward", "probability"):
        ours, theirs = (one.stages[column].astype(float) for one in (again, logs))
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-6)
