"""What the guide itself says: its code, run as a reader would, and the numbers of its tables."""

import contextlib
import io
import os
import re
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pictures.picture import ROOT

GUIDE = ROOT / "docs" / "guide"
_PYTHON = re.compile(r"^```python\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


def text_of(page: str) -> str:
    """A page of the guide."""
    return (GUIDE / f"{page}.md").read_text(encoding="utf-8")


def names_after(page: str, *blocks: int) -> dict[str, Any]:
    """Run Python blocks of a page, by their number from 0, in an empty folder; the names that they leave behind."""
    code, names = _PYTHON.findall(text_of(page)), {"__name__": "__main__"}
    with _empty_folder(), contextlib.redirect_stdout(io.StringIO()):
        for block in blocks:
            exec(compile(code[block], f"{page}.md", "exec"), names)
    return names


@contextlib.contextmanager
def _empty_folder() -> Iterator[None]:
    before = Path.cwd()
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        Path("examples").symlink_to(ROOT / "examples")
        try:
            yield
        finally:
            os.chdir(before)


def table_of(page: str, below: str) -> list[list[str]]:
    """Cells of the first table below some words of a page, its head first."""
    lines = text_of(page).split(below, 1)[1].splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("|"))
    rows = []
    for line in lines[start:]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return [rows[0], *rows[2:]]


def numbers_in(cell: str) -> list[float]:
    """Numbers of a cell, in which a minus is written as people write it."""
    return [float(number.replace("−", "-")) for number in re.findall(r"[+−-]?\d*\.?\d+", cell.replace(",", ""))]
