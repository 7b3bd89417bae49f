"""Names that differ only in spelling.

Spelling is capitals, separators, characters without width, how Unicode composes a letter, and Cyrillic letters that
look like Latin ones. Signs, spaces between digits and decimal points are significant: ``-x`` is not ``+x``, ``2.5`` is
not ``25``, and ``slot 1 2`` is not ``slot 12``.
"""

import re
from collections.abc import Iterable
from unicodedata import normalize

DASHES = re.compile("[\u2010-\u2015\u2212\ufe63\uff0d]")
_WITHOUT_WIDTH = re.compile("[\u00ad\u200b-\u200f\u2060\ufeff]")
_LATIN = str.maketrans("авекмнорстухіјѕ", "abekmhopctyxijs")
"""Cyrillic letters, in lower case, that look like Latin ones, some as capitals alone."""
_SEPARATORS = re.compile(
    r"""
      (?<=[^\W\d_])-(?=[^\W\d_])      # e-stop
    | [\s_]+-[\s_]+                   # pick - left
    | (?<!\d)[\s_]+ | [\s_]+(?!\d)    # no space between digits
    | [.,:;/'"()\[\]](?!\d)           # no decimal point
    """,
    re.VERBOSE,
)


def as_counted(name: str) -> tuple[tuple[int, str], ...]:
    """Sort key of a name that compares its numbers as numbers: part 2 comes before part 10."""
    return tuple((int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name))


def folded(name: str) -> str:
    """Remove from a name what is only spelling."""
    text = DASHES.sub("-", composed(composed(_WITHOUT_WIDTH.sub("", name)).casefold()).translate(_LATIN))
    return re.sub(r"[\s_]+", " ", _SEPARATORS.sub("", text)) or text


def composed(name: str) -> str:
    """Bring a name into Unicode's composed form, in which é is one character."""
    return normalize("NFC", name)


def alike(names: Iterable[object]) -> list[list[str]]:
    """Group the names that differ only in spelling; each group has two or more, in order."""
    groups: dict[str, list[str]] = {}
    for name in sorted(set(map(str, names))):
        groups.setdefault(folded(name), []).append(name)
    return [same for same in groups.values() if len(same) > 1]


def spelled_out(names: list[str]) -> list[str]:
    """Write names so that their difference is visible: by code points where they look the same."""
    same = len({composed(name).casefold().translate(_LATIN) for name in names}) < len({*map(str.casefold, names)})
    return [ascii(name) if same else repr(name) for name in names]
