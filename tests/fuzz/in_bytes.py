"""Mutators that know nothing of what the bytes of a file mean, but where words of text are; and what stands elsewhere.

Seals make a broken file whole again.
"""

import hashlib
import json
import os
import re
import shutil
import zlib
from pathlib import Path

import numpy as np

from fuzz.hostile import IN_TEXT_BYTES, pick

Rng = np.random.Generator
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
WORD = re.compile(rb"[^\s,;:=\[\]{}\"]+")
TEXT = (".json", ".toml", ".csv", ".jsonl", ".yaml", ".sha256", ".pcd", ".ply")


def flipped(rng: Rng, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9)) if data else 0):
        changed[_place(rng, len(data))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def cut_short(rng: Rng, data: bytes) -> bytes:
    return data[: _place(rng, len(data) + 1)]


def overwritten(rng: Rng, data: bytes) -> bytes:
    start = _place(rng, len(data) + 1)
    stop = min(len(data), start + int(2 ** rng.uniform(0, 12)))
    return data[:start] + pick(rng, (b"\x00", b"\xff", b" ")) * (stop - start) + data[stop:]


def spliced(rng: Rng, data: bytes) -> bytes:
    """Repeat, leave out or move a part."""
    one, other, third = sorted(_place(rng, len(data) + 1) for _ in range(3))
    a, b, c, d = data[:one], data[one:other], data[other:third], data[third:]
    return pick(rng, (a + b + b + c + d, a + c + d, a + c + b + d, a + b + c + d + a))


def inflated(rng: Rng, data: bytes) -> bytes:
    """Write a huge whole number over some bytes."""
    size, big = int(pick(rng, (2, 4, 8))), pick(rng, (b"\xff", b"\x7f", b"\x80", b"\x00\x01"))
    start = _place(rng, max(1, len(data) - size))
    return data[:start] + (big * size)[:size] + data[start + size :]


def with_another_word(rng: Rng, data: bytes) -> bytes:
    """Put hostile text in the place of a number or a word."""
    found = list((NUMBER if rng.integers(2) else WORD).finditer(_head(data) if rng.integers(2) else data[: 10**6]))
    if not found:
        return flipped(rng, data)
    place = pick(rng, found)
    return data[: place.start()] + pick(rng, IN_TEXT_BYTES) + data[place.end() :]


def with_other_lines(rng: Rng, data: bytes) -> bytes:
    """Drop, double or swap lines."""
    lines = data.splitlines(keepends=True) or [b""]
    k, j = (int(rng.integers(min(len(lines), pick(rng, (12, len(lines)))))) for _ in range(2))
    swapped = [lines[{k: j, j: k}.get(n, n)] for n in range(len(lines))]
    return b"".join(pick(rng, (lines[:k] + lines[k + 1 :], [*lines[:j], lines[k], *lines[j:]], swapped)))


def _head(data: bytes) -> bytes:
    ends = [data.index(end) for end in (b"DATA ", b"end_header") if end in data]
    return data[: min(ends, default=2000)]


def _place(rng: Rng, size: int) -> int:
    if size <= 1:
        return 0
    most = size if rng.integers(2) else min(size, pick(rng, (64, 512)))
    # The ends of Parquet files and of archives say where all is.
    return int(size - 1 - rng.integers(most)) if rng.integers(4) == 0 else int(rng.integers(most))


def on_file(change):
    """A mutator of files of one of bytes."""

    def changed(rng: Rng, file: Path) -> str:
        file.write_bytes(change(rng, file.read_bytes()))
        return f"{file.name}: {change.__name__}"

    return changed


OF_BYTES = tuple(map(on_file, (flipped, cut_short, overwritten, spliced, inflated)))
OF_TEXT = tuple(map(on_file, (*[with_another_word] * 3, with_other_lines)))


def or_flipped(change):
    """A mutator of whole files; what cannot be read, or written as that, has a bit of its footer flipped."""

    def changed(rng: Rng, file: Path) -> str:
        whole = file.read_bytes()
        try:
            return f"{file.name}: {change(rng, file)}"
        except Exception:  # what an earlier mutation broke, or a format does not allow
            data = bytearray(whole or b" ")
            data[-1 - int(rng.integers(min(len(data), 2000)))] ^= 1 << int(rng.integers(8))
            file.write_bytes(bytes(data))
            return f"{file.name}: a bit of the footer flipped"

    return changed


def another_kind(rng: Rng, place: Path) -> str:
    """Put a pipe, a folder, a link or nothing in the place of a file or a folder."""
    kinds = ("pipe", "folder", "/dev/zero", "itself", "nowhere", "empty", "huge", "gone", "unreadable", "file")
    name, kind = place.name, pick(rng, kinds)
    if kind == "unreadable" and not place.is_symlink():
        place.chmod(0)
        return f"{name}: unreadable"
    shutil.rmtree(place) if place.is_dir() else place.unlink()
    if kind == "pipe":
        os.mkfifo(place)
    elif kind == "folder":
        place.mkdir()
    elif kind in ("/dev/zero", "itself", "nowhere"):
        place.symlink_to(name if kind == "itself" else kind)
    elif kind == "huge":
        with place.open("wb") as file:
            file.truncate(65 * 10**9)  # a hole: nothing is written
    elif kind != "gone":
        place.write_bytes(b"" if kind == "empty" else b"neither this nor that\n")
    return f"{name}: {kind}"


def another_file(rng: Rng, place: Path, others: list[Path]) -> str:
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
