"""What is given away, where it is installed: the wheel by each Python with the newest of all, and the image's steps.

An image needs a builder, and its steps do not: they are commands of pip. Here they run in an environment of their own.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from release.every_verb import CLONE
from release.walk import Bare, pythons, walk_with

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


def stages_of(dockerfile):
    """Instructions of each stage, as pairs of word and text."""
    lines = re.sub(r"\\\n\s*", "", re.sub(r"^#.*\n", "", dockerfile, flags=re.MULTILINE)).splitlines()
    stages = []
    for word, _, text in (line.partition(" ") for line in lines if line):
        stages += [[]] if word == "FROM" else []
        stages[-1].append((word, text))
    return stages


def copied(stage, folder):
    """Copy what a stage copies out of the clone."""
    for text in (text for word, text in stage if word == "COPY"):
        *sources, target = text.split()
        for source in sources:
            if (CLONE / source).is_dir():
                shutil.copytree(CLONE / source, folder / target, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(CLONE / source, folder / target)


def run(stage, folder, source, env):
    """Run a stage's commands of pip with its variables; `/source` is a folder."""
    given = [text for word, text in stage if word in ("ENV", "ARG")]
    env = env | dict(pair.split("=", 1) for text in given for pair in shlex.split(text))
    for text in (text for word, text in stage if word == "RUN"):
        command = re.sub(r"^--mount=\S+\s+| && useradd .*", "", text).replace("/source", str(source))
        subprocess.run(["sh", "-ec", command], cwd=folder, env=env, check=True)


@pytest.mark.slow
@pytest.mark.usefixtures("index")
def test_the_steps_of_the_image_install_what_its_command_needs(tmp_path):
    first, second = stages_of((CLONE / "Dockerfile").read_text(encoding="utf-8"))
    python = next(path for path in (*list(PYTHONS.values())[::-1], sys.executable) if path is not None)
    subprocess.run([python, "-m", "venv", tmp_path / "image"], check=True)
    mine = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "HALFSEEN_"))}
    env = mine | {"PATH": f"{tmp_path / 'image' / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    source = tmp_path / "source"
    source.mkdir()
    copied(first, source)
    run(first, source, source, env)
    run(second, tmp_path, source, env)
    (entry,) = [text for word, text in second if word == "ENTRYPOINT"]
    command = Path(tmp_path / "image" / "bin", *re.findall(r'"(.*?)"', entry))
    for words in (["--help"], ["inspect", CLONE / "examples" / "bin_cell" / "logs"], ["study", "--help"]):
        subprocess.run([command, *words], cwd=tmp_path, env=env, check=True)
