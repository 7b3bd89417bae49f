"""The logs of two robots that come with halfseen are small, sound, and what the command beside them makes."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from halfseen.cli import halfseen
from halfseen.logs import read_logs
from halfseen.logs.suspicions import suspicions
from halfseen.world import TableWorld, read_team
from halfseen.world.logs import states_of

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "two_robots"
MOST_BYTES = 200_000


@pytest.fixture(scope="module")
def logs():
    return read_logs(FOLDER / "logs")


def test_they_are_small_and_of_the_robots_beside_them(logs):
    assert sum(file.stat().st_size for file in (FOLDER / "logs").iterdir()) <= MOST_BYTES
    world = TableWorld.of(read_team(FOLDER / "robots.toml"))
    assert states_of(logs, logs.horizon).robots.num_robots == world.played_config.num_robots == 2
    assert "attempt_by" in logs.objects.columns
    assert [each.sentence for each in suspicions(logs)] == []


@pytest.mark.slow
def test_the_command_beside_them_makes_them(logs, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    command = re.findall(r"^halfseen (.*)$", (FOLDER / "README.md").read_text(), flags=re.MULTILINE)[0]
    words = shlex.split(command)
    words[words.index("--out") + 1] = str(tmp_path / "logs")
    assert CliRunner().invoke(halfseen, words, catch_exceptions=False).exit_code == 0
    again = read_logs(tmp_path / "logs")
    for column in ("trajectory", "stage", "robot", "action", "0_does", "1_does"):
        assert again.stages[column].tolist() == logs.stages[column].tolist()
    for column in ("elapsed_s", "reward", "probability"):
        ours, theirs = (one.stages[column].astype(float) for one in (again, logs))
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-6)
