"""Figures and sentences of pages about long names, large and small rewards, many actions and many covariates."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from chromium import faults_of, in_browser
from halfseen.censoring import positivity_report
from halfseen.figures import style
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.view import page as page_module
from halfseen.view.findings import find
from halfseen.view.log_figures import draw_follow_up
from halfseen.view.log_findings import FollowUp, Timeline
from halfseen.view.page import page_of, write_page
from halfseen.view.policy_figures import draw_curves, draw_map, draw_values
from halfseen.view.policy_findings import PolicyMap, QCurve
from halfseen.view.words import curves_title, standing, timeline_title
from small_logs import flat_log, kept
from small_report import estimate, evaluation, found

LONG = "the gripper is smeared with oil and misses whatever it reaches for"
UNIT = "good parts of each shift"


def boxes_of(figure):
    """Boxes of all texts of a figure, and the figure's own."""
    FigureCanvasAgg(figure)
    figure.canvas.draw()
    texts = [text for text in figure.findobj(lambda each: hasattr(each, "get_text")) if text.get_text().strip()]
    shown = [text for text in texts if text.get_visible()]
    return {text: text.get_window_extent() for text in shown}, figure.bbox


@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e10, 123456.0])
def test_numbers_beside_the_intervals_lie_within_the_figure_and_no_power_of_ten_lies_on_a_name(scale):
    def scaled(value, reach):
        return estimate(scale * value, scale * reach)

    made = evaluation(
        importance_sampling=scaled(1.2345, 0.1),
        fitted_q=scaled(1.2345, 0.0123),
        doubly_robust=scaled(1.2345, 0.0123),
        logging=scaled(1.2, 0.0123),
        difference=scaled(0.0345, 0.0123),
    )
    with style():
        figure = draw_values(made)
        boxes, whole = boxes_of(figure)
        assert [text.get_text() for text, box in boxes.items() if box.x1 > whole.x1 or box.x0 < whole.x0] == []
        assert [axes.xaxis.get_offset_text().get_text() for axes in figure.axes] == ["", ""]


def test_names_of_q_with_a_long_unit_do_not_run_into_one_another():
    x = np.linspace(0.0, 1.0, 3)
    curves = [QCurve(stage, "x", x, {"a": x, "b": 1 - x}, None, None, np.array(["b", "b", "a"])) for stage in (1, 2, 3)]
    with style():
        figure = draw_curves(curves, {"a": "b", "b": "r"}, UNIT)
        boxes_of(figure)
        names = [axes.yaxis.label.get_window_extent() for axes in figure.axes]
    assert all(above.y0 > below.y1 for above, below in pairwise(names))
    assert min(name.x0 for name in names) > 0


def curve(q, taken):
    return QCurve(1, "x", np.arange(2.0), {name: np.array(each) for name, each in q.items()}, None, None, taken)


def test_the_title_of_q_says_how_often_the_policy_takes_the_highest_line_that_is_drawn():
    q, both = {"a": [1.0, 2.0], "b": [2.0, 1.0]}, ["a", "b"]
    assert curves_title([curve(q, np.array(["b", "a"]))], both).endswith("the policy takes the highest line")
    result = curves_title([curve(q, np.array(["b", "b"]))], both).replace("\u00a0", " ")
    assert result.endswith("in 50 % of these states, elsewhere one that the logs support better")
    result = curves_title([curve(q, np.array(["b", "b"]))], ["a"]).replace("\u00a0", " ")
    assert result.endswith("in 0 % of these states, elsewhere one that the logs support better or is not drawn")


def test_a_count_is_not_left_out_where_its_name_is_long():
    shown = FollowUp(
        np.array([0.0, 2.0]), np.ones(2), {f"cut: {LONG}": np.ones(106)}, np.array([0.0, 1.0]), np.array([106, 106])
    )
    (name,) = [label.get_text() for label in draw_follow_up(shown).axes[1].get_yticklabels()]
    assert "…" in name
    assert name.endswith("(106)")


def test_a_strip_of_one_covariate_is_as_legible_as_a_map():
    shown = PolicyMap(
        1,
        ("x",),
        np.arange(3.0),
        None,
        np.full((1, 3), "a"),
        np.full((1, 3), True),
        np.zeros((1, 1)),
        np.array(["a"]),
        {},
    )
    assert draw_map(shown, {"a": "#000000"}).get_size_inches()[0] < 5.0


def test_a_trajectory_with_a_long_name_does_not_squeeze_the_weights():
    ends_s, is_done = np.array([1.0, 2.0, 3.0, 4.0]), np.array([True, False, True, True])
    widths = []
    for name in ("t", LONG):
        figure = positivity_report(ends_s, is_done, trajectory_ids=[f"{name} {k}" for k in range(4)]).plot("weights")
        figure.canvas.draw()
        widths.append(figure.axes[0].get_position().width)
    assert widths[1] > 0.7 * widths[0]


def test_rewards_an_hour_have_a_power_of_ten_in_both_numbers():
    from halfseen.evaluation.evaluation import PerHour, Rate

    rates = [Rate(estimate(each, 0.05e12), estimate(13.0, 1.0)) for each in (2.1e12, 1.8e12)]
    result = standing(evaluation(reward_unit="€", per_hour=PerHour(*rates))).replace("\u00a0", " ")
    assert "2.10e+12 € an hour (2.05e+12 to 2.15e+12), against 1.80e+12 today" in result


def test_a_single_cause_is_named_as_the_cause_of_all():
    shown = Timeline(2, (), np.zeros(0), pd.DataFrame())
    log = {"finishes": {"median_s": 3.0}, "cuts": [{"cause": "operator", "median_s": 2.0}]}
    result = timeline_title(shown, log).replace("\u00a0", " ")
    assert result.endswith("half of those that were cut, all by operator, had run for 2.00 s or less")


@pytest.fixture(scope="module")
def many_actions(tmp_path_factory):
    """Findings about a policy of 12 actions that takes the last of them, and of many covariates."""
    logs = flat_log(300, cut_after_s=1e6)
    rng = np.random.default_rng(0)
    names = np.array([f"{LONG[:20]} {k:02d}" for k in range(12)])
    taken = rng.integers(12, size=len(logs.stages))
    more = {f"covariate_{k}": rng.normal(size=len(taken)) for k in range(8)}
    reward = np.where(taken == 11, 3.0, 0.0) + rng.normal(size=len(taken))
    stages = logs.stages.assign(action=names[taken], reward=reward, probability=1 / 12, **more)
    logs = Logs(stages.drop(columns="colour"), logs.trajectories, reward_unit=UNIT)
    folder = tmp_path_factory.mktemp("many") / "policy"
    learner = CensoredQLearner(2, names.tolist(), ["x1", "x2", *more], reg=1.0, stages="pooled")
    return found(kept(learner, logs, folder), logs, reward_unit=UNIT)


@pytest.mark.slow
def test_of_more_actions_than_colours_those_that_the_policy_takes_have_one(many_actions):
    taken = max(many_actions.policy.choices[0]["policy"].items(), key=lambda each: each[1])[0]
    assert taken.endswith("11")
    assert page_module._by_importance(many_actions.policy)[0] == taken
    assert len(page_module._by_importance(many_actions.policy)) == 12


@pytest.mark.slow
def test_medians_of_many_covariates_are_not_listed(many_actions):
    page = page_of(many_actions, "x")
    assert "as logged for the dots." in page
    assert "covariate_7 " not in page.split("Areas: action of the policy")[1].split("Hatched")[0]
    assert "2 to 2" not in page


@in_browser
@pytest.mark.slow
def test_a_page_of_long_names_is_as_wide_as_a_phone(many_actions, tmp_path):
    shares = replace(many_actions.policy.evaluation, share=estimate(1.5, 0.2))
    found = replace(many_actions, policy=replace(many_actions.policy, evaluation=shares))
    write_page(page_of(found, "x"), tmp_path / "page.html")
    assert faults_of([tmp_path / "page.html"], 400) == []


@in_browser
@pytest.mark.slow
def test_a_long_name_of_an_action_breaks_before_its_table_is_wider_than_the_page(tmp_path):
    logs = flat_log(60)
    named = logs.stages.assign(action=logs.stages["action"].replace({"A": LONG.replace(" ", "_")}), probability=0.5)
    write_page(page_of(find(None, Logs(named, logs.trajectories, reward_unit=UNIT)), "x"), tmp_path / "page.html")
    assert faults_of([tmp_path / "page.html"], 900) == []
