import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from halfseen.cli import VERBS, halfseen
from release.walk import engineers_path

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def clone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.slow
def test_the_python_example_runs_and_shows_what_is_said_of_it(clone, capsys):
    (example,) = blocks("python")
    exec(compile(example, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert re.search(r"\d+ of \d+ weights are above 0", printed)
    assert re.search(r"^(Better|Not better|Inconclusive): ", printed, flags=re.MULTILINE)
    assert "doubly robust" in printed


@pytest.mark.slow
def test_the_engineers_path_can_be_walked(clone):
    quoted = " ".join(line.removeprefix("> ") for line in README.splitlines() if line.startswith("> "))
    printed = {}
    for line in engineers_path():
        words = shlex.split(line, comments=True)[1:]
        result = CliRunner().invoke(halfseen, words, catch_exceptions=False)
        assert result.exit_code == 0, result.output
        printed[words[0]] = result.output
    verdict, vouched = quoted.split(". Vouched for: ")
    assert f"\n{verdict} (said of more cautious policies learned the same way" in printed["learn"]
    assert f"\nVouched for: {vouched}\n" in printed["learn"]
    assert "\nBetter: " in printed["evaluate"]
    assert Path("report.html").stat().st_size > 10_000


def test_every_verb_that_it_names_is_there():
    message = set(
        re.findall(r"halfseen ([a-z]+)\b", " ".join(blocks("sh")) + " ".join(re.findall(r"`([^`]*)`", README)))
    )
    assert {"inspect", "learn", "evaluate", "act", "report", "convert", "record", "serve"} <= message <= set(VERBS)


def test_it_is_read_in_three_minutes():
    assert len(README.split()) <= 650
