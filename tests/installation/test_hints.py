"""How the installation that runs is told: its version, and the command that adds an extra to it."""

import json
import sys
from importlib import metadata
from pathlib import Path

import pytest

import halfseen
from halfseen import installation
from halfseen.installation import command_for


class Installed:
    """A distribution that tells where it came from."""

    def __init__(self, origin):
        self._origin = origin

    def read_text(self, name):
        assert name == "direct_url.json"
        return self._origin and json.dumps(self._origin)


@pytest.fixture
def pip_here(monkeypatch):
    monkeypatch.setattr(installation.shutil, "which", lambda name: str(Path(sys.executable).parent / name))


@pytest.mark.parametrize(
    ("origin", "command"),
    [
        (None, "pip install 'halfseen[ros]'"),
        ({"url": "file:///dist/halfseen.whl", "archive_info": {}}, "pip install 'halfseen[ros]'"),
        ({"url": "file:///clone", "dir_info": {}}, "pip install 'halfseen[ros]'"),
        ({"url": "file:///my%20clone", "dir_info": {"editable": True}}, "pip install -e '/my clone[ros]'"),
    ],
)
def test_an_extra_is_added_to_what_is_there(pip_here, monkeypatch, origin, command):
    monkeypatch.setattr(metadata, "distribution", lambda _: Installed(origin))
    assert command_for("ros") == command


def test_a_source_folder_that_was_never_installed_is_installed_with_the_extra(pip_here, monkeypatch):
    def not_there(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", not_there)
    monkeypatch.setattr(metadata, "version", not_there)
    assert command_for("ros") == f"pip install -e '{Path(halfseen.__file__).parents[2]}[ros]'"
    assert halfseen.__version__ == "0.0.0.dev0"


@pytest.mark.parametrize("found", [None, "/usr/bin/pip"])
def test_a_pip_that_is_of_another_python_is_not_told(monkeypatch, found):
    monkeypatch.setattr(installation.shutil, "which", lambda _: found)
    assert command_for("ros").startswith(f"{sys.executable} -m pip install ")


def test_the_version_is_that_of_the_metadata():
    assert halfseen.__version__ == metadata.version("halfseen")
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        _ = halfseen.nothing_of_the_kind
