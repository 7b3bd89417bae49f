"""What the experiments draw and say, from made-up pieces: nothing overlaps, and claims follow the numbers."""

from dataclasses import replace
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from examples import GRASP, PLANNING, REWARD, example
from halfseen.figures import drawn, style
from halfseen.study.compare import over_peer, row_of, where
from halfseen.study.experiments import EXPERIMENTS

BY_NAME = pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda each: each.name)


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


@pytest.mark.slow
@pytest.mark.parametrize("lead", [-4.0, 0.0, 3.0])
@BY_NAME
def test_nothing_written_overlaps_or_leaves_the_figure(experiment, lead):
    for drawing in example(experiment, lead=lead, gain=0.1 * lead).section.drawings:
        for title in (drawing.title, ""):
            with style():
                figure = drawing.draw(title)
                renderer = FigureCanvasAgg(figure).get_renderer()
                boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in texts(figure)]
            for text, box in boxes:
                inside = min(box.x0, box.y0) >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
                assert inside, (drawing.name, text)
            for (text, box), (other_text, other) in combinations(boxes, 2):
                across = min(box.x1, other.x1) - max(box.x0, other.x0)
                along = min(box.y1, other.y1) - max(box.y0, other.y0)
                # Two pixels: boxes are a little higher than the letters in them.
                assert min(across, along) < 2, (drawing.name, text, other_text)


@pytest.mark.slow
@BY_NAME
def test_figures_are_whole_and_the_same_again(experiment):
    for drawing in example(experiment).section.drawings:
        svg, again = (drawn(lambda drawing=drawing: drawing.draw(drawing.title), "svg") for _ in range(2))
        assert svg == again
        assert ElementTree.fromstring(svg).tag == "{http://www.w3.org/2000/svg}svg"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lead", "verdict", "title"),
    [
        (2.0, "supported", "earns more than the strongest planner"),
        (0.2, "inconclusive", "no significant difference from the strongest planner"),
        (-2.0, "not supported", "earns less than the strongest planner"),
    ],
)
def test_the_first_sentence_compares_on_the_same_episodes_and_every_hypothesis_is_reported(lead, verdict, title):
    _, _, tables, section = example(REWARD, 30, lead=lead)
    row = tables["table1"].query("baseline == 'planner-512' and measure == 'reward'").iloc[0]
    assert row["effect"] == pytest.approx(row["censored_q"] - row["other"])
    first = section.sentences[0]
    assert first.count("earns more than the strongest heuristic (history, counting the penalty): supported") == 1
    assert f"POMDP planner, 512 simulations): {verdict} (" in first
    assert f"{row['censored_q']:.2f} against {row['other']:.2f} a trajectory on the same 300 episodes" in first
    assert title in section.drawings[0].title
    result = next(each for each in section.sentences if each.startswith("Of the hypotheses")).split("; that")[0]
    rows = tables["table1"].query("measure == 'reward'")
    is_supported = rows["supported"].astype(bool)
    assert f"earns more is supported against {is_supported.sum()} of {len(REWARD.baseline_names)}" in result
    assert all(REWARD.contenders[name].label in result for name in rows["baseline"][~is_supported])
    if (num_worse := int((rows["effect_high"] < 0).sum())) > 0:
        assert f"not supported against {num_worse} (" in result
    figure1 = next(each for each in section.drawings if each.name == "figure1")
    with style():
        words = [text.get_text() for text in texts(figure1.draw(""))]
    assert sum("(0.50 ms)" in each for each in words) >= len(REWARD.baseline_names)


@pytest.mark.slow
def test_planners_stand_as_far_from_what_was_learned_as_on_the_episodes_of_both_and_times_are_not_tested():
    _, pieces, tables, section = example(REWARD)
    figure1, table1 = tables["figure1"].set_index("policy"), tables["table1"]
    own = row_of(tables["figure1"], policy="censored_q", num_trajectories=800, cut_share=0.5)
    for name in REWARD.planner_names:
        gap = table1.query(f"baseline == '{name}' and measure == 'reward'").iloc[0]["effect"]
        assert own["mean_reward"] - figure1.loc[name, "mean_reward"] == pytest.approx(gap)
    assert figure1["role"].dropna().to_dict() == {"history-penalty": "best_heuristic", "planner-512": "best_planner"}
    is_time = table1["measure"] == "decision_ms"
    assert table1.loc[is_time, ["p_value", "p_holm", "supported"]].isna().all(axis=None)
    assert table1.loc[~is_time, "p_holm"].notna().all()
    listing = next(each for each in section.listings if each.label == "Table 1")
    assert any("measured on this machine" in heading for heading in listing.groups)
    # The planner with fitted laws stands beside what was learned from each log.
    place = {"num_trajectories": 50, "cut_share": 1 / 3}
    over, learned = (
        np.mean([row[what] for piece in pieces.repetitions for row in piece[of] if place.items() <= row.items()])
        for of, what, place in (
            ("peer", "over_peer", place),
            ("rows", "reward", place | {"policy": "censored_q"}),
        )
    )
    line = row_of(tables["figure1"], policy=REWARD.peer.name, **place)
    assert line["mean_reward"] == pytest.approx(learned - over)
    assert row_of(tables["peer"], **place)["effect"] == pytest.approx(over)
    rows = tables["peer"].query("num_trajectories == 50")
    is_mean = rows["cut_share"].isna()
    assert rows.loc[is_mean, "effect"].item() == pytest.approx(rows.loc[~is_mean, "effect"].mean())
    assert len(tables["peer"]) == len(REWARD.num_trajectories) * (len(REWARD.cut_shares) + 1)


def test_what_is_made_of_logs_stands_above_the_strongest_heuristic_on_the_same_episodes():
    _, pieces, tables, section = example(REWARD)
    rule = where(pieces.table("baselines"), policy="history-penalty")["reward"]
    figure1 = tables["figure1"]
    for name in REWARD.beside_names:
        of_size = where(pieces.rows, policy=name, num_trajectories=25)["reward"]
        rows = where(figure1, policy=name, num_trajectories=25)
        mean = rows[rows["cut_share"].isna()].iloc[0]
        assert mean["gain"] == pytest.approx(np.mean(of_size) - rule.mean())
        assert mean["mean_reward"] == pytest.approx(np.mean(of_size))
    best = row_of(figure1, policy="history-penalty")
    assert (best["gain"], best["gain_se"]) == (0.0, 0.0)
    result = next(each for each in section.sentences if each.startswith("Above the strongest heuristic"))
    own = row_of(figure1, policy="censored_q", num_trajectories=25, cut_share=0.5)["gain"]
    assert f"the learned policy earns {own:.2f} (".replace("-", "−") in result
    assert all(words in result for words in ("Q₁ with laws fitted", "linear eq. 3 without laws", "with fitted laws"))
    assert "contradicted the laws fitted to it" in section.listings[-1].caption
    assert "in 17\u00a0% of all cases, at a single size and proportion in at most" in section.listings[-1].caption


def test_what_is_learned_over_the_planner_needs_few_of_its_episodes():
    rng = np.random.default_rng(0)
    episode, own, learned = rng.normal(0.0, 10.0, 50), rng.normal(1.0, 0.1, 50), rng.normal(3.0, 1.0, 50)
    mean = 2.0 + episode
    everywhere = over_peer(episode + learned, mean, range(50), episode + own)
    assert everywhere == pytest.approx(np.mean(learned - own))
    assert over_peer(episode + learned, mean, [3, 17], (episode + own)[[3, 17]]) == pytest.approx(everywhere, abs=0.3)


def test_planners_are_compared_on_the_episodes_that_they_played():
    _, _, tables, section = example(PLANNING, lead=1.0)
    figure2 = tables["figure2"].set_index("policy")
    assert figure2.loc["planner-1024", "over_censored_q"] == pytest.approx(-1.0, abs=0.3)
    assert figure2.loc["planner-1024", "episodes"] == dict(PLANNING.simulations)[1024]
    assert set(figure2["kind"]) == {"learned", "heuristic", "planner"}
    by_simulations, by_steps = section.sentences[:2]
    assert "1,024 simulations a decision, earns more than" in by_simulations
    assert ": not supported (" in by_simulations
    assert by_steps.startswith("Looking 6 steps ahead, with 128 simulations a decision, earns more than looking 1 step")
    assert ": supported (" in by_steps


@pytest.mark.parametrize(
    ("gain", "verdict", "title"), [(0.02, "supported", "from logs of every size"), (-0.02, "not supported", "does not")]
)
def test_the_papers_claim_is_said_to_hold_only_where_it_does(gain, verdict, title):
    section = example(GRASP, 16, gain=gain).section
    assert f"predicts grasps better than the mean of a Beta: {verdict} (" in section.sentences[0]
    assert title in section.drawings[0].title


def test_calibration_has_an_error_over_repetitions():
    _, pieces, tables, _ = example(GRASP)
    row = tables["figure5"].query("model == 'beta' and num_trajectories == 50").iloc[3]
    bins = where(pieces.rows, model="beta", num_trajectories=50)["bins"]
    attempts, said, won = (np.array([each[k][3] for each in bins]) for k in ("attempts", "probabilities", "successes"))
    assert row["difference"] == pytest.approx((won.sum() - said.sum()) / attempts.sum())
    residual = won - said - row["difference"] * attempts
    assert row["se"] == pytest.approx(np.sqrt(6 / 5 * np.sum(residual**2)) / attempts.sum())


@pytest.mark.slow
def test_planners_that_play_in_few_repetitions_are_compared_on_those():
    setting, pieces, _, _ = example(REWARD, 30)
    few, design = list(pieces.repetitions), replace(REWARD, planned_repetitions=8)
    planned = [*REWARD.planner_names, REWARD.peer.name]
    for k, piece in enumerate(few[8:], start=8):
        played = [row for row in piece["baselines"] if row["policy"] not in planned]
        few[k] = piece | {"peer": [], "baselines": played}
    tables, alone = (design.tabulate(setting, pieces._replace(repetitions=some)) for some in (few, few[:8]))
    counts = tables["figure1"].groupby("policy")["repetitions"].unique().map(list).to_dict()
    names = (*REWARD.baseline_names, "censored_q")
    assert counts == {name: [8 if name in planned else 30] for name in names}
    pd.testing.assert_frame_equal(*(of["figure1"][of["figure1"]["policy"].isin(planned)] for of in (tables, alone)))
    pd.testing.assert_frame_equal(tables["peer"], alone["peer"])
    caption = design.section(setting, tables).drawings[0].caption
    assert "in 8 of the repetitions, plays some of the episodes" in caption
    assert "in 8 of" not in design.section(replace(setting, repetitions=8), alone).drawings[0].caption


@pytest.mark.slow
@pytest.mark.parametrize(("lead", "words"), [(3.0, "better than"), (-2.56, "about as well as"), (-6.0, "worse than")])
def test_the_report_opens_with_what_each_way_brings_above_leaving_the_table(lead, words):
    setting, _, tables, section = example(REWARD, 30, lead=lead)
    figure1, opening = tables["figure1"], section.opening
    nothing = -5.0 * 0.6 * np.mean([scene.num_objects for scene in setting.scenes])
    ours = row_of(figure1, policy="censored_q", num_trajectories=800, cut_share=0.5)["mean_reward"] - nothing
    theirs = row_of(figure1, role="best_heuristic")["mean_reward"] - nothing
    assert f"cut short, clears a table {words}" in opening.title
    assert f"{ours:.1f} points a table, against {theirs:.1f}." in opening.title
    bars = [bar.get_width() for bar in opening.draw("").axes[0].patches]
    assert bars[1:3] == pytest.approx([theirs, ours])
    assert bars[0] <= bars[1]
