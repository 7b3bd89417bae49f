from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
from example_results import example_results
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from halfseen.study.design import StudyDesign
from halfseen.study.figures import figure1_of, figure4_of, spread, style, write_figure
from halfseen.study.grasp_figure import figure5_of
from halfseen.study.results import GRASP_NAMES
from halfseen.study.run import FIGURES

SVG = "{http://www.w3.org/2000/svg}"


def texts(figure):
    """Return all that is written: ticks beyond the ends of an axis are not."""
    figure.draw_without_rendering()
    unseen = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            unseen |= {tick.label1 for tick in axis.get_major_ticks() if not low <= tick.get_loc() <= high}
    found = figure.findobj(lambda part: isinstance(part, Text) and part.get_text() and part.get_visible())
    return [text for text in found if text not in unseen]


def words(figure):
    return [text.get_text() for text in texts(figure)]


@pytest.fixture(autouse=True)
def within_style():
    with style():
        yield


@pytest.mark.parametrize("name", FIGURES)
def test_files_are_whole_and_the_same_again(tmp_path, name):
    results = example_results()
    for folder in ("first", "second"):
        write_figure(FIGURES[name], results, tmp_path / folder, name)
    files = sorted(path.name for path in (tmp_path / "first").iterdir())
    assert files == [f"{name}.png", f"{name}.svg"]
    for file in files:
        assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "second" / file).read_bytes()
    assert ElementTree.parse(tmp_path / "first" / f"{name}.svg").getroot().tag == f"{SVG}svg"
    assert (tmp_path / "first" / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_the_users_style_changes_nothing_and_stays(tmp_path):
    results = example_results()
    write_figure(figure1_of, results, tmp_path / "plain", "figure1")
    with matplotlib.rc_context({"font.size": 20.0, "svg.hashsalt": "other", "axes.facecolor": "red"}):
        write_figure(figure1_of, results, tmp_path / "styled", "figure1")
        assert matplotlib.rcParams["font.size"] == 20.0
    assert (tmp_path / "plain/figure1.svg").read_bytes() == (tmp_path / "styled/figure1.svg").read_bytes()


def test_figure1_names_every_line():
    results = example_results()
    written = words(figure1_of(results))
    for name in (
        "greedy  3.10",
        "greedy with history  3.60",
        "strongest planner within 100 ms  9.10",
        "strongest planner within 1 s  9.15",
    ):
        assert name in written
    for cut in ("no path cut", "1/6 of the paths cut", "1/3 of the paths cut", "1/2 of the paths cut"):
        assert sum(text.startswith(f"learned, {cut}") for text in written) == 1
    assert {"25", "50", "100", "200", "400", "800"} <= set(written)


@pytest.mark.parametrize("lead", [-6.0, 0.0, 3.0])
def test_nothing_written_overlaps_or_leaves_the_figure(lead):
    results = example_results(lead=lead)
    for figure in (figure1_of(results), figure4_of(results), figure5_of(results)):
        renderer = FigureCanvasAgg(figure).get_renderer()
        boxes = [text.get_window_extent(renderer) for text in texts(figure)]
        frame = figure.bbox
        assert all(box.x0 >= 0 and box.y0 >= 0 and box.x1 <= frame.x1 and box.y1 <= frame.y1 for box in boxes)
        # Two pixels: boxes are a little higher than the letters in them.
        for k, box in enumerate(boxes):
            for other in boxes[k + 1 :]:
                across = min(box.x1, other.x1) - max(box.x0, other.x0)
                along = min(box.y1, other.y1) - max(box.y0, other.y0)
                assert min(across, along) < 2


@pytest.mark.parametrize("null", [None, np.nan])
def test_any_null_serves_for_the_baselines(null):
    results = example_results()
    figure1 = results.figure1
    for column in ("num_paths", "cut_share"):
        figure1[column] = figure1[column].astype(object).where(figure1[column].notna(), null)
    assert words(figure1_of(results)) == words(figure1_of(example_results()))


def test_other_designs_are_drawn():
    design = StudyDesign(
        repetitions=2,
        num_paths=(10, 20),
        cut_shares=(0.0, 0.37),
        treatment_cut_kinds=("occlusion",),
        treatment_cut_share=0.37,
        table_num_paths=20,
        table_cut_share=0.37,
    )
    results = example_results(design=design)
    assert any(text.startswith("learned, 37 % of the paths cut") for text in words(figure1_of(results)))
    assert "Cuts where much is hidden" in words(figure4_of(results))


def test_figure4_has_a_panel_and_differences_for_each_kind_of_cut():
    figure = figure4_of(example_results(gain=0.4))
    assert len(figure.axes) == 4
    written = words(figure)
    assert "Independent cuts" in written
    assert "cuts whose hazard grows while an attempt drags on" in written
    for name in ("weighted by 1/Ĝ", "completed stages, no weights", "cut paths dropped", "cuts counted as failures"):
        assert name in written


def test_figure5_names_every_model_and_says_where_laplace_is():
    figure = figure5_of(example_results())
    written = words(figure)
    assert len(figure.axes) == 4
    assert set(GRASP_NAMES.values()) <= set(written)
    assert "Laplace's rule, which looks at no occlusion, lies 0.20 above" in written
    assert {"50", "200", "800"} <= set(written)


def test_spread_moves_as_little_as_it_must():
    assert spread([3.0, 1.0], 0.5, 0.0, 4.0) == [3.0, 1.0]
    assert np.allclose(spread([2.0, 2.0, 2.0], 0.5, 0.0, 4.0), [1.5, 2.0, 2.5])
    assert np.allclose(spread([4.0, 4.0], 0.5, 0.0, 4.0), [3.5, 4.0])
    heights = np.random.default_rng(0).normal(size=12)
    placed = np.array(spread(heights.tolist(), 0.2, -3.0, 3.0))
    assert np.all(np.diff(np.sort(placed)) > 0.2 - 1e-9)
    assert np.array_equal(np.argsort(placed), np.argsort(heights))
