"""Mutators of what stands where a file is looked for, and seals that make a broken file whole again."""

import hashlib
import json
import os
import shutil
import zlib
from pathlib import Path

import numpy as np

from fuzz.hostile import pick


def another_kind(rng: np.random.Generator, place: Path) -> str:
    """Put a pipe, a folder, a link or nothing in the place of a file or a folder."""
    kind = pick(
        rng, ("pipe", "folder", "/dev/zero", "itself", "nowhere", "empty", "huge", "gone", "unreadable", "file")
    )
    name = place.name
    if kind == "unreadable" and not place.is_symlink():
        place.chmod(0)
        return f"{name}: unreadable"
    shutil.rmtree(place) if place.is_dir() else place.unlink()
    if kind == "pipe":
        os.mkfifo(place)
    elif kind == "folder":
        place.mkdir()
    elif kind in ("/dev/zero", "itself", "nowhere"):
        place.symlink_to({"/dev/zero": "/dev/zero", "itself": name, "nowhere": "nowhere"}[kind])
    elif kind == "huge":
        with place.open("wb") as file:
            file.truncate(65 * 10**9)  # a hole: nothing is written
    elif kind != "gone":
        place.write_bytes(b"" if kind == "empty" else b"neither this nor that\n")
    return f"{name}: {kind}"


def another_file(rng: np.random.Generator, place: Path, others: list[Path]) -> str:
    """Put another file of the inputs in the place of one."""
    other = pick(rng, others)
    place.write_bytes(other.read_bytes())
    return f"{place.name}: {other.name} in its place"


def sealed(folder: Path) -> None:
    """Make digests and checksums right again, so that what was changed is read."""
    for digests in folder.rglob("*.sha256"):
        files = [digests.with_suffix(suffix) for suffix in (".json", ".safetensors")]
        if digests.is_file() and all(file.is_file() and file.stat().st_size < 10**7 for file in files):
            lines = (f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in files)
            digests.write_text("".join(lines))
    for journal in folder.rglob("journal.jsonl"):
        if journal.is_file() and journal.stat().st_size < 10**7:
            _chain(journal)


def _chain(journal: Path) -> None:
    checksum, lines, is_whole = 0, [], journal.read_bytes().endswith(b"\n")
    for line in journal.read_bytes().splitlines():
        try:
            event = json.dumps(json.loads(line)[1], separators=(",", ":"))
        except (ValueError, IndexError, KeyError, TypeError, RecursionError):
            lines.append(line)
            continue
        checksum = zlib.crc32(event.encode(), checksum)
        lines.append(f'["{checksum:08x}",{event}]'.encode())
    journal.write_bytes(b"\n".join(lines) + (b"\n" if is_whole else b""))
