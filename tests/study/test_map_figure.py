import io

import numpy as np
import pytest
from example_map import WORLD, example_table
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from halfseen.study.figures import style
from halfseen.study.map_cells import MapDesign
from halfseen.study.map_figure import map_of
from halfseen.study.map_table import LEARN, UNDECIDED


@pytest.fixture(autouse=True)
def within_style():
    with style():
        yield


def dear(cell):
    return {-5.0: -0.2, -10.0: 0.05, -20.0: 0.35}[cell.reward_wash_clean]


def written(figure):
    figure.draw_without_rendering()
    return figure.findobj(lambda part: isinstance(part, Text) and part.get_text() and part.get_visible())


def fields(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts if text.get_position()[0] % 1 == 0.5]


def test_a_number_in_every_field_and_a_mark_for_every_verdict():
    table = example_table(dear)
    numbers = fields(map_of(table, MapDesign(), WORLD))
    # The world's own panel stands twice, in both blocks.
    assert len(numbers) == 12 * 9
    own = (table["label_gain"] == 0.3) & (table["reward_wash_clean"] == -10.0) & (table["grip_offset_std"] == 1.0)
    shown = [*table["verdict"], *table.loc[own, "verdict"]]
    assert sum(number.startswith("▲") for number in numbers) == shown.count(LEARN) >= 27
    assert sum(number.startswith("?") for number in numbers) == shown.count(UNDECIDED) > 9
    assert {"−20", "▲ 35"} <= set(numbers)


def test_numbers_stand_where_their_place_is():
    figure = map_of(example_table(lambda cell: 0.01 * cell.num_objects + cell.occlusion, noise=0.0), MapDesign(), WORLD)
    at = {text.get_position(): text.get_text() for text in figure.axes[0].texts}
    assert (at[0.5, 0.5], at[2.5, 0.5], at[0.5, 2.5], at[1.5, 1.5]) == ("▲ 13", "▲ 53", "▲ 19", "▲ 36")


def test_a_place_without_a_scale_has_a_dash():
    table = example_table(dear)
    table.loc[0, ["gain_share", "gain_share_low", "gain_share_high"]] = np.nan
    table.loc[0, "verdict"] = "heuristic earns nothing"
    assert fields(map_of(table, MapDesign(), WORLD)).count("–") == 1


@pytest.mark.parametrize("share", [dear, lambda cell: 0.3, lambda cell: -2.66])
@pytest.mark.parametrize("is_titled", [True, False])
def test_nothing_written_overlaps_or_leaves_the_figure(share, is_titled):
    figure = map_of(example_table(share), MapDesign(), WORLD, is_titled)
    assert figure.get_size_inches()[0] <= 9.0
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in written(figure)]
    frame = figure.bbox
    assert all(box.x0 >= 0 and box.y0 >= 0 and box.x1 <= frame.x1 and box.y1 <= frame.y1 for box in boxes)
    # Two pixels: boxes are a little higher than the letters in them.
    for k, box in enumerate(boxes):
        for other in boxes[k + 1 :]:
            across, along = min(box.x1, other.x1) - max(box.x0, other.x0), min(box.y1, other.y1) - max(box.y0, other.y0)
            assert min(across, along) < 2


def test_the_same_table_gives_the_same_bytes():
    def drawn():
        buffer = io.BytesIO()
        figure = map_of(example_table(dear), MapDesign(), WORLD)
        FigureCanvasAgg(figure)
        figure.savefig(buffer, format="svg", metadata={"Date": None})
        return buffer.getvalue()

    assert drawn() == drawn()


def test_other_designs_are_drawn():
    design = MapDesign((2, 4), (0.1, 0.4), (0.2, 0.4), (-8.0,), (0.7,))
    figure = map_of(example_table(lambda cell: 0.1, design), design, WORLD)
    assert len(fields(figure)) == (2 * 1 + 1) * 4
    assert "labels 70 %, cost 8" in [axes.get_title(loc="left") for axes in figure.axes]
