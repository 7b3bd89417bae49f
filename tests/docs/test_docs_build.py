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
from axe import PAGES, faults_of, in_browser
from halfseen import cli

DOCS = Path(__file__).parent.parent.parent / "docs"
# What is run or shown, not imported, has no public names.
PACKAGES = sorted(
    {module.name for module in pkgutil.iter_modules(halfseen.__path__) if module.ispkg} - {"cli", "pages", "report"}
)


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


def test_every_citation_of_a_docstring_is_in_the_bibliography():
    keys = set(re.findall(r"^@\w+\{(\w+),", (DOCS / "references.bib").read_text(encoding="utf-8"), flags=re.MULTILINE))
    source = DOCS.parent / "src"
    cited = {
        key for path in source.rglob("*.py") for key in re.findall(r"\[(\w+)\]_", path.read_text(encoding="utf-8"))
    }
    assert cited
    assert cited <= keys


def test_bibtex_becomes_plain_text():
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
    entry = citations["entries"](bibtex)["Aachen1999"]
    told = "Thomas Gärtner and Miguel A. Hernán (1999). On the Kaplan–Meier curve. *Biometrics*, 3(2), 1–20."
    assert citations["cited"](entry) == told


def test_the_whole_bibliography_is_read():
    citations = runpy.run_path(str(DOCS / "extensions" / "citations.py"))
    bibtex = (DOCS / "references.bib").read_text(encoding="utf-8")
    lines = [citations["cited"](entry) for entry in citations["entries"](bibtex).values()]
    assert len(lines) == len(re.findall(r"^@", bibtex, flags=re.MULTILINE))
    assert not [line for line in lines if re.search(r"[{}\\]|\(\)", line)]


@pytest.mark.slow
def test_the_docs_build_without_warnings_and_hold_every_public_name(built):
    for package in PACKAGES:
        page = (built / "reference" / f"{package}.html").read_text(encoding="utf-8")
        names = importlib.import_module(f"halfseen.{package}").__all__
        assert [name for name in names if f'id="halfseen.{package}.{name}"' not in page] == []


NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.md"))


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_prose_of_a_notebook_tells_no_numbers(notebook):
    _, _, text = notebook.read_text(encoding="utf-8").split("---\n", 2)
    prose = re.sub(
        r"^```.*?^```$|`[^`]+`|\(\.\./[^)]*\)|eq\. 3|\[0, 1\]|95 %", "", text, flags=re.DOTALL | re.MULTILINE | re.I
    )
    assert re.findall(r"\d+", prose) == []


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_a_page_with_what_it_shows_and_can_be_taken_along(built, notebook):
    page = (built / "notebooks" / f"{notebook.stem}.html").read_text(encoding="utf-8")
    num_shown = notebook.read_text(encoding="utf-8").count("SVG(")
    assert num_shown >= 3
    assert len(re.findall(r'<img alt="[^"]{20,}" src="\.\./_images/\w+\.svg"', page)) == num_shown
    assert "Traceback" not in page
    (taken,) = re.findall(r'href="\.\./(_downloads/[^"]+\.md)"', page)
    assert (built / taken).read_bytes() == notebook.read_bytes()


@pytest.mark.slow
def test_every_picture_of_a_page_is_told_in_words_and_no_level_of_headings_is_left_out(built):
    for page in built.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        article = text.split('<article role="main"', 1)[-1].split("</article>", 1)[0]
        assert [image for image in re.findall(r"<img[^>]*>", article) if not re.search(r'alt="[^"]+"', image)] == [], (
            page
        )
        levels = [int(level) for level in re.findall(r"<h([1-6])[ >]", article)]
        assert [pair for pair in itertools.pairwise(levels) if pair[1] > pair[0] + 1] == [], page
        assert 'role="heading"><' not in text


@pytest.mark.slow
def test_a_citation_is_a_link_to_its_entry(built):
    citing = (built / "reference" / "censoring.html").read_text(encoding="utf-8")
    page = (built / "references.html").read_text(encoding="utf-8")
    anchor = re.findall(r'references\.html#([^"]+)"[^>]*><span>\[Cox1972\]', citing)[0]
    entry = page.split(f'id="{anchor}"')[1].split("</div>")[0]
    assert "D. R. Cox (1972). Regression models and life-tables." in entry


@pytest.mark.slow
def test_no_page_loads_anything_from_elsewhere(built):
    loads = re.compile(r"<(?:script|img|iframe)[^>]*\ssrc=\"(?:https?:)?//|<link[^>]*\shref=\"(?:https?:)?//")
    pages = list(built.rglob("*.html"))
    assert len(pages) > len(PACKAGES)
    assert [page.name for page in pages if loads.search(page.read_text(encoding="utf-8"))] == []


@pytest.mark.slow
def test_every_verb_has_a_page_with_all_its_options(built):
    index = html.unescape((built / "reference" / "verbs" / "index.html").read_text(encoding="utf-8"))
    for verb, told in cli.VERBS.items():
        page = html.unescape((built / "reference" / "verbs" / f"{verb}.html").read_text(encoding="utf-8"))
        command = cli.halfseen.get_command(click.Context(cli.halfseen), verb)
        names = [name for param in command.params for name in param.opts if name.startswith("-")]
        assert f"<h1>halfseen {verb}<" in page
        assert [name for name in names if f">{name}<" not in page] == []
        assert told in index


@pytest.mark.slow
def test_no_reference_shows_a_line_break_as_two_characters(built):
    assert [page.name for page in (built / "reference").rglob("*.html") if "\\n" in page.read_text("utf-8")] == []


@in_browser
@pytest.mark.slow
@PAGES
def test_everybody_can_read_the_pages(built, width_px, scheme):
    guide, reference = sorted((built / "guide").glob("*.html")), sorted((built / "reference").rglob("*.html"))
    others = sorted(built.glob("*.html"))
    # One page of the reference is built as another.
    some = reference[:: 4 if scheme == "light" else 8]
    assert faults_of([*others, *guide, *some], width_px, scheme) == []
