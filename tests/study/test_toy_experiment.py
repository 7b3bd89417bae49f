"""A new experiment is one class: it runs, resumes, tabulates, draws, claims and is reported like all others."""

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from halfseen.errors import ArgumentError
from halfseen.pages.axes import write_title
from halfseen.pages.sentences import Claim
from halfseen.progress import Progress
from halfseen.study.experiment import Drawing, Experiment, Listing, Section, Setting
from halfseen.study.run import run_study
from halfseen.study.runner import repetition, run_all, store_of
from halfseen.study.statistics import columns, estimate_in, over_repetitions
from halfseen.workers import Workers
from halfseen.world.scene import Scene

SETTING = Setting((Scene(np.zeros((2, 2)), name="two <cups>"),), repetitions=4)


@dataclass(frozen=True)
class Coin:
    """Whether a coin falls on heads more often than not."""

    bias: float = 0.9
    num_throws: int = 50
    most_repetitions: int | None = None
    name: ClassVar[str] = "coin"

    def prepare(self, setting):
        return {"half": 0.5}

    def repeat(self, setting, prepared, index):
        rng = np.random.default_rng([setting.seed, index])
        return {"index": index, "heads": float((rng.random(self.num_throws) < self.bias).mean()) - prepared["half"]}

    def tabulate(self, setting, pieces):
        gain = over_repetitions(np.array([piece["heads"] for piece in pieces.repetitions]))
        return {
            "coin": pd.DataFrame(
                [columns(gain, "gain", "se", "low", "high") | {"repetitions": len(pieces.repetitions)}]
            )
        }

    def section(self, setting, tables):
        row = tables["coin"].iloc[0]
        claim = Claim(
            "The coin", "beats", "loses to", "a fair one", estimate_in(row, "gain", "se", int(row["repetitions"]))
        )
        listing = Listing(
            "Table C", "Heads.", ("coin", "verdict"), {"": [("this one", claim.verdict)]}, is_folded=False
        )
        drawing = Drawing("coin_figure", "Figure C", claim.title, "One bar.", partial(self.draw, float(row["gain"])))
        return Section("Is the coin fair?", (claim.sentence,), (drawing,), (listing,))

    @staticmethod
    def draw(gain, title):
        figure = Figure(figsize=(4, 3))
        write_title(figure, title)
        figure.add_axes((0.1, 0.1, 0.8, 0.6)).bar([0], [gain])
        return figure


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("coin")
    run_study(SETTING, folder, (Coin(),), workers=Workers(1))
    return folder


def outputs(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_it_is_run_drawn_claimed_and_reported(folder):
    assert isinstance(Coin(), Experiment)
    assert set(outputs(folder)) == {"coin.csv", "coin_figure.svg", "coin_figure.png", "study.json", "report.html"}
    page = (folder / "report.html").read_text()
    for words in (
        "The coin beats a fair one: supported (difference 0.4",
        "<h2>Is the coin fair?</h2>",
        "Figure C.",
        '<span class="verdict supported">supported</span>',
        "two &lt;cups&gt;",
        "halfseen study --repetitions 4 --seed 0 --law assumed --only coin",
        "how often labels err is assumed, not estimated: that a grasp takes 9 times as long",
        "num_throws",
    ):
        assert words.casefold() in page.casefold()
    assert "http" not in page


def test_what_is_missing_is_made_again_to_the_same_bytes(folder, tmp_path):
    run_study(SETTING, tmp_path, (Coin(),), workers=Workers(1))
    assert outputs(tmp_path) == outputs(folder)
    (tmp_path / "progress/coin/repetition-00002.json").unlink()
    run_study(SETTING, tmp_path, (Coin(),), is_resumed=True, workers=Workers(1))
    assert outputs(tmp_path) == outputs(folder)


def test_more_repetitions_add_to_those_that_are_there(folder, tmp_path):
    run_study(SETTING, tmp_path, (Coin(),), workers=Workers(1))
    store = store_of(Coin(), SETTING, tmp_path, is_resumed=True)
    store.keep("repetition-00000", {"heads": 7.0, "index": 0})
    run_study(replace(SETTING, repetitions=6), tmp_path, (Coin(),), is_resumed=True, workers=Workers(1))
    assert len(list(store.folder.glob("repetition-*.json"))) == 6
    assert store.read("repetition-00000")["heads"] == 7.0


@pytest.mark.parametrize(
    "other", [{"hides": np.array([[0.0, 0.1], [0.0, 0.0]])}, {"grip": np.ones(2)}, {"places_m": np.ones((2, 2))}]
)
def test_a_scene_of_the_same_name_and_other_content_is_another_study(tmp_path, other):
    store_of(Coin(), SETTING, tmp_path, is_resumed=False)
    store_of(Coin(), SETTING, tmp_path, is_resumed=True)
    scenes = (replace(SETTING.scenes[0], **other),)
    with pytest.raises(ArgumentError, match="a study of another design"):
        store_of(Coin(), replace(SETTING, scenes=scenes), tmp_path, is_resumed=True)


@pytest.mark.parametrize("num_made", [0, 2])
def test_before_anything_is_made_no_time_left_is_foretold(tmp_path, monkeypatch, num_made):
    begun = []
    monkeypatch.setattr(Progress, "begin", lambda self, what, by=1: begun.append((what, by)))
    coins = [Coin(most_repetitions=3), type("Other", (Coin,), {"name": "other"})()]
    stores = [store_of(coin, SETTING, tmp_path, is_resumed=False) for coin in coins]
    for index in range(num_made):
        stores[0].keep(repetition(index), coins[0].repeat(SETTING, coins[0].prepare(SETTING), index))
    run_all(coins, SETTING, stores, Workers(1))
    assert begun[0] == ("study", pytest.approx(num_made / 3, abs=0.0, rel=1e-12))


@pytest.mark.parametrize(("bias", "words"), [(0.5, "inconclusive"), (0.1, "not supported")])
def test_a_claim_that_fails_is_said_to_fail(tmp_path, bias, words):
    results = run_study(SETTING, tmp_path, (Coin(bias=bias),), workers=Workers(1))
    assert f"beats a fair one: {words}" in results.answer[0]
