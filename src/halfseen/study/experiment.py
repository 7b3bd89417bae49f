"""The interface of experiments: a frozen configuration that repeats, tabulates, draws and states its claims.

A repetition is a pure function of the configuration, the setting, the prepared results and its index. All four can be
pickled, and the result is plain numbers. So repetitions may run in any order, in any process, on any machine.
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

PieceOf = Mapping[str, Any]  # plain numbers, in the form kept between runs


CUT_KIND_NAMES = {
    "independent": "independent cuts",
    "occlusion": "cuts where much is hidden",
    "attempt": "the operator's hand",
}
"""Kind of cut → its name in text."""


class Pieces(NamedTuple):
    """All results of an experiment; `measured` are times on this machine, empty if nothing is measured."""

    prepared: PieceOf
    measured: PieceOf
    repetitions: list[PieceOf]


Row = dict[str, Any]  # row of a table
Tables = dict[str, pd.DataFrame]  # tables by the name of their file


class Drawing(NamedTuple):
    """A figure and its labels.

    `name` is that of its files, `title` states its finding in one sentence, and `draw` draws it with a title, or with
    none if that is empty.
    """

    name: str
    label: str
    title: str
    caption: str
    draw: Callable[[str], Figure]


class Listing(NamedTuple):
    """A table for readers; `groups` are rows by the heading over them, which may be empty."""

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
        """Build a table from rows: `cells` writes the text of each column, and `heading` that over each row."""
        groups: dict[str, list[tuple[str, ...]]] = {}
        for row in rows:
            groups.setdefault(heading(row), []).append(tuple(cell(row) for cell in cells.values()))
        return cls(label, caption, tuple(cells), groups, is_folded)


class Section(NamedTuple):
    """The report of an experiment.

    `sentences` are claims with estimate and test, the most important first; `num_leading` of them appear at the head of
    the report. `opening` is the report's first figure, in at most one section; its title is the sentence beside it.
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

    An experiment that also measures times on this machine has ``measure(setting)``; only these times depend on the
    machine.
    """

    name: ClassVar[str]
    """Name by which it is chosen and its pieces are kept."""

    @property
    def most_repetitions(self) -> int | None:
        """Largest number of repetitions; None for as many as the setting has."""
        ...

    def prepare(self, setting: Setting) -> PieceOf:
        """Compute once what all repetitions need."""
        ...

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Make one repetition."""
        ...

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make the tables."""
        ...

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Report the findings, from the tables alone."""
        ...
