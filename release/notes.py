"""The changelog's entry of a version: what a release says of itself."""

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
    """Notes of a version that is to be released.

    Raises
    ------
    ValueError
        The changelog has no entry of this version, or one without a date or without words.
    """
    date, text = entries(changelog).get(version, ("", ""))
    try:
        datetime.date.fromisoformat(date)
    except ValueError:
        text = ""
    if not text:
        raise ValueError(
            f"CHANGELOG.md: there is no entry `## [{version}] - YYYY-MM-DD` with words below it; write it, commit it, "
            "and tag that"
        )
    return text
