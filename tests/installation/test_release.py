"""What `make release` gives away: its version, its notes, what the archives hold, and that they can be made again."""

import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib import metadata

import pytest
import yaml

from release import archives
from release.archives import BESIDE, faults_of, members
from release.bill import plain
from release.every_verb import CLONE
from release.notes import entries, notes_of

CHANGELOG = """# Changelog

## [Unreleased]

## [0.2.0] - 2027-01-31

### Added

- A verb.

## [0.1.0] - 2026-13-40

- No such day.

## [0.0.1] - 2026-01-01
"""


@pytest.mark.parametrize("version", ["0.1.0", "0.0.1", "0.3.0", "Unreleased"])
def test_a_version_without_a_day_or_words_is_refused(version):
    with pytest.raises(ValueError, match=rf"CHANGELOG\.md: there is no entry `## \[{version}\] - YYYY-MM-DD`"):
        notes_of(version, CHANGELOG)
    assert notes_of("0.2.0", CHANGELOG) == "### Added\n\n- A verb."
    assert entries(CHANGELOG)["Unreleased"] == ("", "")


def test_the_changelog_tells_of_what_is_to_come_and_of_the_version_that_is_cited():
    changelog = (CLONE / "CHANGELOG.md").read_text(encoding="utf-8")
    first, newest = list(entries(changelog))[:2]
    assert first == "Unreleased"
    assert notes_of(newest, changelog)
    assert yaml.safe_load((CLONE / "CITATION.cff").read_text(encoding="utf-8"))["version"] == newest


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
    told = {"SOURCE_DATE_EPOCH": "1700000000", "SETUPTOOLS_SCM_PRETEND_VERSION": "0.9.0"}
    run("sh", "-c", f"umask {umask}; '{sys.executable}' -m hatchling build -d '{out}' {words}", cwd=folder, **told)
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
    assert again.name == wheel.name == "halfseen-0.9.0-py3-none-any.whl"
    assert dict(members(again)) == dict(members(wheel))


@pytest.mark.slow
def test_archives_hold_the_package_and_nothing_else(built):
    for archive in built:
        assert faults_of(archive) == []
        names = {name.partition("halfseen-0.9.0/")[2] or name for name, _ in members(archive)}
        assert any(name.endswith("halfseen/py.typed") for name in names)
        assert any(name.endswith("halfseen/scene/tables/table_00.pcd") for name in names)


def test_what_is_no_part_of_the_package_is_told(tmp_path, monkeypatch):
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
    told = {"metadata": {"tools": source}, "components": parts, "dependencies": refs}
    bill = plain(told)
    assert bill["metadata"] == {"component": {"name": "halfseen", "bom-ref": "halfseen==1", "type": "application"}}
    assert [part["name"] for part in bill["components"]] == ["jax"]
    assert bill["dependencies"] == [{"ref": "halfseen==1"}]
    assert "where-it-came-from" not in str(bill)


def test_what_an_extra_brings_is_pinned():
    """Each direct requirement has a pin that it allows, for every Python that is told of."""
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    project = tomllib.loads((CLONE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = (CLONE / "constraints.txt").read_text(encoding="utf-8").split()
    pins = {canonicalize_name(name): pin for name, pin in (line.split("==") for line in lines)}
    asked = [*project["dependencies"], *(line for extra in project["optional-dependencies"].values() for line in extra)]
    for told in map(Requirement, asked):
        if told.name != "halfseen":
            assert told.specifier.contains(pins[canonicalize_name(told.name)], prereleases=True), told
    assert "setuptools" in pins  # osqp asks for it where Python does not bring it
    assert metadata.version("numpy") == pins["numpy"]
