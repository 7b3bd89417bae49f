"""What a picture is: where it lies, what draws it, and the numbers that it is drawn from."""

import csv
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from halfseen.figures import drawn
from halfseen.writing import write_file

ROOT = Path(__file__).parents[2]
NUMBERS = Path(__file__).parent / "numbers"

Row = dict[str, Any]
Table = list[Row]


@dataclass(frozen=True)
class Numbers:
    """A table that takes long to compute, and is kept beside the code that draws it.

    Parameters
    ----------
    file
        Its name in `numbers/`.
    compute
        Makes the whole table, however long that takes.
    check
        Computes a part of it again within about a minute: rows as they ought to be, by their index in the table.
    """

    file: str
    compute: Callable[[], Table]
    check: Callable[[], Mapping[int, Row]]

    def read(self) -> Table:
        """The table as it is kept; what looks like a number is one."""
        with (NUMBERS / self.file).open(encoding="utf-8", newline="") as file:
            return [{name: _value(text) for name, text in row.items()} for row in csv.DictReader(file)]

    def write(self, table: Table) -> None:
        """Keep a table."""
        lines = [",".join(table[0])]
        lines += [",".join(_text(value) for value in row.values()) for row in table]
        write_file(NUMBERS / self.file, "\n".join(lines) + "\n")


def whole(file: str, compute: Callable[[], Table]) -> Numbers:
    """Numbers that are made again as a whole within a minute."""
    return Numbers(file, compute, lambda: dict(enumerate(compute())))


def _value(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def _text(value: Any) -> str:
    text = repr(float(value)) if isinstance(value, float) else str(value)
    return json.dumps(text).replace('\\"', '""') if set(text) & set(',"\n') else text


@dataclass(frozen=True)
class Picture:
    """A picture that README or docs show.

    Parameters
    ----------
    name
        By which it is asked for; the name of its file without the ending.
    file
        Where it lies, from the root of the repository.
    draw
        Draws it, as bytes.
    numbers
        What it is drawn from, where that takes long.
    seconds
        How long drawing takes, roughly [s].
    """

    name: str
    file: str
    draw: Callable[[], bytes]
    numbers: Numbers | None = None
    seconds: float = 1.0

    @property
    def path(self) -> Path:
        """Where it lies."""
        return ROOT / self.file

    @property
    def remedy(self) -> str:
        """What to run where it is stale."""
        return f"{self.file} is stale: run make pictures ONLY={self.name}"

    def make(self, is_anew: bool = False) -> None:
        """Draw it into its file; where asked, or where they are not there, compute its numbers first."""
        if self.numbers is not None and (is_anew or not (NUMBERS / self.numbers.file).exists()):
            self.numbers.write(self.numbers.compute())
        write_file(self.path, self.draw())


def plot(
    name: str, figure_of: Callable[..., Figure], numbers: Numbers | None = None, seconds: float = 1.0, kind: str = "svg"
) -> Picture:
    """A figure of the guide, drawn from its numbers, if it has any, by `figure_of`."""

    def draw() -> bytes:
        return drawn(figure_of if numbers is None else partial(figure_of, numbers.read()), kind)

    return Picture(name, f"docs/static/guide/{name}.{kind}", draw, numbers, seconds)
