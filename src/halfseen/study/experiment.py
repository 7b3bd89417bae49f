"""What an experiment is: a frozen configuration that repeats, tabulates, draws and says what it claims.

A repetition is a pure function of the configuration, the setting, what was prepared once and its number; all four can
be pickled, and what it returns is plain numbers. So repetitions may run in any order, in any process, on any machine.
"""

import tomllib
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jinja2
import pandas as pd
from matplotlib.figure import Figure

from halfseen import wording
from halfseen.study.setting import Setting

PieceOf = Mapping[str, Any]  # plain numbers, as they are kept between runs


CUT_KIND_NAMES = {
    "independent": "independent cuts",
    "occlusion": "cuts where much is hidden",
    "attempt": "the operator's hand",
}
"""Kind of cut → name for people."""


class Pieces(NamedTuple):
    """All that an experiment brought; `measured` are times on this machine, empty where nothing is measured."""

    prepared: PieceOf
    measured: PieceOf
    repetitions: list[PieceOf]


Row = dict[str, Any]  # row of a table
Tables = dict[str, pd.DataFrame]  # tables by the name of their file


class Drawing(NamedTuple):
    """A figure and what stands beside it.

    `name` is that of its files, `title` says what it shows in one sentence, and `draw` draws it under a title, or under
    none if that is empty.
    """

    name: str
    label: str
    title: str
    caption: str
    draw: Callable[[str], Figure]


class Listing(NamedTuple):
    """A table for people; `groups` are rows by the heading over them, which may be empty."""

    label: str
    caption: str
    header: tuple[str, ...]
    groups: Mapping[str, list[tuple[str, ...]]]
    is_folded: bool = True

    @classmethod
    def of(
        cls,
        label: str,
        caption: str,
        rows: Iterable[Row],
        cells: Mapping[str, Callable[[Row], str]],
        heading: Callable[[Row], str] = lambda row: "",
        is_folded: bool = True,
    ) -> "Listing":
        """Write rows, of each the cells that stand under the names of the header, and the heading over it."""
        groups: dict[str, list[tuple[str, ...]]] = {}
        for row in rows:
            groups.setdefault(heading(row), []).append(tuple(cell(row) for cell in cells.values()))
        return cls(label, caption, tuple(cells), groups, is_folded)


class Section(NamedTuple):
    """What an experiment says.

    `sentences` are claims with estimate and test, the most important first; `num_leading` of them stand at the head of
    the report. It opens with `opening`, of one section at most, whose title is the sentence beside it.
    """

    heading: str
    sentences: tuple[str, ...]
    drawings: tuple[Drawing, ...]
    listings: tuple[Listing, ...]
    num_leading: int = 1
    opening: Drawing | None = None


@cache
def _texts() -> dict[str, dict[str, jinja2.Template]]:
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined)
    environment.globals.update({name: each for name, each in vars(wording).items() if callable(each)})
    texts = tomllib.loads(files("halfseen.study").joinpath("words.toml").read_text(encoding="utf-8"))
    return {
        experiment: {name: environment.from_string(text.replace("\n", " ")) for name, text in of.items()}
        for experiment, of in texts.items()
    }


def words(experiment: str, text: str, **facts: Any) -> str:
    """Fill in a text of words.toml, which may use the functions of `halfseen.wording`."""
    return _texts()[experiment][text].render(facts)


@runtime_checkable
class Experiment(Protocol):
    """One question of the study.

    One that also measures times on this machine has ``measure(setting)``; nothing but these times depends on them.
    """

    name: ClassVar[str]
    """Under which it is chosen and its pieces are kept."""

    @property
    def most_repetitions(self) -> int | None:
        """Repetitions at most; None: as many as the setting has."""
        ...

    def prepare(self, setting: Setting) -> PieceOf:
        """Find out once what all repetitions need."""
        ...

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Make one repetition."""
        ...

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make the tables."""
        ...

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say what was found, from the tables alone."""
        ...
