"""Table, words and figure of the regrets, from made-up pieces."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from example_regret import BASELINES, example_regret

from halfseen.study.figures import style
from halfseen.study.regret_figure import regret_figure_of
from halfseen.study.regret_words import best, regret_sentence, regret_title


def row_of(table, policy, num_paths=None, cut_share=None):
    is_it = table["policy"] == policy
    if num_paths is not None:
        is_it &= (table["num_paths"] == num_paths) & (table["cut_share"] == cut_share)
    assert is_it.sum() == 1
    return table[is_it].iloc[0]


def test_regrets_are_means_over_tables_with_errors_over_repetitions():
    table = example_regret()
    learned, heuristic, planner, optimum = (
        row_of(table, *which) for which in (("cql", 200, 0.5), ("history-penalty",), ("pomdp-2",), ("optimum",))
    )

    # Of the tables: (0.5 + 1.0) / 2; of the repetitions: 0, 0.1, 0.2.
    assert learned["regret"] == pytest.approx(0.75 + 0.1)
    assert learned["se"] == pytest.approx(0.1 / np.sqrt(3))
    assert learned["regret_share"] == pytest.approx(0.85 / 14.0)
    assert (learned["optimum"], learned["repetitions"]) == (5.0, 3)
    assert planner["regret"] == pytest.approx(0.3 + 0.05)
    assert planner["se"] == pytest.approx(0.05 / np.sqrt(3))
    assert (heuristic["regret"], heuristic["se"], optimum["regret"], optimum["se"]) == (2.25, 0.0, 0.0, 0.0)


def test_nulls_stand_where_nothing_was_learned_or_repeated_and_nowhere_else():
    table = example_regret()
    is_learned = table["policy"] == "cql"

    assert (table["num_paths"].isna() == ~is_learned).all()
    assert (table["cut_share"].isna() == ~is_learned).all()
    is_exact = table["policy"].isin([*BASELINES["regrets"], "optimum"])
    assert (table["repetitions"].isna() == is_exact).all()
    assert np.isfinite(table[["regret", "se", "regret_share", "optimum"]].to_numpy(dtype=float)).all()
    assert example_regret().to_csv(index=False) == table.to_csv(index=False)
    assert is_learned[: is_learned.sum()].all()


@pytest.mark.parametrize(
    ("end", "said"), [(1.0, "earns 0.85 less"), (3.0, "earns 1.35 less"), (0.0, "earns 0.60 less")]
)
def test_the_words_say_what_the_table_says(end, said):
    table = example_regret(end)
    sentence = regret_sentence(table, 0.5, num_tables=2, horizon=6)

    assert sentence.startswith("On 2 small tables, of three cups and 6 steps each, the best of all policies is known")
    assert "it earns 5.00 a path" in sentence
    assert f"Learned from 200 logged paths, of which about half were cut, a policy {said}" in sentence
    share = 100 * row_of(table, "cql", 200, 0.5)["regret_share"]
    assert f"which is {share:.1f} % of what" in sentence
    assert "from 50 paths, " in sentence
    assert "best planner (POMDP, 2 steps ahead) earns 0.35 less" in sentence
    assert "best heuristic (history, counting the penalty) 2.25 less" in sentence
    title = regret_title(table, 0.5)
    assert said in title
    assert title.endswith("the best planner 0.35, the best heuristic 2.25")


def test_one_size_of_log_and_no_cuts_read_well():
    table = example_regret()
    table = pd.DataFrame(table[(table["num_paths"].isna()) | (table["num_paths"] == 200)])
    sentence = regret_sentence(table, 0.0, 2, 6)
    assert "none of them cut" in sentence
    assert "; from" not in sentence
    assert best(table, is_planner=True) == "pomdp-2"


def test_the_figure_draws_every_policy_at_its_regret():
    table = example_regret()
    with style():
        figure = regret_figure_of(table, 0.5)
        axes = figure.axes[0]
        written = [text.get_text() for text in (*axes.texts, *figure.texts)]
        curves: list[Any] = [bars.get_children()[0] for bars in axes.containers]

    assert len(curves) == 2
    np.testing.assert_allclose(curves[1].get_ydata(), [row_of(table, "cql", size, 0.5)["regret"] for size in (50, 200)])
    for name in ("the best of all policies  0.00", "POMDP, 2 steps ahead  0.35", "learned, 1/2 of the paths cut  0.85"):
        assert name in written
    assert axes.get_ylim()[0] == 0.0
    assert "below that of the best of all policies" in axes.get_title(loc="left")
    assert regret_title(table, 0.5).split()[0] in written[-1]
