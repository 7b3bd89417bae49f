"""The page of references: every entry of references.bib as a citation, so that ``[Cox1972]_`` is a link."""

import re
import unicodedata
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

BIBLIOGRAPHY = Path(__file__).parent.parent / "references.bib"
ENTRY = re.compile(r"@\w+\{(\w+),(.*?)\n\}", flags=re.DOTALL)
FIELD = re.compile(r"(\w+)\s*=\s*\{(.*)\}")
ACCENT = re.compile(r"\{?\\([\"'`^~])\{?(\w)\}?\}?")
COMBINING = {'"': "\u0308", "'": "\u0301", "`": "\u0300", "^": "\u0302", "~": "\u0303"}


def entries(bibtex: str) -> dict[str, dict[str, str]]:
    """Fields of each entry, in plain characters, by its key; one field a line."""
    return {key: {name: plain(value) for name, value in FIELD.findall(body)} for key, body in ENTRY.findall(bibtex)}


def plain(latex: str) -> str:
    """Turn accents, dashes and braces of BibTeX into characters."""
    accented = ACCENT.sub(lambda match: unicodedata.normalize("NFC", match[2] + COMBINING[match[1]]), latex)
    return accented.replace("---", "—").replace("--", "–").replace("{", "").replace("}", "")


def cited(entry: dict[str, str]) -> str:
    """One entry as a line of reST."""
    names = [" ".join(reversed(name.split(", ", 1))) for name in entry["author"].split(" and ")]
    authors = " and ".join([", ".join(names[:-1])] * (len(names) > 1) + names[-1:])
    numbers = entry.get("volume", "") + (f"({entry['number']})" if "number" in entry else "")
    place = [entry[field] for field in ("journal", "booktitle", "series") if field in entry]
    tail = [numbers, entry.get("pages", ""), *(entry.get(field, "") for field in ("publisher", "institution", "note"))]
    where = ", ".join([f"*{name}*" for name in place] + [part for part in tail if part])
    return f"{authors} ({entry['year']}). {entry['title']}. {where}."


class References(SphinxDirective):
    """``.. references::`` lists the whole bibliography, by key."""

    def run(self) -> list[nodes.Node]:
        """Parse the citations where the directive stands."""
        self.env.note_dependency(str(BIBLIOGRAPHY))
        # The backslash keeps an author's initial from being read as the number of a list.
        found = entries(BIBLIOGRAPHY.read_text(encoding="utf-8"))
        return self.parse_text_to_nodes("\n".join(rf".. [{key}] \{cited(found[key])}" for key in sorted(found)))


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx of the directive."""
    app.add_directive("references", References)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
