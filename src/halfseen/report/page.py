"""The page: findings in, HTML out; it stands alone, without scripts or anything to load."""

from pathlib import Path

from halfseen.errors import ArgumentError
from halfseen.pages.html import rendered
from halfseen.pages.numbers import percent, significant, with_interval
from halfseen.pages.sentences import as_sentence, counted, listed
from halfseen.report.content import content_of
from halfseen.report.findings import Findings
from halfseen.report.units import labelled
from halfseen.writing import refuse_unwritable, write_file

MARK = '<meta name="generator" content="halfseen report">'
MARKED_CHARS = 1000


def page_of(findings: Findings, command: str) -> str:
    """Write the page, which tells the command that makes it again."""
    functions = (significant, with_interval, percent, listed, counted, as_sentence, labelled)
    return rendered(
        "halfseen.report",
        "page.html.j2",
        {"mark": MARK, **content_of(findings, command)},
        **{each.__name__: each for each in functions},
    )


def check_page_target(file: Path, overwrite: bool) -> None:
    """Refuse a file that the page cannot be written to or that is no such page; call it before long work."""
    refuse_unwritable(file.parent)
    try:
        if not (file.exists() or file.is_symlink()):
            return
        if not overwrite:
            raise ArgumentError(f"{file}: it is there already; choose another file, or pass --overwrite to replace it")
        if not file.is_file() or MARK not in file.read_bytes()[:MARKED_CHARS].decode(errors="replace"):
            raise ArgumentError(f"{file}: it is no page of halfseen report, so it is not replaced; choose another file")
    except OSError as error:
        raise ArgumentError(f"{file}: it cannot be written ({error.strerror}); choose another file") from error


def write_page(page: str, file: Path, *, overwrite: bool = False) -> None:
    """Write the page so that it appears whole or not at all.

    Raises
    ------
    ArgumentError
        The file is there already, is no page of this kind, or cannot be written.
    """
    check_page_target(file, overwrite)
    write_file(file, page)
