"""Build a release and check it: ``make release``; what comes out lies in ``dist``.

Sdist, wheel, pages, bill of materials, notes and the SHA-256 of each. A tag without an entry of the changelog is
refused, and so is a clone with changes that no commit holds.
"""

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from release.archives import faults_of, of_this_machine, pack
from release.bill import bill_of
from release.every_verb import CLONE
from release.notes import entries, notes_of
from release.walk import Bare, walk


def git(*words: str) -> str:
    """What git says of this clone."""
    return subprocess.run(["git", *words], cwd=CLONE, check=True, capture_output=True, text=True).stdout.strip()


def python(*words: str | Path) -> None:
    """Run a module of this Python, or end with what it says."""
    subprocess.run([sys.executable, "-m", *words], cwd=CLONE, check=True)


def words_of_this_version(tag: str) -> str:
    """Notes of the version that a tag names; of an untagged commit what is unreleased.

    Raises
    ------
    ValueError
        The changelog says nothing of the tag's version.
    """
    changelog = (CLONE / "CHANGELOG.md").read_text(encoding="utf-8")
    return notes_of(tag.removeprefix("v"), changelog) if tag else entries(changelog)["Unreleased"][1]


def build(out: Path) -> tuple[Path, Path]:
    """Build the sdist, and the wheel from it."""
    python("build", "--no-isolation", "--outdir", out, CLONE)
    (wheel,), (sdist,) = out.glob("*.whl"), out.glob("*.tar.gz")
    python("twine", "check", "--strict", wheel, sdist)
    subprocess.run([Path(sys.executable).parent / "check-wheel-contents", wheel], check=True)
    return wheel, sdist


def add_pages(out: Path, name: str, seconds: int) -> None:
    """Build the pages anew and pack them."""
    with TemporaryDirectory() as folder:
        pages = Path(folder) / "pages"
        python("sphinx", "-W", "--keep-going", "-q", "-b", "html", "-d", Path(folder) / "read", "docs", pages)
        (pages / ".buildinfo").unlink()
        pack(pages, out / f"{name}-docs.tar.gz", seconds)


def add_bill(out: Path, wheel: Path, name: str) -> None:
    """Go the engineer's path with the wheel in a bare environment, and write down what is installed there."""
    with TemporaryDirectory() as folder:
        bare = Bare(Path(folder))
        walk(bare, wheel)
        (out / f"{name}.cdx.json").write_text(bill_of(bare.python), encoding="utf-8")


def refuse_faults(out: Path) -> None:
    """End if anything that was built holds what it should not."""
    faults = [fault for archive in (*out.glob("*.whl"), *out.glob("*.tar.gz")) for fault in faults_of(archive)]
    for file in out.glob("*.json"):
        faults += [f"{file.name} tells of this machine ({word})" for word in of_this_machine(file.read_bytes())]
    if faults:
        sys.exit("\n".join(faults))


def sums(out: Path) -> str:
    """SHA-256 of each file of a folder, as `sha256sum --check` reads it."""
    files = sorted(path for path in out.iterdir() if path.name != "SHA256SUMS")
    return "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in files)


def main() -> None:
    """Build, check, and tell what was built."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=CLONE / "dist")
    out = parser.parse_args().out
    if changed := git("status", "--porcelain"):
        sys.exit(f"release: no commit holds these, so nobody could build this again; commit or stash them:\n{changed}")
    tag = git("tag", "--points-at", "HEAD", "--list", "v*").partition("\n")[0]
    try:
        notes = words_of_this_version(tag)
    except ValueError as error:
        sys.exit(f"release: {error}")
    # Whoever builds this commit again gets these bytes.
    seconds = int(git("log", "-1", "--format=%ct"))
    os.environ["SOURCE_DATE_EPOCH"] = str(seconds)
    shutil.rmtree(out, ignore_errors=True)
    wheel, sdist = build(out)
    name = sdist.name.removesuffix(".tar.gz")
    if tag and name != f"halfseen-{tag.removeprefix('v')}":
        sys.exit(f"release: the tag is {tag}, and {sdist.name} was built; name the tag vMAJOR.MINOR.PATCH")
    add_pages(out, name, seconds)
    (out / "RELEASE_NOTES.md").write_text(notes + "\n", encoding="utf-8")
    refuse_faults(out)
    add_bill(out, wheel, name)
    refuse_faults(out)
    (out / "SHA256SUMS").write_text(sums(out), encoding="utf-8")
    print((out / "SHA256SUMS").read_text(encoding="utf-8"), end="")
    if not tag:
        print("release: HEAD has no tag, so this is no release; `git tag -a v0.1.0` names one")


if __name__ == "__main__":
    main()
