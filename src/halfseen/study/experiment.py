"""Experiments: frozen configurations that repeat and tabulate; and the texts that report what they found.

A repetition is a pure function of the configuration, the setting, the prepared results and its index. All four can be
pickled, and the result is plain numbers. So repetitions may run in any order, in any process, on any machine.

A section is declared in TOML: the ``heading``, the ``sentences``, of which as many as ``leading`` open the report,
``claims``, ``phrases`` and ``macros`` for use in texts, ``figures``, ``tables`` for readers, and ``nothing``, the
sentence if there are no tables. ``looks`` has colour and label of each series; markers follow their order.

Texts are templates of Jinja, and rows, cells and sizes are its expressions. Both know the tables by their names, the
``design`` (the experiment), the ``setting``, what ``facts`` returns, ``names``, the claims and the phrases, and the
functions of `halfseen.wording` and `halfseen.study.compare`; cells and headings also know the ``row`` and its columns.
"""

import re
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from typing import Any, ClassVar, NamedTuple, TypeAlias

import jinja2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen import wording
from halfseen.study import compare
from halfseen.study.compare import EFFECT, Frame, Row, gain_in, records
from halfseen.study.figures import draw_figure, looks_of, shades
from halfseen.study.policies import HEURISTICS, STRONGEST_RULE
from halfseen.study.setting import CUT_KIND_NAMES, Setting
from halfseen.wording import Claim

Piece: TypeAlias = Any  # plain numbers, in the form kept between runs
Tables: TypeAlias = dict[str, Frame]  # tables by the name of their file


class Pieces(NamedTuple):
    """All results of an experiment; `measured` are times on this machine, empty if nothing is measured."""

    prepared: Piece
    measured: Piece
    repetitions: list[Piece]

    @property
    def rows(self) -> Frame:
        """The rows of all repetitions, with the number of each."""
        return self.table("rows")

    def table(self, name: str) -> Frame:
        """The rows of a name of all repetitions, with the number of each."""
        pieces = enumerate(self.repetitions)
        return pd.DataFrame([{"repetition": k} | row for k, piece in pieces for row in piece[name]])


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


class Section(NamedTuple):
    """The report of an experiment.

    `sentences` are claims with estimate and test, the most important first; `num_leading` of them appear at the head of
    the report. `opening` is the report's first figure, in at most one section; its title is the sentence beside it.
    """

    heading: str
    sentences: Sequence[str]
    drawings: Sequence[Drawing]
    listings: Sequence[Listing]
    num_leading: int = 1
    opening: Drawing | None = None


@dataclass(frozen=True)
class Experiment(ABC):
    """One question of the study: a frozen dataclass, whose fields are its configuration."""

    name: ClassVar[str]
    """Name by which it is chosen and its pieces are kept."""
    texts: ClassVar[str] = ""
    """TOML of its section of the report; by default the file beside the experiments that has its name."""
    most_repetitions = None
    """Largest number of repetitions, a field of most experiments; None for as many as the setting has."""

    def prepare(self, setting: Setting) -> Piece:
        """Compute once what all repetitions need."""
        return {}

    def measure(self, setting: Setting) -> Piece:
        """Measure times on this machine; only these depend on it."""
        return {}

    @abstractmethod
    def repeat(self, setting: Setting, prepared: Piece, index: int) -> Piece:
        """Make one repetition: its ``rows``, each of plain numbers."""

    @abstractmethod
    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make the tables."""

    def facts(self, setting: Setting, tables: Tables) -> dict[str, Any]:
        """What texts and figures need besides the tables."""
        return {}

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Report the findings, from the tables alone."""
        texts = self.texts or files("halfseen.study.experiments").joinpath(f"{self.name}.toml").read_text("utf-8")
        declared = tomllib.loads(texts)
        if not tables:
            return Section(declared["heading"], (" ".join(declared["nothing"].split()),), (), (), 0)
        return DeclaredSection(declared, self, setting, tables).section()


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined)
    for module in (compare, wording):
        environment.globals |= {name: each for name, each in vars(module).items() if callable(each) or name.isupper()}
    functions = {each.__name__: each for each in (list, max, min, pd.notna, shades)}
    rules = {"rules": [each.name for each in HEURISTICS], "logging_rule": STRONGEST_RULE.label}
    environment.globals |= functions | rules | {"np": np, "CUT_KIND_NAMES": CUT_KIND_NAMES}
    environment.filters |= {name: each for name, each in vars(wording).items() if callable(each)}
    environment.filters["among"] = lambda key, names: names[key]
    return environment


_template = cache(lambda text: _environment().from_string(text))
_expression = cache(lambda text: _environment().compile_expression(text, undefined_to_none=False))


class DeclaredSection:
    """A section of the report: declared texts, claims, figures and tables, filled in."""

    def __init__(self, declared: dict[str, Any], design: Experiment, setting: Setting, tables: Tables) -> None:
        self.declared, self.design, self.setting, self.macros = declared, design, setting, declared.get("macros", "")
        self.known: dict[str, Any] = {"design": design, "setting": setting, "names": declared.get("names", {})} | tables
        self.known["looks"] = looks_of(declared.get("looks", {}), getattr(design, "contenders", {}))
        self.known["labels"] = {name: look["label"] for name, look in self.known["looks"].items()}
        self.known |= design.facts(setting, tables)
        for name, of in declared.get("claims", {}).items():
            self.known[name] = self._claim(of)
        for name, text in declared.get("phrases", {}).items():
            self.known[name] = self.text(text)

    def text(self, text: str, row: Row | None = None) -> str:
        """Fill in a text; its lines are one."""
        return re.sub(r"[ \n]+", " ", _template(self.macros + text).render(self._known_with(row))).strip(" ")

    def value(self, words: Any, row: Row | None = None) -> Any:
        """Evaluate an expression; what is no string is its own value."""
        return _expression(words)(self._known_with(row)) if isinstance(words, str) else words

    def _known_with(self, row: Row | None) -> dict[str, Any]:
        """What is known, and the columns of a row but for those with the name of a function."""
        own = {name: value for name, value in (row or {}).items() if name not in _environment().globals}
        return self.known | own | {"row": row}

    def section(self) -> Section:
        """Fill it in."""
        sentences = [self.text(each) for each in self.declared["sentences"]]
        drawings = [self._drawing(of) for of in self.declared.get("figures", [])]
        listings = [self._listing(of) for of in self.declared.get("tables", [])]
        opening, *others = drawings if drawings and not drawings[0].label else (None, *drawings)
        return Section(self.declared["heading"], sentences, others, listings, self.declared.get("leading", 1), opening)

    def _claim(self, of: dict[str, Any]) -> Claim:
        """A claim: subject, more (the verb), less (its denial), rival, and the row with the columns of its estimate."""
        row, texts = self.value(of["row"]), {"more": "earns more than", "less": "earns less than", "note": ""} | of
        subject, more, less, rival, note = (
            self.text(texts[each], row) for each in ("subject", "more", "less", "rival", "note")
        )
        gain, alpha, decimals = gain_in(row, of.get("columns", EFFECT)), self.setting.alpha, of.get("decimals", 2)
        return Claim(subject, more, less, rival, gain, row.get("p_holm"), alpha, note, decimals)

    def _drawing(self, of: dict[str, Any]) -> Drawing:
        draw = partial(draw_figure, of, self.value, self.text)
        if "draw" in of:
            draw = partial(getattr(self.design, of["draw"]), self.known)
        return Drawing(of["name"], of.get("label", ""), self.text(of["title"]), self.text(of["caption"]), draw)

    def _listing(self, of: dict[str, Any]) -> Listing:
        """A table: a line for each row, or for the rows of the same first cell, side by side along `across`."""
        rows, (first, *others), across = records(self.value(of["rows"])), of["cells"], of.get("across")
        header = dict.fromkeys(self.text(across, row) for row in rows) if across else others
        groups: dict[str, dict[Any, list[str]]] = {}
        for row in rows:
            key, *cells = (str(self.value(each, row)) for each in of["cells"].values())
            lines = groups.setdefault(self.text(of.get("heading", ""), row), {})
            lines.setdefault(key if across else len(lines), [key]).extend(cells)
        written = {heading: [tuple(line) for line in lines.values()] for heading, lines in groups.items()}
        caption = self.text(of.get("caption", ""))
        return Listing(of["label"], caption, (first, *header), written, of.get("folded", True))
