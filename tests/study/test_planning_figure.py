"""Figures 2 and 3: everything is there and legible."""

import pytest
from example_planning import example_pieces, example_times
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from halfseen.study.figures import style
from halfseen.study.planning_figure import figure2_of, figure3_of
from halfseen.study.planning_table import figure2, figure3, planning_frames


@pytest.fixture(autouse=True)
def within_style():
    with style():
        yield


def figures(slower=1.0, **example):
    frames, times_ms = planning_frames(example_pieces(**example)), example_times(slower)
    table = figure2(frames, times_ms)
    return figure2_of(table, 0.31, 800), figure3_of(figure3(frames, times_ms, 256), table)


def texts(figure):
    figure.draw_without_rendering()
    unseen = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            unseen |= {tick.label1 for tick in axis.get_major_ticks() if not low <= tick.get_loc() <= high}
    found = figure.findobj(lambda part: isinstance(part, Text) and part.get_text() and part.get_visible())
    return [text for text in found if text not in unseen]


@pytest.mark.parametrize("example", [{}, {"lead": -6.0}, {"lead": 3.0}, {"hurts_at": 3}, {"noise": 6.0}])
@pytest.mark.parametrize("slower", [1.0, 4.0])
def test_nothing_written_overlaps_or_leaves_the_figure(example, slower):
    for figure in figures(slower, **example):
        renderer = FigureCanvasAgg(figure).get_renderer()
        boxes = [text.get_window_extent(renderer) for text in texts(figure)]
        frame = figure.bbox
        assert all(box.x0 >= 0 and box.y0 >= 0 and box.x1 <= frame.x1 and box.y1 <= frame.y1 for box in boxes)
        for k, box in enumerate(boxes):
            for other in boxes[k + 1 :]:
                across = min(box.x1, other.x1) - max(box.x0, other.x0)
                along = min(box.y1, other.y1) - max(box.y0, other.y0)
                assert min(across, along) < 2


def test_figure2_names_every_point_and_tells_learning_apart():
    figure, _ = figures()
    written = [text.get_text() for text in texts(figure)]
    assert sum(text.startswith("learned policy  ") for text in written) == 1
    for name in ("greedy  ", "greedy with history  ", "history, counting the penalty  "):
        assert sum(text.startswith(name) for text in written) == 1
    assert "learning, once, from 800 paths: 310 ms" in written
    assert {"0.01", "1", "100"} <= set(written)


def test_figure3_has_every_horizon_and_the_rivals():
    _, figure = figures()
    written = [text.get_text() for text in texts(figure)]
    assert {"1", "2", "3", "4", "5", "6"} <= set(written)
    assert "learned policy" in written
    assert "best heuristic (history, counting the penalty)" in written
    assert len(figure.axes) == 2


def test_a_figure_may_stand_without_its_title():
    frames = planning_frames(example_pieces())
    table = figure2(frames, example_times())
    for figure in (
        figure2_of(table, 0.31, 800, is_titled=False),
        figure3_of(figure3(frames, example_times(), 256), table, is_titled=False),
    ):
        assert all("planner seen" not in text.get_text() for text in texts(figure))
        assert all("beyond noise" not in text.get_text() for text in texts(figure))
