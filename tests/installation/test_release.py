"""What `make release` gives away: its version, its notes, what the archives hold, and that they can be made again."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import halfseen
from halfseen import cli
from release import archives
from release.__main__ import cited_day, said_versions, version_of_source
from release.archives import BESIDE, faults_of, faults_of_pages, members, pack
from release.bill import plain
from release.every_verb import CLONE
from release.notes import entries, lacks, notes_of

TOLD = tomllib.loads((CLONE / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = TOLD["project"]
RECIPE = yaml.safe_load((CLONE / "recipe" / "recipe.yaml").read_text(encoding="utf-8"))
CITATION = yaml.safe_load((CLONE / "CITATION.cff").read_text(encoding="utf-8"))
DOCKERFILE = (CLONE / "Dockerfile").read_text(encoding="utf-8")
PYTHONS = [each.split()[-1] for each in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", each)]
CHANGELOG = """# Changelog

## [Unreleased]

## [0.2.0] - 2027-01-31

### Added

- A verb.

## [0.1.0] - 2026-13-40

- No such day.

## [0.0.1] - 2026-01-01
"""


@pytest.mark.parametrize("version", ["0.1.0", "0.0.1", "0.3.0"])
def test_a_version_without_a_day_or_words_is_refused(version):
    day = entries(CHANGELOG).get(version, ("", ""))[0]
    missing = f"write `## [{version}] - YYYY-MM-DD` with words below it in CHANGELOG.md"
    assert lacks(version, {"CITATION.cff": version}, CHANGELOG, day) == [missing]
    assert lacks("0.2.0", {"CITATION.cff": "0.2.0"}, CHANGELOG, "2027-01-31") == []


@pytest.mark.parametrize(("cited", "says"), [(None, "none"), ("2027-01-30", "2027-01-30")])
def test_a_version_that_is_cited_with_another_day_is_refused(cited, says):
    missing = f"write `date-released: 2027-01-31` in CITATION.cff (it says {says})"
    assert lacks("0.2.0", {"CITATION.cff": "0.2.0"}, CHANGELOG, cited) == [missing]


def test_all_that_a_version_lacks_is_reported_at_once():
    changelog = CHANGELOG.replace("[Unreleased]\n", "[Unreleased]\n\n- To come.\n")
    assert lacks("0.2.0.dev0", {"CITATION.cff": "0.1.0", "recipe.yaml": "0.2.0"}, changelog, None) == [
        "set 0.2.0 in src/halfseen/__init__.py (it says 0.2.0.dev0)",
        "set 0.2.0 in CITATION.cff (it says 0.1.0)",
        "write `date-released: 2027-01-31` in CITATION.cff (it says none)",
        "move the words below [Unreleased] to [0.2.0]",
    ]
    assert notes_of("0.2.0.dev0", changelog) == "- To come."
    assert notes_of("0.2.0", changelog) == "### Added\n\n- A verb."


def test_every_file_and_the_command_line_say_the_version_of_the_source():
    said = {"CITATION.cff": CITATION["version"], "recipe/recipe.yaml": RECIPE["context"]["version"]}
    assert said_versions() == said == dict.fromkeys(said, halfseen.__version__)
    assert version_of_source() == halfseen.__version__
    assert CliRunner().invoke(cli.halfseen, ["--version"]).output == f"halfseen, version {halfseen.__version__}\n"


def test_the_changelog_tells_of_what_is_to_come_and_of_this_version():
    first, newest = list(entries((CLONE / "CHANGELOG.md").read_text(encoding="utf-8")))[:2]
    assert (first, newest) == ("Unreleased", halfseen.__version__.partition(".dev")[0])


def test_the_citation_has_what_its_form_requires_and_the_day_of_the_changelog():
    """A version that is still made has no day; keys and types are those of CFF 1.2.0."""
    assert set(CITATION) - {"date-released"} == {
        "cff-version", "message", "title", "type", "authors", "version", "license",
    }  # fmt: skip
    assert (CITATION["cff-version"], CITATION["type"], CITATION["license"]) == ("1.2.0", "software", PROJECT["license"])
    assert CITATION["title"].startswith(f"{PROJECT['name']}: ")
    assert all(set(author) <= {"name", "given-names", "family-names"} for author in CITATION["authors"])
    changelog = entries((CLONE / "CHANGELOG.md").read_text(encoding="utf-8"))
    assert (cited_day() or "") == changelog.get(halfseen.__version__, ("", ""))[0]


def test_pages_that_were_not_built_and_links_that_lead_nowhere_are_reported(tmp_path):
    docs, pages = tmp_path / "docs", tmp_path / "pages"
    for file in (docs / "index.md", docs / "guide" / "lost.md", docs / "guide" / "logs.md", pages / "a b.svg"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("")
    (pages / "guide").mkdir()
    (pages / "index.html").write_text(
        '<a href="guide/logs.html?a=1#top">x</a><a href="https://a.b/c">y</a><a href="#z">z</a>'
    )
    (pages / "guide" / "logs.html").write_text(
        '<img src="../a%20b.svg"><img src="../gone.png"><a href="../index.html">i</a>'
    )
    assert faults_of_pages(pages, docs) == [
        "pages: guide/lost.html was not built",
        "pages: guide/logs.html leads to ../gone.png, which is not there",
    ]


def test_pages_are_packed_to_the_same_bytes_whoever_has_them(tmp_path):
    for name, mode in (("one", 0o644), ("two", 0o600)):
        (tmp_path / name / "guide").mkdir(parents=True)
        for file in ("guide/logs.html", "index.html") if name == "one" else ("index.html", "guide/logs.html"):
            (tmp_path / name / file).write_text(file)
            (tmp_path / name / file).chmod(mode)
        (tmp_path / f"in-{name}").mkdir()
        pack(tmp_path / name, tmp_path / f"in-{name}" / "halfseen-1-docs.tar.gz", 1700000000)
    one, two = (tmp_path / f"in-{name}" / "halfseen-1-docs.tar.gz" for name in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()
    held = {f"halfseen-1-docs/{file}": file.encode() for file in ("guide/logs.html", "index.html")}
    assert dict(members(one)) == held
    assert faults_of(one) == []


def run(*command, cwd, **environment):
    done = subprocess.run(command, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def copy_of_the_source(folder):
    names = ("src", "LICENSE", "README.md", "pyproject.toml", *BESIDE - {"PKG-INFO"})
    for name in {name for name in names if (CLONE / name).exists()}:
        if (CLONE / name).is_dir():
            shutil.copytree(CLONE / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copyfile(CLONE / name, folder / name)
    return folder


def build(folder, out, *kinds, umask="022"):
    words = " ".join(f"-t {kind}" for kind in kinds)
    result = {"SOURCE_DATE_EPOCH": "1700000000"}
    run("sh", "-c", f"umask {umask}; '{sys.executable}' -m hatchling build -d '{out}' {words}", cwd=folder, **result)
    return [path for kind in (".tar.gz", ".whl") for path in out.glob(f"*{kind}")]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Sdist and wheel."""
    folder = tmp_path_factory.mktemp("built")
    (folder / "source").mkdir()
    return build(copy_of_the_source(folder / "source"), folder / "dist", "sdist", "wheel")


@pytest.mark.slow
def test_the_same_source_gives_the_same_bytes_wherever_and_whenever(built, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    source = copy_of_the_source(tmp_path / "elsewhere")
    for file in source.rglob("*"):
        file.chmod(0o700 if file.is_dir() else 0o600)
        os.utime(file, (1, 1))
    again = build(source, tmp_path / "dist", "sdist", "wheel", umask="077")
    assert [path.name for path in again] == [path.name for path in built]
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in built]


@pytest.mark.slow
def test_the_sdist_gives_the_wheel_without_git(built, tmp_path):
    sdist, wheel = built
    with tarfile.open(sdist) as opened:
        opened.extractall(tmp_path, filter="data")
    folder = tmp_path / sdist.name.removesuffix(".tar.gz")
    run(sys.executable, "-m", "hatchling", "build", "-d", tmp_path, "-t", "wheel", cwd=folder)
    (again,) = tmp_path.glob("*.whl")
    assert again.name == wheel.name == f"halfseen-{halfseen.__version__}-py3-none-any.whl"
    assert dict(members(again)) == dict(members(wheel))


@pytest.mark.slow
def test_archives_hold_the_package_and_nothing_else(built):
    for archive in built:
        assert faults_of(archive) == []
        names = {name.partition(f"halfseen-{halfseen.__version__}/")[2] or name for name, _ in members(archive)}
        assert any(name.endswith("halfseen/py.typed") for name in names)
        assert any(name.endswith("halfseen/scene/tables/table_00.pcd") for name in names)


def test_what_is_no_part_of_the_package_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(archives, "LARGEST_MB", 0.001)
    monkeypatch.setattr(archives.socket, "gethostname", lambda: "bench-machine-7")
    wheel = tmp_path / "halfseen-1-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as opened:
        opened.writestr("tests/big.bin", bytes(2000))
        opened.writestr("halfseen/where.txt", f"made on bench-machine-7 in {CLONE}")
    assert faults_of(wheel) == [
        f"{wheel.name}: tests/big.bin is no part of it",
        f"{wheel.name}: tests/big.bin has 0.0 MB, more than 0.001",
        f"{wheel.name}: halfseen/where.txt tells of this machine ({CLONE})",
        f"{wheel.name}: halfseen/where.txt tells of this machine (bench-machine-7)",
    ]


def test_the_bill_is_of_the_wheel_and_tells_no_address():
    source = [{"type": "distribution", "url": "where-it-came-from"}]
    names = ("halfseen", "jax", "pip")
    parts = [{"name": name, "bom-ref": f"{name}==1", "externalReferences": source} for name in names]
    refs = [{"ref": "halfseen==1"}, {"ref": "pip==1"}]
    result = {"metadata": {"tools": source}, "components": parts, "dependencies": refs}
    bill = plain(result)
    assert bill["metadata"] == {"component": {"name": "halfseen", "bom-ref": "halfseen==1", "type": "application"}}
    assert [part["name"] for part in bill["components"]] == ["jax"]
    assert bill["dependencies"] == [{"ref": "halfseen==1"}]
    assert "where-it-came-from" not in str(bill)


def test_what_an_extra_brings_is_pinned():
    """Each direct requirement has a pin that it allows, for every Python that is named."""
    lines = (CLONE / "constraints.txt").read_text(encoding="utf-8").split()
    pins = {canonicalize_name(name): pin for name, pin in (line.split("==") for line in lines)}
    asked = [*PROJECT["dependencies"], *(line for extra in PROJECT["optional-dependencies"].values() for line in extra)]
    for result in map(Requirement, asked):
        if result.name != "halfseen":
            assert result.specifier.contains(pins[canonicalize_name(result.name)], prereleases=True), result
    assert "setuptools" in pins  # osqp asks for it where Python does not bring it
    assert metadata.version("numpy") == pins["numpy"]


# Dockerfile and conda recipe say what pyproject says.


def named(lines):
    return {Requirement(line).name: Requirement(line).specifier for line in lines}


def test_the_recipe_asks_for_what_the_wheel_asks_for_builds_as_pip_does_and_describes_the_package():
    run, host = (named(RECIPE["requirements"][part]) for part in ("run", "host"))
    assert str(run.pop("python")) == str(host.pop("python")) == PROJECT["requires-python"]
    assert run == named(PROJECT["dependencies"])
    assert {name: result for name, result in host.items() if name != "pip"} == named(TOLD["build-system"]["requires"])
    about, (entry_point,) = RECIPE["about"], RECIPE["build"]["python"]["entry_points"]
    assert (RECIPE["package"]["name"], about["summary"]) == (PROJECT["name"], PROJECT["description"])
    assert (about["license"], [about["license_file"]]) == (PROJECT["license"], PROJECT["license-files"])
    assert dict([entry_point.split(" = ")]) == PROJECT["scripts"]


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
