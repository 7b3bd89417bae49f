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
    assert re.search(r"\d+ of \d+ were seen", printed)
    assert re.search(r"^(Better|Not better|Cannot be said): ", printed, flags=re.MULTILINE)
    assert "doubly robust" in printed


@pytest.mark.slow
def test_the_engineers_path_can_be_walked(clone):
    verdict = " ".join(line.removeprefix("> ") for line in README.splitlines() if line.startswith("> "))
    printed = {}
    for line in engineers_path():
        words = shlex.split(line, comments=True)[1:]
        result = CliRunner().invoke(halfseen, words, catch_exceptions=False)
        assert result.exit_code == 0, result.output
        printed[words[0]] = result.output
    # One verdict, and the one that is told.
    assert printed["evaluate"].splitlines()[0] == verdict
    assert "said" not in printed["learn"]
    values = dict(
        re.findall(
            r"^(doubly robust|the logging policy(?: without its exploration)?) +([\d.]+)", printed["evaluate"], re.M
        )
    )
    earned = [
        f"{float(values[name]):.2f}"
        for name in ("the logging policy", "doubly robust", "the logging policy without its exploration")
    ]
    assert "earned {} a part, the policy {},\nthe cell's rule {}:".format(*earned) in README
    assert Path("report.html").stat().st_size > 10_000


def test_every_verb_is_told_of():
    told = set(re.findall(r"halfseen ([a-z]+)\b", " ".join(blocks("sh")) + README.replace("\n", " ")))
    assert set(VERBS) <= told
