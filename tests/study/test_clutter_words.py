import pandas as pd
import pytest
from example_map import WORLD, example_table

from halfseen.study.experiments.clutter import Clutter
from halfseen.study.experiments.clutter.table import LEARN
from halfseen.study.experiments.clutter.words import factor_words, levels, map_sentence, map_title

DEAR = "washing a clean cup costs 4 times what a dirty one earns"


def said(share, design=None):
    table = example_table(share, design)
    return map_title(table, WORLD), map_sentence(table, design or Clutter(), WORLD)


def test_the_factor_that_decides_is_named_with_its_count():
    title, sentence = said(lambda place: 0.3 if place.reward_wash_clean == -20 else 0.0)
    assert title.startswith(
        f"Learning pays in 27 of 99 places, most often where {DEAR} (27 of 27); the best heuristic is good enough in "
    )
    assert sentence.startswith(f"{title}. It pays where the policy learned from 200 logged paths, of which about half ")
    assert "gains more than 5 % of what the best heuristic earns above finishing at once" in sentence


def test_no_factor_is_blamed_for_another():
    # What is dear is learned; spreads were varied where it is not dear, and so tell nothing apart.
    table = example_table(lambda place: 0.3 if place.reward_wash_clean == -20 else 0.0)
    spreads = [level for level in levels(table, LEARN) if level.factor == "grip_offset_std"]
    assert [(level.num_places, level.num_verdicts) for level in spreads] == [(9, 0)] * 3
    labels = [level for level in levels(table, LEARN) if level.factor == "labels"]
    assert [(level.num_places, level.num_verdicts) for level in labels] == [(27, 9)] * 3


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
