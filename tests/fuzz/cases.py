"""A case: an input, broken or not, and a command line; drawn from a seed and a number, kept as a file, made again."""

import base64
import json
import os
import shlex
import shutil
import stat
import zlib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fuzz import log_inputs, policy_inputs  # noqa: F401
from fuzz.corpus import CLOUDS, HEAVY, LOGS, SEEDS, made, of_kind
from fuzz.hostile import pick
from fuzz.in_bytes import OF_BYTES, OF_TEXT, TEXT, another_file, another_kind, sealed
from fuzz.in_structure import NEUTRAL, OF_FORMAT
from fuzz.in_words import other_words

INPUT = "in"
MOST_TEXT = 8000
"""Bytes that a kept case shows as they are."""


@dataclass(frozen=True)
class Case:
    """What is run, and what was done to its input."""

    seed: str
    words: tuple[str, ...]
    mutations: tuple[str, ...]
    line: int | None = None


def drawn(seed: int, number: int, corpus: Path, folder: Path, has_heavy: bool = True) -> Case:
    """Draw a case, and make its input in a fresh folder; the same seed and number draw the same."""
    rng = np.random.default_rng([seed, number])
    kind = pick(rng, ("words", "neutral", *["broken"] * 6))
    groups = ((CLOUDS, LOGS), (CLOUDS, LOGS), (LOGS,), (HEAVY,)) if has_heavy else ((CLOUDS,), (LOGS,))
    is_of_none = kind == "words" and not rng.integers(4)
    chosen = SEEDS["command-line"] if is_of_none else pick(rng, of_kind(*pick(rng, groups)))
    k = int(rng.integers(len(chosen.lines)))
    case = Case(chosen.name, tuple(shlex.split(chosen.lines[k])), ())
    shutil.copytree(made(chosen, corpus), folder / INPUT)
    if kind == "words":
        words = tuple(other_words(rng, chosen.lines[k]))
        return replace(case, words=words, mutations=("words",))
    if kind == "neutral":
        return replace(case, mutations=_neutral(rng, folder / INPUT), line=k)
    mutations = [broken(rng, folder / INPUT) for _ in range(pick(rng, (1, 1, 2)))]
    if rng.integers(4):
        sealed(folder / INPUT)
    return replace(case, mutations=tuple(mutations))


def broken(rng: np.random.Generator, folder: Path) -> str:
    """Break one file or folder of an input."""
    places = sorted(place for place in folder.rglob("*"))
    files = [place for place in places if place.is_file() and not place.is_symlink() and place.stat().st_size < 10**8]
    if not files or not rng.integers(10):
        return another_kind(rng, pick(rng, places)) if places else "nothing there"
    file = pick(rng, files)
    if not rng.integers(12):
        return another_file(rng, file, files)
    kinds: list[Any] = [OF_BYTES]
    if file.suffix in TEXT:
        kinds += [OF_TEXT] * 2
    if file.suffix in OF_FORMAT:
        kinds += [OF_FORMAT[file.suffix]] * 3
    return pick(rng, pick(rng, kinds))(rng, file)


def _neutral(rng: np.random.Generator, folder: Path) -> tuple[str, ...]:
    files = [file for file in sorted(folder.rglob("*")) if file.suffix in NEUTRAL and file.is_file()]
    if not files:
        return ()
    file = pick(rng, files)
    change = pick(rng, NEUTRAL[file.suffix])
    change(rng, file)
    sealed(folder)
    return (f"{file.name}: {change.__name__}",)


def kept(case: Case, folder: Path, corpus: Path) -> str:
    """Write a case and its input as JSON: what differs from its valid input, or all where that is learned."""
    base = corpus / case.seed
    is_whole = SEEDS[case.seed].is_heavy
    theirs = {} if is_whole else {str(each.relative_to(base)): each for each in base.rglob("*")}
    ours = {str(each.relative_to(folder / INPUT)): each for each in sorted((folder / INPUT).rglob("*"))}
    changed: dict[str, Any] = {name: {"gone": True} for name in theirs if name not in ours}
    for name, place in ours.items():
        content = _content(place)
        if name not in theirs or content != _content(theirs[name]):
            changed[name] = content
    return json.dumps({**asdict(case), "is_whole": is_whole, "changed": changed}, indent=1) + "\n"


def remade(file: Path, corpus: Path, folder: Path) -> Case:
    """Make a kept case again in a fresh folder."""
    saved = json.loads(file.read_text(encoding="utf-8"))
    changed, is_whole = saved.pop("changed"), saved.pop("is_whole")
    case = Case(**{**saved, "words": tuple(saved["words"]), "mutations": tuple(saved["mutations"])})
    if is_whole:
        (folder / INPUT).mkdir()
    else:
        shutil.copytree(made(SEEDS[case.seed], corpus), folder / INPUT)
    for name, how in changed.items():
        _put(folder / INPUT / name, how)
    return case


def _content(place: Path) -> dict[str, Any]:
    found = place.lstat()
    if stat.S_ISLNK(found.st_mode):
        return {"link": os.readlink(place)}
    if stat.S_ISFIFO(found.st_mode):
        return {"pipe": True}
    if stat.S_ISDIR(found.st_mode):
        return {"folder": True}
    if found.st_size > 10**9:
        return {"hole": found.st_size}
    data = place.read_bytes()
    if data.isascii() and len(data) < MOST_TEXT:
        return {"text": data.decode()}
    return {"packed": base64.b64encode(zlib.compress(data, 9)).decode()}


def _put(place: Path, how: dict[str, Any]) -> None:
    if place.is_symlink() or place.is_file():
        place.unlink()
    elif place.is_dir() and "folder" not in how:
        shutil.rmtree(place)
    kind, value = next(iter(how.items()))
    if kind == "link":
        place.symlink_to(value)
    elif kind == "pipe":
        os.mkfifo(place)
    elif kind == "folder":
        place.mkdir(exist_ok=True)
    elif kind == "hole":
        with place.open("wb") as file:
            file.truncate(value)
    elif kind != "gone":
        place.write_bytes(value.encode() if kind == "text" else zlib.decompress(base64.b64decode(value)))
