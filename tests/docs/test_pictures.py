"""Every picture of README and docs has an entry, is what that draws, and rests on numbers that can be made again."""

import io
import re
import tomllib
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path
from PIL import Image, ImageSequence

from halfseen.cell import film
from halfseen.cli import VERBS
from halfseen.cli.messages import EXTRAS
from halfseen.figures import drawn
from pictures import way_of_the_data
from pictures.films import FILMS
from pictures.likeness import are_alike
from pictures.page_figures import ASKS_FOR
from pictures.picture import NUMBERS, ROOT
from pictures.registry import PICTURES
from pictures.study_figure import FIGURE1_NUMBERS
from pictures.style import panel

DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *(page for page in DOCS.rglob("*.md") if "verbs" not in page.parts)]
MOST_BYTES = 150_000
LONG_S = 5.0


def shown_in(page):
    """Pictures of a page as (alternative text, file)."""
    text = page.read_text(encoding="utf-8")
    found = re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", text)
    assert len(found) == text.count("!["), page
    return [(alt, (page.parent / file).resolve()) for alt, file in found]


def test_every_picture_that_is_shown_has_an_entry_and_every_entry_is_shown():
    entries = {picture.path for picture in PICTURES}
    assert {file for page in PAGES for _, file in shown_in(page)} == entries
    assert len({picture.name for picture in PICTURES}) == len(PICTURES)
    assert [picture.name for picture in PICTURES if picture.path.stem != picture.name] == []
    assert {file.name for file in (DOCS / "static" / "guide").iterdir()} <= {file.name for file in entries}
    assert [p.file for p in PICTURES if "guide" in p.file and p.path.stat().st_size > MOST_BYTES] == []
    drawn_from = {picture.numbers.file for picture in PICTURES if picture.numbers is not None}
    assert {file.name for file in NUMBERS.iterdir() if not file.name.startswith("study-")} == drawn_from


def test_every_page_of_the_guide_shows_a_picture_and_says_in_words_what_is_seen():
    assert [page for page in (DOCS / "guide").glob("*.md") if not shown_in(page)] == []
    assert [(page, alt) for page in PAGES for alt, _ in shown_in(page) if len(alt) < 20] == []


# A film needs OpenGL and minutes: what it shows is held against its numbers below.
DRAWN = [
    pytest.param(each, id=each.name, marks=[pytest.mark.slow] if each.seconds > LONG_S else [])
    for each in PICTURES
    if each not in FILMS
]


@pytest.mark.slow
@pytest.mark.parametrize("picture", DRAWN)
def test_a_picture_is_what_its_entry_draws(picture):
    assert are_alike(picture.path.read_bytes(), picture.draw()), picture.remedy


# Two pictures may be drawn from the same numbers.
NUMBERED = {picture.numbers.file: picture for picture in PICTURES if picture.numbers is not None}


@pytest.mark.slow
@pytest.mark.parametrize("picture", [pytest.param(each, id=each.name) for each in NUMBERED.values()])
def test_a_part_of_the_numbers_of_a_picture_is_the_same_again(picture):
    kept = picture.numbers.read()
    found = picture.numbers.check()
    assert found
    for index, row in found.items():
        for name, value in row.items():
            message = f"{picture.remedy} REMAKE=1 ({picture.numbers.file}, row {index}: {name})"
            if isinstance(value, int | float):
                # Where a processor rounds otherwise, an episode in some thousand goes another way.
                near = max(1e-3, 0.25 * float(row.get("se", 0.0)))
                assert kept[index][name] == pytest.approx(value, rel=1e-3, abs=near), message
            else:
                words, numbers = apart(value)
                assert apart(kept[index][name]) == (words, pytest.approx(numbers, rel=0.01)), message


def apart(sentence):
    """Words of a sentence, and its numbers, of which seconds of an arm differ a little where others round."""
    number = r"\d+(?:\.\d+)?"
    return re.split(number, sentence), [float(each) for each in re.findall(number, sentence)]


def test_figure_1_has_the_means_of_its_repetitions():
    each, drawn_from = pd.DataFrame(FIGURE1_NUMBERS.read()), pd.read_csv(NUMBERS / "study-figure1.csv")
    of_each, of_all = (rows[rows["policy"] == "censored_q"] for rows in (each, drawn_from))
    means = of_each.groupby(["num_trajectories", "cut_share"])["reward"].mean()
    rows = of_all.set_index(["num_trajectories", "cut_share"])["mean_reward"].sort_index()
    assert len(means) == len(rows) == 24
    np.testing.assert_allclose(means, rows, rtol=1e-12)


def captions(gif):
    """What stands below the pictures of a film, as the rows of pixels that hold it, one for each change."""
    strips = []
    with Image.open(io.BytesIO(gif)) as image:
        for frame in ImageSequence.Iterator(image):
            strips.append(np.asarray(frame.convert("L"), dtype=np.int16)[-film._CAPTION_PX :])
    return strips


@pytest.mark.parametrize("picture", [pytest.param(each, id=each.name) for each in FILMS])
def test_below_a_film_stand_the_decisions_that_its_numbers_tell(picture):
    strips = captions(picture.path.read_bytes())
    blank = np.zeros((1, strips[0].shape[1], 3), dtype=np.uint8)
    result = ["", *(row["words"] for row in picture.numbers.read() if row["stage"])]
    written = [np.asarray(film._captioned(blank, words).convert("L"), dtype=np.int16)[1:] for words in result]
    seen = [int(np.argmin([np.abs(strip - each).mean() for each in written])) for strip in strips]
    # The first words are never seen alone where the first decision falls before the first picture.
    assert seen == sorted(seen), picture.remedy
    assert set(seen) | {0} == set(range(len(result))), picture.remedy
    assert max(np.abs(strip - written[k]).max() for strip, k in zip(strips, seen, strict=True)) < 64, picture.remedy


@pytest.mark.slow
def test_pictures_are_alike_where_nobody_sees_a_difference():
    def a_line(height=1.0, words="a line"):
        def figure_of():
            made, axes = panel(2.0, words)
            axes.plot([0.0, 1.0], [0.0, height])
            axes.set_ylim(0.0, 2.0)
            return made

        return figure_of

    for kind in ("svg", "png"):
        kept = drawn(a_line(), kind)
        assert are_alike(kept, drawn(a_line(1.0 + 1e-6), kind))
        assert not are_alike(kept, drawn(a_line(1.3), kind))
        assert not are_alike(kept, drawn(a_line(words="another line"), kind))


def test_words_on_one_line_of_the_folders_do_not_run_into_one_another():
    result = re.compile(r'<text x="([\d.]+)" y="([\d.]+)" font-size="([\d.]+)" fill="[^"]+"([^>]*)>([^<]+)<')
    lines = {}
    for x, y, size, more, words in result.findall(way_of_the_data.draw().decode()):
        font = FontProperties(family="DejaVu Sans", size=float(size), weight="bold" if "700" in more else "normal")
        width = text_to_path.get_text_width_height_descent(words, font, False)[0]
        begin = float(x) - (width if 'text-anchor="end"' in more else 0.0)
        lines.setdefault(y, []).append((begin, begin + width, words))
    for line in lines.values():
        for one, other in pairwise(sorted(line)):
            assert one[1] < other[0], (one, other)


def test_boxes_are_folders_of_the_package_and_commands_ask_for_extras_that_there_are():
    assert all((ROOT / "src" / "halfseen" / name).is_dir() for name in way_of_the_data.folders())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = {name for names in ASKS_FOR.values() for name in names}
    assert set(ASKS_FOR) <= set(VERBS)
    assert asked | {"gym", "jax", "pettingzoo"} == set(EXTRAS)
    assert set(EXTRAS) | {"all", "docs", "dev", "release"} == set(project["optional-dependencies"])
