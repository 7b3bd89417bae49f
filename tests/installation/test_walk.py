"""What the walk with the wheel takes for a fault, without making an environment."""

import pytest

from halfseen.cli import VERBS
from release.every_verb import LINES, Ended
from release.walk import WITHOUT_EXTRAS, engineers_path, faults_without_extras

HINT = "halfseen: skimage is not installed, and this command needs it; run: pip install 'halfseen[perception]'\n"


@pytest.mark.parametrize(
    ("status", "err", "is_fault"),
    [
        (0, "", False),
        (0, "halfseen: warning\n", False),
        (2, HINT, False),
        (2, HINT.replace("pip", "/some where/python -m pip"), False),
        (2, "halfseen: table.pcd: no such file\n", True),
        (2, f"Traceback\n{HINT}", True),
        (1, HINT, True),
    ],
)
def test_a_verb_works_or_says_in_one_line_what_to_install(status, err, is_fault):
    assert bool(faults_without_extras([Ended("look table.pcd", status, err)])) == is_fault


def test_the_engineers_path_has_five_commands():
    assert [line.split()[1] for line in engineers_path()] == ["inspect", "learn", "evaluate", "act", "report"]


def test_what_needs_no_extra_is_among_what_is_run():
    assert {line.split()[0] for line in LINES} & set(VERBS) >= WITHOUT_EXTRAS
