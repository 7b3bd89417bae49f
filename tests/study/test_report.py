import re
from dataclasses import fields, replace
from html.parser import HTMLParser
from io import BytesIO

import numpy as np
import pytest
from example_results import example_results
from matplotlib.figure import Figure

from halfseen.errors import ArgumentError
from halfseen.study.design import StudyDesign
from halfseen.study.map_cells import MapDesign
from halfseen.study.report import DESIGN_WORDS, MAP_WORDS, WORLD_WORDS, write_report
from halfseen.world.config import WorldConfig
from halfseen.world.scene import Scene

VOID = {"meta", "img", "br", "hr", "link", "input"}


class Page(HTMLParser):
    """Tags in order, ids, and everything that an attribute points at; fails where tags do not nest."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.ids, self.targets = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.ids += [value for name, value in attrs if name == "id"]
        self.targets += [value for name, value in attrs if name in ("href", "src", "srcset", "data", "action")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def results():
    return example_results()


@pytest.fixture(scope="module")
def pictures(results):
    buffer = BytesIO()
    Figure(figsize=(1, 1)).savefig(buffer, format="png")
    return {scene.name: buffer.getvalue() for scene in results.scenes}


@pytest.fixture(scope="module")
def text(results, pictures, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    write_report(results, pictures, folder)
    assert [path.name for path in folder.iterdir()] == ["report.html"]
    return (folder / "report.html").read_text(encoding="utf-8")


def written(results, tmp_path):
    write_report(results, {}, tmp_path)
    return (tmp_path / "report.html").read_text(encoding="utf-8")


def test_page_is_whole(text):
    page = Page(text)
    assert page.tags.count("main") == page.tags.count("h1") == 1
    assert page.tags.count("svg") == 7
    assert page.tags.count("img") == 10


def test_ids_are_unique_and_every_link_has_its_target(text):
    page = Page(text)
    assert len(page.ids) == len(set(page.ids))
    inner = {target[1:] for target in page.targets if target.startswith("#")}
    inner |= set(re.findall(r"url\(#([^)]*)\)", text))
    assert inner
    assert inner <= set(page.ids)


def test_page_loads_and_runs_nothing(text):
    page = Page(text)
    assert all(target.startswith(("#", "data:image/png;base64,")) for target in page.targets)
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
    without_pictures = re.sub(r"data:image/png;base64,[^\"]*", "", text)
    assert "http" not in without_pictures
    assert "@import" not in without_pictures
    assert not re.search(r"url\((?!#)", without_pictures)


def test_same_results_same_bytes(results, pictures, tmp_path, text):
    write_report(results, pictures, tmp_path)
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == text


def test_answer_comes_first(results, text):
    places = [text.index(sentence.replace("'", "&#39;")) for sentence in results.sentences]
    assert places == sorted(places)
    assert places[-1] < text.index("<svg")


def test_unsupported_claims_are_called_so_and_no_others(results, tmp_path, text):
    claims = [*results.table1["supported"], *results.grasp_tests["supported"]]
    assert text.count(">not supported<") == claims.count(False)
    assert text.count(">supported<") == claims.count(True)

    def all_are(supported):
        tables = {name: getattr(results, name).assign(supported=supported) for name in ("table1", "grasp_tests")}
        return replace(results, **tables)

    assert written(all_are(False), tmp_path).count(">not supported<") == len(claims)
    every = all_are(True)
    assert ">not supported<" not in written(every, tmp_path)


def test_numbers_of_the_tables_are_there(text):
    for words in (
        "4.8 × 10⁻⁷",
        "&gt; 0.99",
        "greedy with history",
        "time of one decision [ms]".capitalize(),
        "α = 0.01",
    ):
        assert words in text
    assert "adjusted the 15 p-values" in text


def test_missing_numbers_are_dashes(results, tmp_path):
    table1 = results.table1.assign(p_value=np.nan, p_holm=np.nan, effect_low=np.nan, effect_high=np.nan)
    page = written(replace(results, table1=table1, weights=results.weights.iloc[:0]), tmp_path)
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL).replace("nance", "")
    assert "adjusted the 0 p-values" in page


def test_every_parameter_has_words_and_a_value(text):
    assert set(WORLD_WORDS) == {field.name for field in fields(WorldConfig)}
    assert set(DESIGN_WORDS) == {field.name for field in fields(StudyDesign)} - {"world", "clutter_map"}
    assert set(MAP_WORDS) == {field.name for field in fields(MapDesign)}
    for words in [*WORLD_WORDS.values(), *DESIGN_WORDS.values(), *MAP_WORDS.values()]:
        assert f">{words}</th>" in text


def test_reproduction_names_what_the_command_does_not_set(results, tmp_path, text):
    assert "halfseen study --repetitions 40 --seed 0" in text
    assert "differed from the default design" not in text
    changed = replace(results, design=replace(results.design, seed=7, alpha=0.05))
    page = written(changed, tmp_path)
    assert "halfseen study --repetitions 40 --seed 7" in page
    assert "differed from the default design in <code>alpha</code>" in page


def test_scenes_say_who_hides_whom(results, tmp_path):
    hides = np.zeros((3, 3))
    hides[2, 0], hides[2, 1], hides[1, 0] = 0.5, 0.2, 0.01
    scenes = (Scene(hides, "my_table.pcd"), Scene(np.zeros((1, 1)), "alone"))
    page = written(replace(results, scenes=scenes), tmp_path)
    assert "My table" in page
    assert "2 is hidden 0.60: by 0 (0.50), 1 (0.20)" in page
    assert "1 is hidden" not in page
    assert "<b>1 object</b>" in page
    assert "Nothing hides another" in page
    assert "<img" not in page


def test_names_are_escaped(results, tmp_path):
    page = written(replace(results, sentences=("a < b", "c", "d"), versions={"<script>": "1"}), tmp_path)
    assert "a &lt; b" in page
    assert "<script>" not in page


def test_picture_of_no_scene_is_refused(results, tmp_path):
    with pytest.raises(ArgumentError, match=r"'elsewhere'.*table_00\.pcd"):
        write_report(results, {"elsewhere": b""}, tmp_path)
    assert list(tmp_path.iterdir()) == []
