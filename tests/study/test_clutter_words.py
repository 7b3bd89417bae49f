import pandas as pd
import pytest
from example_map import WORLD, example_table

from halfseen.study.experiments.clutter import Clutter
from halfseen.study.experiments.clutter.table import ENOUGH, LEARN, NO_SCALE, UNDECIDED
from halfseen.study.experiments.clutter.words import factor_words, levels, map_sentence, map_title

DEAR = "washing a clean cup costs 4 times what a dirty one earns"


def said(share, design=None):
    table = example_table(share, design)
    return map_title(table, WORLD), map_sentence(table, design or Clutter(), WORLD)


@pytest.mark.parametrize(
    ("share", "title"),
    [
        (0.3, "Learning pays everywhere; the best heuristic is good enough nowhere"),
        (0.0, "Learning pays nowhere; the best heuristic is good enough everywhere"),
    ],
)
def test_one_verdict_everywhere(share, title):
    assert said(lambda place: share)[0] == title


def test_nothing_can_be_said():
    table = example_table(lambda place: 0.05)
    table["verdict"] = UNDECIDED
    assert map_title(table, WORLD) == "Learning pays nowhere; the best heuristic is good enough nowhere"
    assert "99 places are inconclusive" in map_sentence(table, Clutter(), WORLD)


def test_the_factor_that_decides_is_named_with_its_count():
    title, sentence = said(lambda place: 0.3 if place.reward_wash_clean == -20 else 0.0)
    assert title.startswith(
        f"Learning pays in 27 of 99 places, most often where {DEAR} (27 of 27); the best heuristic is good enough in "
    )
    assert sentence.startswith(f"{title}. It pays where the policy learned from 200 logged paths, of which about half ")
    assert "gains more than 5 % of what the best heuristic earns above finishing at once" in sentence


def test_losses_are_counted():
    _, sentence = said(lambda place: -0.2 if place.num_objects == 3 else 0.0)
    assert "where it gains less (a loss in 3" in sentence


def test_a_verdict_that_is_rare_is_said_to_be_rare():
    title, _ = said(lambda place: 0.3 if (place.num_objects, place.occlusion) == (3, 0.1) else 0.0)
    assert title.startswith(
        "Learning pays in 11 of 99 places, most often where 3 objects stand on the table (11 of 33)"
    )


def test_no_factor_is_blamed_for_another():
    # What is dear is learned; spreads were varied where it is not dear, and so tell nothing apart.
    table = example_table(lambda place: 0.3 if place.reward_wash_clean == -20 else 0.0)
    spreads = [level for level in levels(table, LEARN) if level.factor == "grip_offset_std"]
    assert [(level.num_places, level.num_verdicts) for level in spreads] == [(9, 0)] * 3
    labels = [level for level in levels(table, LEARN) if level.factor == "labels"]
    assert [(level.num_places, level.num_verdicts) for level in labels] == [(27, 9)] * 3


def test_places_without_a_scale_are_counted():
    table = example_table(lambda place: 0.0)
    table.loc[:4, "verdict"] = NO_SCALE
    sentence = map_sentence(table, Clutter(), WORLD)
    assert sentence.endswith("and in 5 the heuristic earns next to nothing above finishing at once.")


def test_a_map_of_one_place_has_words():
    design = Clutter((3,), (0.1,), (1.0,), (-10.0,), (1.0,))
    for share in (0.3, 0.0):
        assert "everywhere" in said(lambda place, share=share: share, design)[0]
    assert levels(example_table(lambda place: 0.0, design), ENOUGH) == []


@pytest.mark.parametrize(
    ("factor", "value", "words"),
    [
        ("num_objects", 9.0, "9 objects stand on the table"),
        ("occlusion", 0.3, "30 % of an object is hidden on average"),
        ("labels", 0.15, "a label in full view is right 65 % of the time"),
        ("reward_wash_clean", -5.0, "washing a clean cup costs as much as a dirty one earns"),
        ("grip_offset_std", 1.5, "grip offsets spread by 1.5"),
    ],
)
def test_levels_in_words(factor, value, words):
    assert factor_words(factor, value, WORLD) == words


def test_the_assumed_laws_are_counted_apart():
    table = example_table(lambda place: 0.3 if place.num_objects == 3 else 0.0)
    beside = table.head(9).assign(is_assumed=True)
    alone, both = (map_title(each, WORLD) for each in (table, pd.concat([table, beside])))
    num = int((beside["verdict"] == LEARN).sum())
    assert 0 < num < 9
    assert both == f"{alone}; under the assumed laws, these are {num} and {9 - num} of 9"


def test_what_is_hardly_ever_so_does_not_stand_out():
    table = example_table(lambda place: 0.0)
    table.loc[:1, "verdict"] = LEARN
    assert map_title(table, WORLD).startswith("Learning pays in 2 of 99 places; the best heuristic")
