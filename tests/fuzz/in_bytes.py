"""Mutators that know nothing of what the bytes of a file mean; of text, no more than where its words are."""

import re
from pathlib import Path

import numpy as np

from fuzz.hostile import IN_TEXT_BYTES, pick

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
WORD = re.compile(rb"[^\s,;:=\[\]{}\"]+")
TEXT = (".json", ".toml", ".csv", ".jsonl", ".yaml", ".sha256", ".pcd", ".ply")


def flip(rng: np.random.Generator, file: Path) -> str:
    """Flip one to eight bits; in half of the cases near the beginning, where headers are."""
    data = bytearray(file.read_bytes())
    for _ in range(int(rng.integers(1, 9))):
        if data:
            data[_place(rng, len(data))] ^= 1 << int(rng.integers(8))
    return _put(file, data, "flipped bits")


def cut_short(rng: np.random.Generator, file: Path) -> str:
    data = file.read_bytes()
    return _put(file, data[: _place(rng, len(data) + 1)], "cut short")


def zeroed(rng: np.random.Generator, file: Path) -> str:
    data = bytearray(file.read_bytes())
    start = _place(rng, len(data) + 1)
    stop = min(len(data), start + int(2 ** rng.uniform(0, 12)))
    data[start:stop] = pick(rng, (b"\x00", b"\xff", b" ")) * (stop - start)
    return _put(file, data, "range overwritten")


def spliced(rng: np.random.Generator, file: Path) -> str:
    """Repeat, leave out or move a part."""
    data = file.read_bytes()
    one, other, third = sorted(_place(rng, len(data) + 1) for _ in range(3))
    a, b, c, d = data[:one], data[one:other], data[other:third], data[third:]
    return _put(file, pick(rng, (a + b + b + c + d, a + c + d, a + c + b + d, a + b + c + d + a)), "parts spliced")


def inflated(rng: np.random.Generator, file: Path) -> str:
    """Write a huge whole number over four or eight bytes."""
    data = bytearray(file.read_bytes())
    size, big = int(pick(rng, (2, 4, 8))), pick(rng, (b"\xff", b"\x7f", b"\x80", b"\x00\x01"))
    start = _place(rng, max(1, len(data) - size))
    data[start : start + size] = (big * size)[:size]
    return _put(file, data, "number inflated")


def another_word(rng: np.random.Generator, file: Path) -> str:
    """Put hostile text in the place of a number or a word."""
    data = file.read_bytes()[: 10**6]
    if rng.integers(2):
        data = _head(data)
    found = list((NUMBER if rng.integers(2) else WORD).finditer(data))
    if not found:
        return flip(rng, file)
    place, whole = pick(rng, found), file.read_bytes()
    new = whole[: place.start()] + pick(rng, IN_TEXT_BYTES) + whole[place.end() :]
    return _put(file, new, f"{place[0][:20]!r} replaced")


def lines_moved(rng: np.random.Generator, file: Path) -> str:
    """Drop, double or swap lines."""
    lines = file.read_bytes().splitlines(keepends=True) or [b""]
    k, j = (int(rng.integers(min(len(lines), pick(rng, (12, len(lines)))))) for _ in range(2))
    kind = pick(rng, ("dropped", "doubled", "swapped"))
    if kind == "dropped":
        del lines[k]
    elif kind == "doubled":
        lines.insert(j, lines[k])
    else:
        lines[k], lines[j] = lines[j], lines[k]
    return _put(file, b"".join(lines), f"line {kind}")


OF_BYTES = (flip, cut_short, zeroed, spliced, inflated)
OF_TEXT = (another_word, another_word, another_word, lines_moved)


def _head(data: bytes) -> bytes:
    for end in (b"DATA ", b"end_header"):
        if end in data:
            return data[: data.index(end)]
    return data[:2000]


def _place(rng: np.random.Generator, size: int) -> int:
    if size <= 1:
        return 0
    most = size if rng.integers(2) else min(size, pick(rng, (64, 512)))
    # The ends of Parquet files and of archives say where all is.
    return int(size - 1 - rng.integers(most)) if rng.integers(4) == 0 else int(rng.integers(most))


def _put(file: Path, data: bytes | bytearray, told: str) -> str:
    file.write_bytes(bytes(data))
    return f"{file.name}: {told}"
