import html
import importlib
import itertools
import pkgutil
import re
import runpy
import subprocess
import sys
from pathlib import Path

import click
import pytest

import halfseen
from chromium import PAGES, faults_of, in_browser
from halfseen import cli

DOCS = Path(__file__).parent.parent.parent / "docs"
# What is run or shown, not imported, has no public names.
PACKAGES = sorted({module.name for module in pkgutil.iter_modules(halfseen.__path__) if module.ispkg} - {"cli"})


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("docs")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "-d", out / "trees", DOCS, out]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return out


def test_every_package_has_a_page_of_the_reference():
    pages = {page.stem: page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md")}
    for package in PACKAGES:
        assert f"public-names:: halfseen.{package}\n" in pages[package]
        assert f"\n{package}\n" in pages["index"]


def test_bibtex_becomes_plain_text_and_the_bibliography_holds_every_citation_of_a_docstring():
    citations = runpy.run_path(str(DOCS / "extensions" / "citations.py"))
    bibtex = r"""@article{Aachen1999,
  author  = {G{\"a}rtner, Thomas and Hern{\'a}n, Miguel A.},
  title   = {On the {Kaplan--Meier} curve},
  journal = {Biometrics},
  volume  = {3},
  number  = {2},
  pages   = {1--20},
  year    = {1999},
}"""
    message = "Thomas Gärtner and Miguel A. Hernán (1999). On the Kaplan–Meier curve. *Biometrics*, 3(2), 1–20."
    assert citations["cited"](citations["entries"](bibtex)["Aachen1999"]) == message
    bibtex = (DOCS / "references.bib").read_text(encoding="utf-8")
    entries = citations["entries"](bibtex)
    assert len(entries) == len(re.findall(r"^@", bibtex, flags=re.MULTILINE))
    assert not [e for e in entries.values() if re.search(r"[{}\\]|\(\)", citations["cited"](e))]
    sources = (path.read_text(encoding="utf-8") for path in (DOCS.parent / "src").rglob("*.py"))
    cited = {key for source in sources for key in re.findall(r"\[(\w+)\]_", source)}
    assert cited
    assert cited <= set(entries)


@pytest.mark.slow
def test_the_docs_build_without_warnings_and_hold_every_public_name_every_verb_and_what_notebooks_show(built):
    for package in PACKAGES:
        page = (built / "reference" / f"{package}.html").read_text(encoding="utf-8")
        names = importlib.import_module(f"halfseen.{package}").__all__
        assert [name for name in names if f'id="halfseen.{package}.{name}"' not in page] == []
    verbs = built / "reference" / "verbs"
    index = html.unescape((verbs / "index.html").read_text(encoding="utf-8"))
    for verb, result in cli.VERBS.items():
        page = html.unescape((verbs / f"{verb}.html").read_text(encoding="utf-8"))
        command = cli.halfseen.get_command(click.Context(cli.halfseen), verb)
        names = [name for param in command.params for name in param.opts if name.startswith("-")]
        assert f"<h1>halfseen {verb}<" in page
        assert [name for name in names if f">{name}<" not in page] == []
        assert result in index
    for notebook in NOTEBOOKS:
        page = (built / "notebooks" / f"{notebook.stem}.html").read_text(encoding="utf-8")
        shown = re.findall(r'<img alt="[^"]{20,}" src="\.\./_images/\w+\.svg"', page)
        assert len(shown) == notebook.read_text(encoding="utf-8").count("SVG(") >= 2, notebook
        assert "Traceback" not in page, notebook


NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.md"))


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_prose_of_a_notebook_tells_no_numbers(notebook):
    _, _, text = notebook.read_text(encoding="utf-8").split("---\n", 2)
    prose = re.sub(
        r"^```.*?^```$|`[^`]+`|\(\.\./[^)]*\)|eq\. 3|\[0, 1\]|95 %", "", text, flags=re.DOTALL | re.MULTILINE | re.I
    )
    assert re.findall(r"\d+", prose) == []


@pytest.mark.slow
def test_every_page_tells_its_pictures_in_words_leaves_no_heading_out_and_loads_nothing_from_elsewhere(built):
    loads = re.compile(r"<(?:script|img|iframe)[^>]*\ssrc=\"(?:https?:)?//|<link[^>]*\shref=\"(?:https?:)?//")
    pages = list(built.rglob("*.html"))
    assert len(pages) > len(PACKAGES)
    for page in pages:
        text = page.read_text(encoding="utf-8")
        article = text.split('<article role="main"', 1)[-1].split("</article>", 1)[0]
        images = re.findall(r"<img[^>]*>", article)
        levels = [int(level) for level in re.findall(r"<h([1-6])[ >]", article)]
        assert [image for image in images if not re.search(r'alt="[^"]+"', image)] == [], page
        assert [pair for pair in itertools.pairwise(levels) if pair[1] > pair[0] + 1] == [], page
        assert 'role="heading"><' not in text
        assert not loads.search(text), page
        assert "reference" not in page.parts or "\\n" not in text, page


@in_browser
@pytest.mark.slow
@PAGES
def test_everybody_can_read_the_pages(built, width_px, scheme):
    guide, others = (
        sorted((built / "guide").glob("*.html")),
        sorted({*built.glob("*.html")} - {built / "genindex.html"}),
    )
    # One page of the reference is built as another; axe takes ten seconds for a long one, and for the index.
    reference = sorted((built / "reference").rglob("*.html"), key=lambda page: page.stat().st_size)
    some = [*guide, *reference[: len(reference) // 2 : 2]]
    assert faults_of([*others, *some[:: 1 if scheme == "light" else 2]], width_px, scheme) == []
