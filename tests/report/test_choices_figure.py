import numpy as np
import pytest

from halfseen.report.choices_figure import FEW_STATES, draw_choices


def rows(num_actions, counts=(800, 40, 3)):
    share = 1.0 / num_actions
    every = {f"action {k}": share for k in range(num_actions)}
    return [
        {
            "stage": stage,
            "num_states": count,
            "as_logged": 0.5,
            "policy": every | {"never": 0.0},
            "logged": every | {"never": 0.0},
        }
        for stage, count in enumerate(counts, start=1)
    ]


@pytest.mark.parametrize("num_actions", range(1, 13))
def test_every_cell_has_an_action_or_the_legend(num_actions):
    figure = draw_choices(rows(num_actions))
    titled = [axes for axes in figure.axes if axes.get_title(loc="left")]
    blank = [axes for axes in figure.axes if axes not in titled]
    assert len(titled) == min(num_actions, 9)
    assert len(blank) <= 1
    assert all(axes.get_legend() is not None for axes in blank)
    assert bool(figure.legends) != bool(blank)


def test_few_states_are_small_and_hollow_and_their_number_is_told():
    figure = draw_choices(rows(1))
    marks = figure.axes[0].collections[0]
    area = marks.get_sizes()
    assert area[0] / area[1] > 10 > 1
    hollow = [tuple(face[:3]) == (1.0, 1.0, 1.0) for face in np.asarray(marks.get_facecolors())]
    assert hollow == [count < FEW_STATES for count in (800, 40, 3)]
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["1\n(800)", "2\n(40)", "3\n(3)"]
