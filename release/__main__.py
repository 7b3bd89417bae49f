"""Build a release and check it: ``make release``; what comes out lies in ``dist``.

Sdist, wheel, pages, bill of materials, notes and the SHA-256 of each, of the version that the source says. A version
without a dated entry of the changelog is refused, and so is a clone with changes that no commit holds.
"""

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from release.archives import faults_of, faults_of_pages, of_this_machine, pack
from release.bill import bill_of
from release.every_verb import CLONE
from release.notes import lacks, notes_of
from release.walk import Bare, walk


def git(*words: str) -> str:
    """What git says of this clone."""
    return subprocess.run(["git", *words], cwd=CLONE, check=True, capture_output=True, text=True).stdout.strip()


def python(*words: str | Path) -> None:
    """Run a module of this Python, or end with what it says."""
    subprocess.run([sys.executable, "-m", *words], cwd=CLONE, check=True)


def version_of_source() -> str:
    """Version that the clone's source says, by what builds the wheel."""
    command = [sys.executable, "-m", "hatchling", "version"]
    return subprocess.run(command, cwd=CLONE, check=True, capture_output=True, text=True).stdout.strip()


def said_versions() -> dict[str, str]:
    """Version by each other file of the clone that says one."""
    places = {"CITATION.cff": r"^version: (\S+)$", "recipe/recipe.yaml": r"^context:\n  version: (\S+)$"}
    texts = {file: (CLONE / file).read_text(encoding="utf-8") for file in places}
    return {file: re.findall(pattern, texts[file], re.MULTILINE)[0] for file, pattern in places.items()}


def cited_day() -> str | None:
    """The day of release that CITATION.cff says."""
    found = re.search(r"^date-released: (\S+)$", (CLONE / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    return found and found[1]


def build(out: Path) -> tuple[Path, Path]:
    """Build the sdist, and the wheel from it."""
    python("build", "--no-isolation", "--outdir", out, CLONE)
    (wheel,), (sdist,) = out.glob("*.whl"), out.glob("*.tar.gz")
    python("twine", "check", "--strict", wheel, sdist)
    subprocess.run([Path(sys.executable).parent / "check-wheel-contents", wheel], check=True)
    return wheel, sdist


def add_pages(out: Path, name: str, seconds: int) -> None:
    """Build the pages again and pack them."""
    with TemporaryDirectory() as folder:
        pages = Path(folder) / "pages"
        python("sphinx", "-W", "--keep-going", "-q", "-b", "html", "-d", Path(folder) / "read", "docs", pages)
        (pages / ".buildinfo").unlink()
        if faults := faults_of_pages(pages, CLONE / "docs"):
            sys.exit("\n".join(faults))
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
    parser.add_argument("--rehearse", action="store_true", help="Build a version that is not to be released yet, too.")
    chosen = parser.parse_args()
    out = chosen.out
    if changed := git("status", "--porcelain"):
        sys.exit(f"release: no commit holds these, so nobody could build this again; commit or stash them:\n{changed}")
    version, changelog = version_of_source(), (CLONE / "CHANGELOG.md").read_text(encoding="utf-8")
    steps = lacks(version, said_versions(), changelog, cited_day())
    missing = f"release: {version} is not to be released yet: {'; '.join(steps)}" if steps else ""
    if missing and not chosen.rehearse:
        sys.exit(missing)
    # Anyone who builds this commit again gets these bytes.
    seconds = int(git("log", "-1", "--format=%ct"))
    os.environ["SOURCE_DATE_EPOCH"] = str(seconds)
    shutil.rmtree(out, ignore_errors=True)
    wheel, sdist = build(out)
    name = sdist.name.removesuffix(".tar.gz")
    add_pages(out, name, seconds)
    (out / "RELEASE_NOTES.md").write_text(notes_of(version, changelog) + "\n", encoding="utf-8")
    refuse_faults(out)
    add_bill(out, wheel, name)
    refuse_faults(out)
    (out / "SHA256SUMS").write_text(sums(out), encoding="utf-8")
    print((out / "SHA256SUMS").read_text(encoding="utf-8"), end="")
    if missing:
        print(missing)


if __name__ == "__main__":
    main()
