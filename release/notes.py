"""The changelog's entry of a version, and what a version lacks before it can be released."""

import datetime
import re

HEADING = re.compile(r"^## \[([^\]]+)\](?: - (\S+))?$", re.MULTILINE)


def entries(changelog: str) -> dict[str, tuple[str, str]]:
    """Date and text of each version, by its name; `Unreleased` has no date.

    Parameters
    ----------
    changelog
        Text in the style of Keep a Changelog.
    """
    _, *parts = HEADING.split(changelog)
    return {
        name: (date or "", text.strip()) for name, date, text in zip(parts[::3], parts[1::3], parts[2::3], strict=True)
    }


def notes_of(version: str, changelog: str) -> str:
    """Notes of a version: its entry, or of a version in development what is unreleased."""
    sections = entries(changelog)
    return sections.get(version, sections["Unreleased"])[1]


def lacks(version: str, said: dict[str, str], changelog: str, cited_day: str | None) -> list[str]:
    """Say what is to be done before a version can be released; nothing where it can be.

    Parameters
    ----------
    version
        What the source says, such as 0.2.0, or 0.2.0.dev0 while it is made.
    said
        Version by each other file that says one.
    changelog
        Text in the style of Keep a Changelog.
    cited_day
        The day that CITATION.cff says; None where it says none.
    """
    released = version.partition(".dev")[0]
    sections = entries(changelog)
    date, text = sections.get(released, ("", ""))
    steps = [
        f"set {released} in {file} (it says {says})"
        for file, says in {"src/halfseen/__init__.py": version, **said}.items()
        if says != released
    ]
    if not _is_day(date) or not text:
        steps.append(f"write `## [{released}] - YYYY-MM-DD` with words below it in CHANGELOG.md")
    if cited_day is None or cited_day != date:
        steps.append(f"write `date-released: {date or 'YYYY-MM-DD'}` in CITATION.cff (it says {cited_day or 'none'})")
    if sections["Unreleased"][1]:
        steps.append(f"move the words below [Unreleased] to [{released}]")
    return steps


def _is_day(date: str) -> bool:
    try:
        datetime.date.fromisoformat(date)
    except ValueError:
        return False
    return True
