"""What sdist, wheel and pages hold, and no more: no tests, nothing large, nothing of the machine that made them."""

import gzip
import html
import io
import re
import socket
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlsplit

from release.every_verb import CLONE

BESIDE = {
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "LICENSE",
    "PKG-INFO",
    "README.md",
    "SECURITY.md",
    "constraints.txt",
    "pyproject.toml",
    ".gitignore",
}
"""Files of the sdist beside the package."""
LARGEST_MB = 4.0
"""The largest file of the package is a log of 3 MB, from which the shipped law was fitted."""


_LINK = re.compile(r'\s(?:href|src)="(?!https?:|mailto:|data:|#)([^"]+)"')


def members(archive: Path) -> Iterator[tuple[str, bytes]]:
    """Name and content of each file of a wheel or of a packed tar."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as opened:
            yield from ((name, opened.read(name)) for name in opened.namelist())
        return
    with tarfile.open(archive) as opened:
        for member in opened:
            if (file := opened.extractfile(member)) is not None:
                yield member.name, file.read()


def faults_of(archive: Path) -> list[str]:
    """Say what an archive holds that it should not."""
    faults = []
    for name, content in members(archive):
        if not _may_hold(archive, name):
            faults.append(f"{archive.name}: {name} is no part of it")
        if len(content) > LARGEST_MB * 1e6:
            faults.append(f"{archive.name}: {name} has {len(content) / 1e6:.1f} MB, more than {LARGEST_MB:g}")
        faults += [f"{archive.name}: {name} tells of this machine ({word})" for word in of_this_machine(content)]
    return faults


def faults_of_pages(pages: Path, docs: Path) -> list[str]:
    """Say which page of the documentation was not built, and which link or picture of a page leads nowhere."""
    sources = [path.relative_to(docs).with_suffix(".html") for path in docs.glob("**/*.md")]
    faults = [f"pages: {page} was not built" for page in sorted(sources) if not (pages / page).is_file()]
    for page in sorted(pages.glob("**/*.html")):
        for link in sorted(set(_LINK.findall(page.read_text(encoding="utf-8")))):
            place = unquote(urlsplit(html.unescape(link)).path)
            if place and not (page.parent / place).exists():
                faults.append(f"pages: {page.relative_to(pages)} leads to {place}, which is not there")
    return faults


def of_this_machine(content: bytes) -> list[str]:
    """Names of this machine, and of places on it, that appear in a content."""
    words = {str(CLONE), f"{Path.home()}/", socket.gethostname()}
    # A name like "vm" stands in other words, too.
    return sorted(word for word in words if len(word) > 5 and word.encode() in content)


def _may_hold(archive: Path, name: str) -> bool:
    first, _, rest = name.partition("/")
    if archive.suffix == ".whl":
        return first == "halfseen" or (first.startswith("halfseen-") and first.endswith(".dist-info"))
    if archive.name.endswith("-docs.tar.gz"):
        return True
    return rest.startswith("src/halfseen/") or rest in BESIDE


def pack(folder: Path, archive: Path, seconds: int) -> None:
    """Pack a folder so that the same files give the same bytes, no matter who packs them or when.

    Parameters
    ----------
    folder
        What is packed.
    archive
        Where to (.tar.gz).
    seconds
        Time of all files, since 1970 [s].
    """
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for file in sorted(path for path in folder.rglob("*") if path.is_file()):
            member = tarfile.TarInfo(f"{archive.name.removesuffix('.tar.gz')}/{file.relative_to(folder).as_posix()}")
            content = file.read_bytes()
            member.size, member.mtime, member.mode = len(content), seconds, 0o644
            tar.addfile(member, io.BytesIO(content))
    archive.write_bytes(gzip.compress(packed.getvalue(), mtime=seconds))
