"""What installation runs, and the command that adds an extra to it; the wheel in bare environments."""

import json
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

from halfseen import installation
from halfseen.cli import VERBS
from halfseen.installation import command_for
from release.every_verb import CLONE, LINES, Ended
from release.walk import WITHOUT_EXTRAS, Bare, engineers_path, faults_without_extras, pythons, walk_with


def not_there(name):
    raise metadata.PackageNotFoundError(name)


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
    result = SimpleNamespace(read_text={"direct_url.json": origin and json.dumps(origin, default=str)}.__getitem__)
    monkeypatch.setattr(metadata, "distribution", origin if origin is not_there else lambda _: result)
    monkeypatch.setattr(installation.shutil, "which", lambda _: pip)
    assert command_for("ros") == command


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


def test_each_python_that_is_here_and_runs_is_walked_with(tmp_path, monkeypatch):
    for name, status in {"python3.10": 0, "python3.11": 0, "python3.12": 127, "python3.13": 0}.items():
        (tmp_path / name).write_text(f"#!/bin/sh\nexit {status}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    paths = {name: str(tmp_path / name) for name in ("python3.11", "python3.13")}
    assert pythons() == {"python3.12": None, **paths}
    (tmp_path / "python3.13").unlink()
    assert pythons()["python3.13"] is None


def test_the_engineers_path_has_five_commands_and_what_needs_no_extra_is_run():
    assert [line.split()[1] for line in engineers_path()] == ["inspect", "learn", "evaluate", "act", "report"]
    assert {line.split()[0] for line in LINES} & set(VERBS) >= WITHOUT_EXTRAS


PYTHONS = pythons()


@pytest.fixture(scope="module")
def index(tmp_path_factory):
    """Skip where no index of packages answers."""
    words = ["--quiet", "--no-deps", "--dest", tmp_path_factory.mktemp("index"), "click"]
    done = subprocess.run([sys.executable, "-m", "pip", "download", *words], capture_output=True, check=False)
    if done.returncode:
        pytest.skip("no index of packages answers")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-d", out, "-t", "wheel"], cwd=CLONE, check=True)
    return next(out.glob("*.whl"))


@pytest.mark.slow
@pytest.mark.parametrize("name", PYTHONS)
@pytest.mark.usefixtures("index")
def test_the_way_of_the_readme_works_with_the_newest_of_everything(wheel, name, tmp_path):
    if PYTHONS[name] is None:
        pytest.skip(f"{name} is not here")
    walk_with(Bare(tmp_path, PYTHONS[name], pins=None), wheel, "study")
