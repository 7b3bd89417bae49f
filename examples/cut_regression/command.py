"""What the scripts share: their options, and the way from a comparison to table, sentence and figure."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from cut_regression.comparison import Comparison, compare
from cut_regression.figures import write_png
from cut_regression.methods import REG
from cut_regression.settings import Setting
from cut_regression.words import sentence, table


def run(
    name: str,
    about: str | None,
    settings: Sequence[Setting],
    sizes: Sequence[int],
    num_repetitions: int,
    pairs: Sequence[tuple[str, str]],
    draw: Callable[[Comparison], Figure],
    arguments: Sequence[str] | None = None,
) -> None:
    """Read the options, compare, print the table and the sentence, and draw the figure.

    Parameters
    ----------
    name
        Of the script, and so of the figure.
    about
        Help text.
    settings, sizes, num_repetitions
        What is compared, unless the options say otherwise.
    pairs
        Methods that the sentence compares.
    draw
        Makes the figure.
    arguments
        Options; those of the command line by default.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/examples"), help="folder of the figure (%(default)s)")
    parser.add_argument("--repetitions", type=_positive, default=num_repetitions, help="samples (%(default)s)")
    parser.add_argument("--rows", type=_rows, nargs="+", default=list(sizes), help="rows of a sample (%(default)s)")
    parser.add_argument("--seed", type=_whole, default=0, help="seed (%(default)s)")
    parser.add_argument("--reg", type=_reg, default=REG, help="λ of all SVMs, or cv: each its own (%(default)s)")
    options = parser.parse_args(arguments)
    comparison = compare(settings, sorted(set(options.rows)), options.repetitions, options.seed, options.reg)
    print(table(comparison))
    print(sentence(comparison, pairs))
    path = options.out / f"{name}.png"
    write_png(draw, comparison, path)
    print(f"Figure: {path}")


def _whole(text: str, least: int = 0) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number ≥ {least}")
    return value


def _positive(text: str) -> int:
    return _whole(text, 1)


def _reg(text: str) -> float | str:
    if text == "cv":
        return text
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number > 0 nor cv")
    return value


def _rows(text: str) -> int:
    """Fewer rows may leave none in a fold."""
    return _whole(text, 50)
