"""Figures of logs, policies and decisions: what is drawn, beside loops and the policy itself."""

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from halfseen.evaluation.specification import task_of
from halfseen.figures import inline_svg, style
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.perception import perceive, read_cloud
from halfseen.policies.decision import Decision
from halfseen.scene import table_paths
from halfseen.view.decision_picture import MOST_BARS, draw_decision
from halfseen.view.log_figures import OTHERS, action_colours, draw_follow_up, draw_timeline
from halfseen.view.log_findings import MOST_ROWS, UNKNOWN_ACTION, endings, follow_up, timeline
from halfseen.view.policy_figures import FEW_STATES, draw_choices, draw_map, draw_table_map
from halfseen.view.policy_findings import FEWEST_NEAR, NEAR, policy_maps, supported, table_map
from halfseen.world import ActionSpace
from small_logs import table_log
from small_report import ACTIONS, COVARIATES, hostile_log


def log_of(trajectories):
    """Trajectories as (times of completed stages, time of the cut or None, cause, action of the cut stage)."""
    stages, ends = [], []
    for number, (times, cut_s, cause, last) in enumerate(trajectories):
        done = [(elapsed_s, f"a{stage}", 0.0) for stage, elapsed_s in enumerate(times, start=1)]
        done += [] if cut_s is None else [(None, last, None)]
        stages += [(number, stage, *row) for stage, row in enumerate(done, start=1)]
        ends.append((number, times[-1] if cut_s is None else cut_s, "cut" if cut_s else "finished", cause))
    frame = pd.DataFrame(stages, columns=["trajectory", "stage", "elapsed_s", "action", "reward"])
    return Logs(
        frame.astype({"elapsed_s": float, "reward": float}),
        pd.DataFrame(ends, columns=["trajectory", "end_s", "ending", "cause"]),
    )


def many(num_trajectories, num_stages=2, seed=0):
    rng = np.random.default_rng(seed)
    clocks = np.cumsum(rng.uniform(0.5, 2.0, (num_trajectories, num_stages)), axis=1)
    return log_of([(clock.tolist(), None, None, None) for clock in clocks])


def test_rows_are_trajectories_by_how_they_ended_and_then_by_length():
    finished, cut = [([1.0, 4.0], *[None] * 3), ([3.0], *[None] * 3)], [([1.0], 2.0, "operator", "b")]
    others = [([], 0.5, "operator", None), ([1.0], 5.0, "battery", "b")]
    result = timeline(log_of([finished[0], *cut, finished[1], *others]))
    groups = [(group.name, group.num_trajectories) for group in result.endings]
    assert groups == [("finished", 2), ("cut: operator", 2), ("cut: battery", 1)]
    assert result.end_s.tolist() == [3.0, 4.0, 0.5, 2.0, 5.0]
    pieces = set(result.stages.itertuples(index=False, name=None))
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
    result = timeline(both)
    assert [group.num_rows for group in result.endings] == [MOST_ROWS, 1]
    ends_s = np.sort(logs.end_s)
    assert result.end_s[[0, MOST_ROWS - 1]].tolist() == ends_s[[0, -1]].tolist()
    assert result.end_s[: MOST_ROWS // 2].max() == pytest.approx(np.median(ends_s), abs=0.05)


@pytest.mark.slow
def test_a_log_of_many_long_trajectories_is_a_small_drawing_without_names_of_trajectories():
    result = timeline(many(3000, num_stages=30))
    colours = action_colours(sorted(set(result.stages["action"])))
    svg = inline_svg(lambda: draw_timeline(result, colours), "f", "t")
    assert result.num_rows == MOST_ROWS
    assert len(svg) < 500_000
    assert OTHERS in svg


def choices(num_actions, counts=(800, 40, 3)):
    share = 1.0 / num_actions
    every = {f"action {k}": share for k in range(num_actions)}
    result = {"as_logged": 0.5, "policy": every | {"never": 0.0}, "logged": every | {"never": 0.0}}
    return [{"stage": stage, "num_states": count, **result} for stage, count in enumerate(counts, start=1)]


@pytest.mark.slow
@pytest.mark.parametrize("num_actions", [1, 2, 4, 7, 9, 10, 12])
def test_every_cell_has_an_action_or_the_legend_and_few_states_are_small_and_hollow(num_actions):
    figure = draw_choices(choices(num_actions))
    titled = [axes for axes in figure.axes if axes.get_title(loc="left")]
    blank = [axes for axes in figure.axes if axes not in titled]
    assert len(titled) == min(num_actions, 9)
    assert len(blank) <= 1
    assert all(axes.get_legend() is not None for axes in blank)
    assert bool(figure.legends) != bool(blank)
    if num_actions == 1:
        marks = figure.axes[0].collections[0]
        area = marks.get_sizes()
        assert area[0] / area[1] > 10 > 1
        hollow = [tuple(face[:3]) == (1.0, 1.0, 1.0) for face in np.asarray(marks.get_facecolors())]
        assert hollow == [count < FEW_STATES for count in (800, 40, 3)]
        assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["1\n(800)", "2\n(40)", "3\n(3)"]


LONG = ["the operator pressed the emergency stop", "a_collision_was_foreseen_by_the_guard_of_the_cell", "battery"]


@pytest.mark.slow
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


@pytest.fixture(scope="module")
def logs():
    return hostile_log(num_trajectories=80)


@pytest.fixture(scope="module")
def policy(logs):
    return CensoredQLearner.of_paper(2, ACTIONS, COVARIATES, reg=0.1).fit(logs).policy_


def test_a_map_is_what_the_policy_decides_with_the_rest_in_the_middle_names_its_covariates_and_hatches(policy, logs):
    first, _ = policy_maps(policy, logs, COVARIATES)
    states = logs.stages[logs.stages["stage"] == 1]
    for row, column in ((0, 0), (40, 70), (89, 3)):
        at = {COVARIATES[0]: [first.across[column]], COVARIATES[1]: [first.up[row]]}
        assert first.taken[row, column] == policy.decide(pd.DataFrame(at), 1)[0]
    assert first.across[[0, -1]] == pytest.approx(np.quantile(states[COVARIATES[0]], [0.01, 0.99]))
    assert len(first.dots) == len(states)
    assert first.done.tolist() == states["action"].tolist()
    assert first.middle == {}
    svg = inline_svg(lambda: draw_map(first, action_colours(ACTIONS)), "f", "t")
    assert "y_$2$" in svg
    assert "x&lt;1&gt;" in svg
    assert ("<pattern" in svg) == (not first.is_supported.all())
    assert len(svg) < 100_000
    one = CensoredQLearner.of_paper(2, ACTIONS, COVARIATES[:1], reg=0.1).fit(logs).policy_
    strip = policy_maps(one, logs, COVARIATES[:1])[0]
    assert (strip.up, strip.taken.shape[0]) == (None, 1)
    assert "the policy" in inline_svg(lambda: draw_map(strip, action_colours(ACTIONS)), "f", "t")
    assert policy_maps(one, logs, []) == []


@pytest.mark.parametrize("num_covariates", [1, 2])
def test_support_is_enough_states_nearby_by_a_loop(num_covariates):
    rng = np.random.default_rng(0)
    states = (rng.normal(size=(60, 2)) * [1.0, 100.0])[:, :num_covariates]
    across, up = np.linspace(-3.0, 3.0, 12), np.linspace(-300.0, 300.0, 9)
    places = [[x, y][:num_covariates] for y in (up if num_covariates == 2 else [0.0]) for x in across]
    scaled, near = states / states.std(axis=0), np.array(places) / states.std(axis=0)
    by_loop = [sum(np.linalg.norm(place - one) <= NEAR for one in scaled) >= FEWEST_NEAR for place in near]
    assert supported(np.array(places), states).tolist() == by_loop
    assert 0 < sum(by_loop) < len(places)
    assert not supported(np.array(places), states[: FEWEST_NEAR - 1]).any()


@pytest.mark.slow
def test_objects_of_a_log_are_counted_by_what_the_policy_would_do_to_them(monkeypatch):
    monkeypatch.setattr("halfseen.view.policy_findings.FEWEST_OBJECTS", 1)
    logs = table_log(num_trajectories=60)
    policy = CensoredQLearner.for_table(3, reg=0.1).fit(logs).policy_
    task = task_of(policy, logs)
    result = table_map(policy, task, logs)
    taken = task.target_probabilities(policy, logs, 3)
    num = {"WASH": 0, "LIFT": 0}
    ids = list(logs.trajectory_ids)
    for trajectory, stage in zip(logs.stages["trajectory"], logs.stages["stage"], strict=True):
        chances = taken[ids.index(trajectory), stage - 1]
        name = ActionSpace.of_size(len(chances)).names[int(np.argmax(chances))].split()[0]
        num[name] = num.get(name, 0) + 1
    on_table = (logs.objects["location"] == "TABLE").sum()
    assert result.num_objects.sum() == on_table
    for verb, share in result.share.items():
        assert np.nansum(share * result.num_objects) == pytest.approx(num[verb])
        assert verb in inline_svg(lambda verb=verb: draw_table_map(result, verb), "f", "t")
    bare = Logs(logs.stages, logs.trajectories, logs.objects.drop(columns="log_odds"))
    assert table_map(policy, task, bare) is None


VALUES = {"FINISH": -2.0, **{f"{verb} {k}": 1.0 - 0.1 * k for verb in ("WASH", "LIFT") for k in range(5)}}
DECISION = Decision(
    action="LIFT 0",
    q_values=VALUES | {"LIFT 0": 1.5, "WASH 4": None},
    reason="LIFT 0: worth 0.50 more than WASH 0; it would uncover 42% of object 3, not labelled yet.",
    warnings=("num_objects is 5, outside the logs (1 to 3); Q is extrapolated",),
    intervals={name: (q - 0.2, q + 0.2) for name, q in (VALUES | {"LIFT 0": 1.5}).items() if name != "WASH 4"},
    chance_best={name: 0.61 if name == "LIFT 0" else 0.04 for name in VALUES if name != "WASH 4"},
)


@pytest.fixture(scope="module")
def view():
    return perceive(read_cloud(table_paths()[7]))


def words_on(file, decision, **options):
    """What is written on the picture of a decision."""
    draw_decision(decision, file, **options)
    texts = re.findall(r"<text.*?</text>", file.read_text("utf-8"), re.DOTALL)
    return [re.sub(r"<[^>]*>", "", each).strip() for each in texts]


def test_what_may_well_be_the_best_has_a_bar_however_little_it_is_worth(tmp_path):
    bare = replace(DECISION, reason="because", warnings=())
    likely = replace(bare, chance_best={**DECISION.chance_best, "LIFT 4": 0.28})
    few, more = (set(words_on(tmp_path / "d.svg", each, horizon=10)[1:]) & VALUES.keys() for each in (bare, likely))
    assert "LIFT 4" not in few
    assert "LIFT 4" in more
    assert len(more) == MOST_BARS


@pytest.mark.slow
def test_what_is_said_stands_on_the_picture_and_bars_only_where_values_are_known(view, tmp_path):
    words = words_on(tmp_path / "d.svg", DECISION, view=view, stage=2, horizon=10)
    for message in ("LIFT 0", "stage 2 of 10", "61\u00a0%", "best", "0", "1", "2", "3", "4"):
        assert message in words
    message = " ".join(words)
    assert "value [reward]; 2 more not shown" in message
    assert "line: 95 % interval of Q" in message
    assert DECISION.reason in message
    assert "Warning: num_objects is 5" in message
    assert sum(bool(re.fullmatch(r"(WASH|LIFT) \d", one)) for one in words) == MOST_BARS + 1
    named = Decision("soft", {"soft": 0.58, "suction": 0.51, "stop": None}, "soft: worth 0.07 more than suction.")
    message = " ".join(words_on(tmp_path / "d.svg", named))
    assert "no interval known" in message
    assert "suction" in message
    assert "stop" not in message
    rule = Decision("WASH 1", {}, "WASH 1: by GreedyPolicy.")
    assert "value [reward]" not in " ".join(words_on(tmp_path / "d.svg", rule, view=view))


@pytest.mark.slow
def test_every_verb_and_an_object_that_is_not_seen_can_be_drawn_and_the_same_gives_the_same_bytes(view, tmp_path):
    for action in ("WASH 3", "FINISH", "PUSH 1"):
        draw_decision(replace(DECISION, action=action), tmp_path / "d.svg", view=view)
    for name in ("one.png", "other.png"):
        draw_decision(replace(DECISION, action="LIFT 9"), tmp_path / name, view=view)
    one, other = ((tmp_path / name).read_bytes() for name in ("one.png", "other.png"))
    assert one.startswith(b"\x89PNG")
    assert one == other
