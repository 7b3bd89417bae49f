"""Trajectories along time, and what is chosen in each stage."""

from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from halfseen.figures import inline_svg, style
from halfseen.logs import Logs
from halfseen.view.log_figures import OTHERS, action_colours, draw_follow_up, draw_timeline
from halfseen.view.log_findings import MOST_ROWS, UNKNOWN_ACTION, endings, follow_up, timeline
from halfseen.view.policy_figures import FEW_STATES, draw_choices


def log_of(trajectories):
    """Trajectories as (times of completed stages, time of the cut or None, cause, action of the cut stage)."""
    stages, ends = [], []
    for trajectory, (times, cut_s, cause, last) in enumerate(trajectories):
        for stage, elapsed_s in enumerate(times, start=1):
            row = {
                "trajectory": trajectory,
                "stage": stage,
                "elapsed_s": elapsed_s,
                "action": f"a{stage}",
                "reward": 0.0,
            }
            stages.append(row)
        if cut_s is not None:
            stages.append(
                {"trajectory": trajectory, "stage": len(times) + 1, "elapsed_s": None, "action": last, "reward": None}
            )
        end_s = times[-1] if cut_s is None else cut_s
        ends.append(
            {"trajectory": trajectory, "end_s": end_s, "ending": "cut" if cut_s else "finished", "cause": cause}
        )
    frame = pd.DataFrame(stages).astype({"elapsed_s": float, "reward": float})
    return Logs(frame, pd.DataFrame(ends))


def many(num_trajectories, num_stages=2, seed=0):
    rng = np.random.default_rng(seed)
    clocks = np.cumsum(rng.uniform(0.5, 2.0, (num_trajectories, num_stages)), axis=1)
    return log_of([(clock.tolist(), None, None, None) for clock in clocks])


def test_rows_are_trajectories_by_how_they_ended_and_then_by_length():
    finished, cut = [([1.0, 4.0], *[None] * 3), ([3.0], *[None] * 3)], [([1.0], 2.0, "operator", "b")]
    others = [([], 0.5, "operator", None), ([1.0], 5.0, "battery", "b")]
    told = timeline(log_of([finished[0], *cut, finished[1], *others]))
    groups = [(group.name, group.num_trajectories) for group in told.endings]
    assert groups == [("finished", 2), ("cut: operator", 2), ("cut: battery", 1)]
    assert told.end_s.tolist() == [3.0, 4.0, 0.5, 2.0, 5.0]
    pieces = set(told.stages.itertuples(index=False, name=None))
    assert pieces == {
        (0, 0.0, 3.0, "a1", True),
        (1, 0.0, 1.0, "a1", True),
        (1, 1.0, 4.0, "a2", True),
        (2, 0.0, 0.5, UNKNOWN_ACTION, False),
        (3, 0.0, 1.0, "a1", True),
        (3, 1.0, 2.0, "b", False),
        (4, 0.0, 1.0, "a1", True),
        (4, 1.0, 5.0, "b", False),
    }


def test_every_way_to_end_has_its_trajectories():
    logs = log_of([([1.0], 2.0, f"cause {k % 7}", "b") for k in range(21)] + [([1.0], None, None, None)])
    ways = endings(logs)
    assert np.sum(list(ways.values()), axis=0).tolist() == [1] * 22
    assert list(ways)[-1] == "cut: 3 other causes"


def test_many_trajectories_are_evenly_spaced_ones_of_each_way_to_end():
    logs, rarely = many(2000), log_of([([1.0], 1.5, "battery", "b")])
    both = Logs(
        pd.concat([logs.stages, rarely.stages.assign(trajectory=2000)]),
        pd.concat([logs.trajectories, rarely.trajectories.assign(trajectory=2000)]),
    )
    told = timeline(both)
    assert [group.num_rows for group in told.endings] == [MOST_ROWS, 1]
    ends_s = np.sort(logs.end_s)
    assert told.end_s[[0, MOST_ROWS - 1]].tolist() == ends_s[[0, -1]].tolist()
    assert told.end_s[: MOST_ROWS // 2].max() == pytest.approx(np.median(ends_s), abs=0.05)


def test_a_log_of_many_long_trajectories_is_a_small_drawing_without_names_of_trajectories():
    told = timeline(many(3000, num_stages=30))
    colours = action_colours(sorted(set(told.stages["action"])))
    svg = inline_svg(lambda: draw_timeline(told, colours), "f", "t")
    assert told.num_rows == MOST_ROWS
    assert len(svg) < 500_000
    assert OTHERS in svg


def choices(num_actions, counts=(800, 40, 3)):
    share = 1.0 / num_actions
    every = {f"action {k}": share for k in range(num_actions)}
    told = {"as_logged": 0.5, "policy": every | {"never": 0.0}, "logged": every | {"never": 0.0}}
    return [{"stage": stage, "num_states": count, **told} for stage, count in enumerate(counts, start=1)]


@pytest.mark.parametrize("num_actions", [1, 2, 4, 7, 9, 10, 12])
def test_every_cell_has_an_action_or_the_legend(num_actions):
    figure = draw_choices(choices(num_actions))
    titled = [axes for axes in figure.axes if axes.get_title(loc="left")]
    blank = [axes for axes in figure.axes if axes not in titled]
    assert len(titled) == min(num_actions, 9)
    assert len(blank) <= 1
    assert all(axes.get_legend() is not None for axes in blank)
    assert bool(figure.legends) != bool(blank)


def test_few_states_are_small_and_hollow_and_their_number_is_told():
    figure = draw_choices(choices(1))
    marks = figure.axes[0].collections[0]
    area = marks.get_sizes()
    assert area[0] / area[1] > 10 > 1
    hollow = [tuple(face[:3]) == (1.0, 1.0, 1.0) for face in np.asarray(marks.get_facecolors())]
    assert hollow == [count < FEW_STATES for count in (800, 40, 3)]
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["1\n(800)", "2\n(40)", "3\n(3)"]


LONG = ["the operator pressed the emergency stop", "a_collision_was_foreseen_by_the_guard_of_the_cell", "battery"]


@pytest.mark.parametrize("num_finished", [2, 3000])
def test_words_of_a_figure_lie_neither_over_one_another_nor_beyond_its_border(num_finished):
    causes = [f"{name} {k}" for k, name in enumerate((LONG * 3)[:7])]
    cut = [([1.0 + k], 2.0 + k, cause, f"{cause} once more") for k, cause in enumerate(causes)]
    logs = log_of([([1.0, 3.0], None, None, None)] * num_finished + cut)
    shown = timeline(logs)
    colours = action_colours(sorted(set(shown.stages["action"])))
    with style():
        for figure in (draw_timeline(shown, colours), draw_follow_up(follow_up(logs))):
            FigureCanvasAgg(figure).draw()
            names = figure.axes[-1].get_yticklabels()
            keys = [text for legend in figure.legends for text in legend.get_texts()]
            boxes = [text.get_window_extent() for text in (*names, *keys)]
            assert not [pair for pair in combinations(boxes, 2) if pair[0].overlaps(pair[1])]
            low, high = np.min([box.min for box in boxes], axis=0), np.max([box.max for box in boxes], axis=0)
            assert (low >= 0).all()
            assert (high <= figure.bbox.max).all()
