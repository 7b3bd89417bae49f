"""How the installation that runs is told, and the command that adds an extra to it where one is missing."""

import json
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

import halfseen
from halfseen import installation
from halfseen.cli import VERBS
from halfseen.installation import command_for
from release.every_verb import LINES, Ended
from release.walk import WITHOUT_EXTRAS, engineers_path, faults_without_extras


def not_there(name):
    raise metadata.PackageNotFoundError(name)


CLONE = Path(halfseen.__file__).parents[2]
HERE = str(Path(sys.executable).parent / "pip")


@pytest.mark.parametrize(
    ("origin", "pip", "command"),
    [
        (None, HERE, "pip install 'halfseen[ros]'"),
        ({"url": "file:///dist/halfseen.whl", "archive_info": {}}, HERE, "pip install 'halfseen[ros]'"),
        ({"url": "file:///clone", "dir_info": {}}, HERE, "pip install 'halfseen[ros]'"),
        ({"url": "file:///my%20clone", "dir_info": {"editable": True}}, HERE, "pip install -e '/my clone[ros]'"),
        # A source folder that was never installed.
        (not_there, HERE, f"pip install -e '{CLONE}[ros]'"),
        # A pip that is of another Python, or none.
        (None, "/usr/bin/pip", f"{sys.executable} -m pip install 'halfseen[ros]'"),
        (None, None, f"{sys.executable} -m pip install 'halfseen[ros]'"),
    ],
)
def test_an_extra_is_added_to_what_is_there(monkeypatch, origin, pip, command):
    told = SimpleNamespace(read_text={"direct_url.json": origin and json.dumps(origin, default=str)}.__getitem__)
    monkeypatch.setattr(metadata, "distribution", origin if origin is not_there else lambda _: told)
    monkeypatch.setattr(installation.shutil, "which", lambda _: pip)
    assert command_for("ros") == command
    if origin is not_there:
        monkeypatch.setattr(metadata, "version", not_there)
        assert halfseen.__version__ == "0.0.0.dev0"


def test_the_version_is_that_of_the_metadata():
    assert halfseen.__version__ == metadata.version("halfseen")
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        _ = halfseen.nothing_of_the_kind


# The walk with the wheel.

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


def test_the_engineers_path_has_five_commands_and_what_needs_no_extra_is_run():
    assert [line.split()[1] for line in engineers_path()] == ["inspect", "learn", "evaluate", "act", "report"]
    assert {line.split()[0] for line in LINES} & set(VERBS) >= WITHOUT_EXTRAS
