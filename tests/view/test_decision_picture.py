"""Pictures of decisions: what is on them, read from the SVG; the same decision gives the same bytes."""

import re
from dataclasses import replace

import pytest

from halfseen.perception import perceive, read_cloud
from halfseen.policies.decision import Decision
from halfseen.scene import table_paths
from halfseen.view.decision_picture import MOST_BARS, draw_decision

VALUES = {"FINISH": -2.0, **{f"{verb} {k}": 1.0 - 0.1 * k for verb in ("WASH", "LIFT") for k in range(5)}}
DECISION = Decision(
    action="LIFT 0",
    q_values=VALUES | {"LIFT 0": 1.5, "WASH 4": None},
    reason="LIFT 0: worth 0.50 more than WASH 0; it would lay bare 42% of object 3, of which nothing is known yet.",
    warnings=("num_objects is 5, outside the logs (1 to 3); Q is extrapolated",),
    intervals={name: (q - 0.2, q + 0.2) for name, q in (VALUES | {"LIFT 0": 1.5}).items() if name != "WASH 4"},
    chance_best={name: 0.61 if name == "LIFT 0" else 0.04 for name in VALUES if name != "WASH 4"},
)


@pytest.fixture(scope="module")
def view():
    return perceive(read_cloud(table_paths()[7]))


def bars_of(decision, trajectory):
    draw_decision(replace(decision, reason="because", warnings=()), trajectory, horizon=10)
    return {one.strip() for one in words_of(trajectory)[1:]} & VALUES.keys()


def words_of(path):
    return [re.sub(r"<[^>]*>", "", one) for one in re.findall(r"<text.*?</text>", path.read_text("utf-8"), re.DOTALL)]


def test_what_may_well_be_the_best_has_a_bar_however_little_it_is_worth(tmp_path):
    chances = {**DECISION.chance_best, "LIFT 4": 0.28}
    assert "LIFT 4" not in bars_of(DECISION, tmp_path / "a.svg")
    bars = bars_of(replace(DECISION, chance_best=chances), tmp_path / "b.svg")
    assert "LIFT 4" in bars
    assert len(bars) == MOST_BARS


def test_what_is_said_stands_on_the_picture(view, tmp_path):
    draw_decision(DECISION, tmp_path / "d.svg", view=view, stage=2, horizon=10)
    words = [one.strip() for one in words_of(tmp_path / "d.svg")]
    for told in ("LIFT 0", "stage 2 of 10", "61\u00a0%", "best", "0", "1", "2", "3", "4"):
        assert told in words
    told = " ".join(words)
    assert "value [reward]; 2 more not shown" in told
    assert "line: 95 % interval of Q" in told
    assert DECISION.reason in told
    assert "Warning: num_objects is 5" in told
    assert sum(bool(re.fullmatch(r"(WASH|LIFT) \d", one)) for one in words) == MOST_BARS + 1


def test_every_verb_and_an_object_that_is_not_seen_can_be_drawn_and_the_same_gives_the_same_bytes(view, tmp_path):
    for number, action in enumerate(("WASH 3", "FINISH", "PUSH 1", "LIFT 9", "LIFT 9")):
        draw_decision(replace(DECISION, action=action), tmp_path / f"{number}.png", view=view)
    first, *_, last, again = (file.read_bytes() for file in sorted(tmp_path.iterdir()))
    assert first.startswith(b"\x89PNG")
    assert last == again


def test_bars_alone_where_actions_have_names_and_nobody_knows_how_sure_it_is(tmp_path):
    decision = Decision("soft", {"soft": 0.58, "suction": 0.51, "stop": None}, "soft: worth 0.07 more than suction.")
    draw_decision(decision, tmp_path / "d.svg")
    told = " ".join(words_of(tmp_path / "d.svg"))
    assert "how sure nobody knows" in told
    assert "suction" in told
    assert "stop" not in told


def test_a_rule_that_values_nothing_is_drawn_without_bars(view, tmp_path):
    draw_decision(Decision("WASH 1", {}, "WASH 1: by GreedyPolicy."), tmp_path / "d.svg", view=view)
    assert "value [reward]" not in " ".join(words_of(tmp_path / "d.svg"))
