"""Dockerfile and conda recipe say what pyproject says."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

from release.every_verb import CLONE

TOLD = tomllib.loads((CLONE / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = TOLD["project"]
RECIPE = yaml.safe_load((CLONE / "recipe" / "recipe.yaml").read_text(encoding="utf-8"))
DOCKERFILE = (CLONE / "Dockerfile").read_text(encoding="utf-8")
PYTHONS = [each.split()[-1] for each in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", each)]


def named(lines):
    return {Requirement(line).name: Requirement(line).specifier for line in lines}


def test_the_recipe_asks_for_what_the_wheel_asks_for_builds_as_pip_does_and_describes_the_package():
    run, host = (named(RECIPE["requirements"][part]) for part in ("run", "host"))
    assert str(run.pop("python")) == str(host.pop("python")) == PROJECT["requires-python"]
    assert run == named(PROJECT["dependencies"])
    assert {name: told for name, told in host.items() if name != "pip"} == named(TOLD["build-system"]["requires"])
    about, (entry_point,) = RECIPE["about"], RECIPE["build"]["python"]["entry_points"]
    assert (RECIPE["package"]["name"], about["summary"]) == (PROJECT["name"], PROJECT["description"])
    assert (about["license"], [about["license_file"]]) == (PROJECT["license"], PROJECT["license-files"])
    assert dict([entry_point.split(" = ")]) == PROJECT["scripts"]
    # That the builder reads the version by this name shows where the tests of a release build the sdist.
    assert RECIPE["build"]["script"]["env"] == {"SETUPTOOLS_SCM_PRETEND_VERSION": "${{ version }}"}
    assert "SETUPTOOLS_SCM_PRETEND_VERSION=$VERSION" in DOCKERFILE


def test_the_image_has_a_python_and_extras_that_there_are_and_runs_halfseen_as_nobody_special():
    assert set(re.findall(r"^FROM [^:]+:(\S+)", DOCKERFILE, re.MULTILINE)) == {f"{PYTHONS[-1]}-slim"}
    assert PROJECT["requires-python"] == f">={PYTHONS[0]}"
    (extras,) = re.findall(r"^ARG EXTRAS=(\S+)", DOCKERFILE, re.MULTILINE)
    assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"])
    copied = set(re.search(r"^COPY (.*) \./\nCOPY src src$", DOCKERFILE, re.MULTILINE)[1].split())
    assert copied >= {PROJECT["readme"], *PROJECT["license-files"], "pyproject.toml", "constraints.txt"}
    let_in = {line[1:] for line in (CLONE / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert let_in == copied | {"src"}
    last = DOCKERFILE.split("FROM ")[-1]
    assert int(re.search(r"^USER (\d+)$", last, re.MULTILINE)[1]) > 0
    assert json.loads(re.search(r"^ENTRYPOINT (.*)$", last, re.MULTILINE)[1]) == list(PROJECT["scripts"])


HADOLINT = Path(sys.executable).parent / "hadolint"


@pytest.mark.skipif(not HADOLINT.exists(), reason="hadolint is not installed")
def test_hadolint_finds_nothing():
    done = subprocess.run([HADOLINT, CLONE / "Dockerfile"], capture_output=True, text=True, check=False)
    assert done.stdout + done.stderr == ""
