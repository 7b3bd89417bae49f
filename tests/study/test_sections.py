"""What the experiments draw and say, from made-up pieces: nothing overlaps, and claims follow the numbers."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from examples import GRASP, PLANNING, REWARD, example_pieces, example_section, example_setting
from halfseen.evaluation.estimate import Estimate
from halfseen.pages.drawing import drawn
from halfseen.pages.sentences import Claim
from halfseen.study.experiments import EXPERIMENTS
from halfseen.study.experiments.reward.opening import opening_of
from halfseen.study.experiments.reward.peer import over_peer
from halfseen.study.frames import row_of
from halfseen.study.policies import HEURISTICS

RULES = [each.name for each in HEURISTICS]
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


def drawings(**options):
    return [drawing for each in EXPERIMENTS for drawing in example_section(each, **options).drawings]


@pytest.mark.usefixtures("within_style")
@pytest.mark.slow
@pytest.mark.parametrize("lead", [-4.0, 0.0, 3.0])
def test_nothing_written_overlaps_or_leaves_the_figure(lead):
    for drawing in drawings(lead=lead, gain=0.1 * lead):
        for title in (drawing.title, ""):
            figure = drawing.draw(title)
            renderer = FigureCanvasAgg(figure).get_renderer()
            boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in texts(figure)]
            frame = figure.bbox
            for k, (text, box) in enumerate(boxes):
                inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= frame.x1 and box.y1 <= frame.y1
                assert inside, (drawing.name, text)
                for other_text, other in boxes[k + 1 :]:
                    across = min(box.x1, other.x1) - max(box.x0, other.x0)
                    along = min(box.y1, other.y1) - max(box.y0, other.y0)
                    # Two pixels: boxes are a little higher than the letters in them.
                    assert min(across, along) < 2, (drawing.name, text, other_text)


@pytest.mark.parametrize("name", [drawing.name for drawing in drawings()])
def test_figures_are_whole_and_the_same_again(name):
    drawing = next(each for each in drawings() if each.name == name)
    svg = drawn(lambda: drawing.draw(drawing.title), "svg")
    assert svg == drawn(lambda: drawing.draw(drawing.title), "svg")
    assert ElementTree.fromstring(svg).tag == f"{SVG}svg"


@pytest.mark.parametrize(
    ("lead", "verdict", "title"),
    [
        (2.0, "supported", "earns more than the strongest planner"),
        (0.2, "inconclusive", "no significant difference from the strongest planner"),
        (-2.0, "not supported", "earns less than the strongest planner"),
    ],
)
def test_the_first_sentence_compares_on_the_same_episodes(lead, verdict, title):
    setting = example_setting(30)
    tables = REWARD.tabulate(setting, example_pieces(REWARD, lead=lead, repetitions=30))
    section = REWARD.section(setting, tables)
    row = tables["table1"].query("baseline == 'planner-512' and measure == 'reward'").iloc[0]
    assert row["effect"] == pytest.approx(row["censored_q"] - row["other"])
    first = section.sentences[0]
    assert first.count("earns more than the strongest heuristic (history, counting the penalty): supported") == 1
    assert f"POMDP planner, 512 simulations): {verdict} (" in first
    assert f"{row['censored_q']:.2f} against {row['other']:.2f} a path on the same 300 episodes" in first
    assert title in section.drawings[0].title


def test_a_planner_in_figure_1_stands_as_far_from_the_learned_policy_as_on_the_episodes_of_both():
    tables = REWARD.tabulate(example_setting(), example_pieces(REWARD))
    figure1, table1 = tables["figure1"].set_index("policy"), tables["table1"]
    own = row_of(tables["figure1"], policy="censored_q", num_paths=800, cut_share=0.5)
    for name in REWARD.planner_names:
        gap = table1.query(f"baseline == '{name}' and measure == 'reward'").iloc[0]["effect"]
        assert own["mean_reward"] - figure1.loc[name, "mean_reward"] == pytest.approx(gap)
    assert figure1["role"].dropna().to_dict() == {"history-penalty": "best_heuristic", "planner-512": "best_planner"}


def test_the_planner_with_fitted_laws_stands_beside_what_was_learned_from_each_log():
    pieces = example_pieces(REWARD)
    tables = REWARD.tabulate(example_setting(), pieces)
    over = {"learned": [], "difference": []}
    for piece in pieces.repetitions:
        met = next(row for row in piece["peer"] if (row["num_paths"], row["cut_share"]) == (50, 1 / 3))
        own = next(row for row in piece["learned"] if (row["num_paths"], row["cut_share"]) == (50, 1 / 3))
        over["learned"].append(own["reward"])
        over["difference"].append(met["over_peer"])
    place = {"num_paths": 50, "cut_share": 1 / 3}
    line = row_of(tables["figure1"], policy=REWARD.peer.name, **place)
    assert line["mean_reward"] == pytest.approx(np.mean(over["learned"]) - np.mean(over["difference"]))
    assert row_of(tables["peer"], **place)["effect"] == pytest.approx(np.mean(over["difference"]))
    rows = tables["peer"].query("num_paths == 50")
    is_mean = rows["cut_share"].isna()
    assert rows.loc[is_mean, "effect"].item() == pytest.approx(rows.loc[~is_mean, "effect"].mean())
    assert len(tables["peer"]) == len(REWARD.num_paths) * (len(REWARD.cut_shares) + 1)


def test_what_is_learned_over_the_planner_needs_few_of_its_episodes():
    rng = np.random.default_rng(0)
    episode, own, learned = rng.normal(0.0, 10.0, 50), rng.normal(1.0, 0.1, 50), rng.normal(3.0, 1.0, 50)
    mean = 2.0 + episode
    everywhere = over_peer(episode + learned, mean, range(50), episode + own)
    assert everywhere == pytest.approx(np.mean(learned - own))
    assert over_peer(episode + learned, mean, [3, 17], (episode + own)[[3, 17]]) == pytest.approx(everywhere, abs=0.3)


def test_decision_times_are_told_and_not_tested():
    table1 = REWARD.tabulate(example_setting(), example_pieces(REWARD))["table1"]
    is_time = table1["measure"] == "decision_ms"
    assert table1.loc[is_time, ["p_value", "p_holm", "supported"]].isna().all(axis=None)
    assert table1.loc[~is_time, "p_holm"].notna().all()
    listing = next(each for each in example_section(REWARD).listings if each.label == "Table 1")
    assert any("measured on this machine" in heading for heading in listing.groups)


def test_planners_are_compared_on_the_episodes_that_they_played():
    setting = example_setting()
    figure2 = PLANNING.tabulate(setting, example_pieces(PLANNING, lead=1.0))["figure2"].set_index("policy")
    assert figure2.loc["planner-1024", "over_censored_q"] == pytest.approx(-1.0, abs=0.3)
    assert figure2.loc["planner-1024", "episodes"] == dict(PLANNING.simulations)[1024]
    assert set(figure2["kind"]) == {"learned", "heuristic", "planner"}
    sentences = example_section(PLANNING, lead=1.0).sentences
    assert "1,024 simulations a decision, earns more than" in sentences[0]
    assert ": not supported (" in sentences[0]
    assert sentences[1].startswith(
        "Looking 6 steps ahead, with 128 simulations a decision, earns more than looking 1 step"
    )
    assert ": supported (" in sentences[1]


@pytest.mark.parametrize(
    ("gain", "verdict", "title"), [(0.02, "supported", "from logs of every size"), (-0.02, "not supported", "does not")]
)
def test_the_papers_claim_is_said_to_hold_only_where_it_does(gain, verdict, title):
    section = example_section(GRASP, gain=gain, repetitions=16)
    assert f"predicts grasps better than the mean of a Beta: {verdict} (" in section.sentences[0]
    assert title in section.drawings[0].title


def test_calibration_has_an_error_over_repetitions():
    pieces = example_pieces(GRASP)
    figure5 = GRASP.tabulate(example_setting(), pieces)["figure5"]
    row = figure5.query("model == 'beta' and num_paths == 50").iloc[3]
    bins = [
        r["bins"]
        for piece in pieces.repetitions
        for r in piece["grasp"]
        if (r["model"], r["num_paths"]) == ("beta", 50)
    ]
    attempts, said, won = (
        np.array([each[name][3] for each in bins]) for name in ("attempts", "probabilities", "successes")
    )
    assert row["difference"] == pytest.approx((won.sum() - said.sum()) / attempts.sum())
    residual = won - said - row["difference"] * attempts
    assert row["se"] == pytest.approx(np.sqrt(6 / 5 * np.sum(residual**2)) / attempts.sum())


def test_planners_that_play_in_few_repetitions_are_compared_on_those():
    pieces = example_pieces(REWARD, repetitions=30)
    few = [
        piece
        if k < 8
        else piece | {"peer": [], "baselines": {name: of for name, of in piece["baselines"].items() if name in RULES}}
        for k, piece in enumerate(pieces.repetitions)
    ]
    setting, design = example_setting(30), replace(REWARD, planned_repetitions=8)
    tables = design.tabulate(setting, pieces._replace(repetitions=few))
    alone = design.tabulate(setting, pieces._replace(repetitions=few[:8]))
    figure1 = tables["figure1"].set_index(["policy", "num_paths", "cut_share"])
    counts = figure1["repetitions"].groupby("policy").unique().map(list)
    assert counts.to_dict() == {
        name: [30 if name in (*RULES, "censored_q") else 8] for name in (*REWARD.baseline_names, "censored_q")
    }
    planned = [name for name in REWARD.baseline_names if name not in RULES]
    of_planners = [of["figure1"][of["figure1"]["policy"].isin(planned)] for of in (tables, alone)]
    pd.testing.assert_frame_equal(*of_planners)
    pd.testing.assert_frame_equal(tables["peer"], alone["peer"])
    caption = design.section(setting, tables).drawings[0].caption
    assert "in 8 of the repetitions, plays some of the episodes" in caption
    assert "in 8 of" not in design.section(replace(setting, repetitions=8), alone).drawings[0].caption


@pytest.mark.parametrize(
    ("verdict", "words"),
    [("supported", "better than"), ("inconclusive", "about as well as"), ("not supported", "worse")],
)
def test_the_report_opens_with_what_each_way_brings_above_leaving_the_table(verdict, words):
    setting = example_setting(30)
    figure1 = REWARD.tabulate(setting, example_pieces(REWARD, repetitions=30))["figure1"]
    gain = {"supported": (0.5, 1.5), "inconclusive": (-0.5, 1.5), "not supported": (-1.5, -0.5)}[verdict]
    rule = Claim("x", "earns more than", "earns less than", "y", Estimate(float(np.mean(gain)), *gain, 0.1, 30.0))
    opening = opening_of(REWARD, setting, figure1, rule)
    nothing = -5.0 * 0.6 * np.mean([scene.num_objects for scene in setting.scenes])
    ours = row_of(figure1, policy="censored_q", num_paths=800, cut_share=0.5)["mean_reward"] - nothing
    theirs = row_of(figure1, role="best_heuristic")["mean_reward"] - nothing
    assert f"cut short, clears a table {words}" in opening.title
    assert f"{ours:.1f} points a table, against {theirs:.1f}." in opening.title
    bars = opening.draw("").axes[0].patches
    assert [bar.get_width() for bar in bars[1:3]] == pytest.approx([theirs, ours])
    assert bars[0].get_width() <= bars[1].get_width()
