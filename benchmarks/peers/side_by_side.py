"""What every benchmark of `published/` asks for, stores and prints: numbers of a paper, ours, and a peer's."""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from halfseen.writing import write_file

RESULTS = Path(__file__).parents[1] / "published" / "results"
VERSIONS = ("halfseen", "numpy", "scikit-learn", "scikit-survival")
SKIPPED = 3
"""Exit status of a benchmark whose package is not installed; `make published` goes on."""


def skip(why: str) -> NoReturn:
    """Say what is not installed, and leave the results that are kept as they are."""
    print(why, file=sys.stderr)
    sys.exit(SKIPPED)


def asked(doc: str | None, name: str, repetitions: int) -> argparse.ArgumentParser:
    """A parser of what all have in common: where to store, and how often to repeat."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS / f"{name}.json", help="results (%(default)s)")
    parser.add_argument("--repetitions", type=int, default=repetitions, help="logs of each cell (%(default)s)")
    return parser


def run(
    out: Path,
    cells: Sequence[Any],
    measured: Callable[..., Mapping[str, Any]],
    tables: Callable[[Any], str],
    **facts: Any,
) -> None:
    """Measure cell by cell, store what was found so far with the versions that made it, and print its tables."""
    report = {**facts, "versions": {name: version(name) for name in VERSIONS}, "rows": []}
    with threadpool_limits(1):
        for cell in tqdm(cells, desc="cells", disable=None, leave=False):
            report["rows"].append(measured(*cell))
            write_file(out, json.dumps(report, indent=1, ensure_ascii=False) + "\n")
    print(tables(report))


def stored(name: str) -> dict[str, Any]:
    """The results that are kept of a benchmark."""
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; all but the first column are aligned to the right."""
    lines = [head, [":--", *["--:"] * (len(head) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def mean_and_error(values: Float[Any, " R"]) -> tuple[float, float]:
    """Mean over repetitions, and its standard error (0 for one)."""
    each = np.asarray(values, dtype=float)
    return float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each))) if len(each) > 1 else 0.0


def with_error(values: Float[Any, " R"], digits: int = 3) -> str:
    """Mean ± standard error."""
    mean, error = mean_and_error(values)
    return f"{mean:.{digits}f} ± {error:.{digits}f}".replace("-", "−")
