"""A new experiment is one class: it runs, resumes, tabulates, draws, claims and is reported like all others."""

import shutil
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from halfseen.errors import ArgumentError
from halfseen.figures import write_title
from halfseen.progress import Progress
from halfseen.study.compare import columns, estimate_in, over_repetitions
from halfseen.study.experiment import Drawing, Experiment, Listing, Section
from halfseen.study.runner import repetition, run_all, run_study, store_of
from halfseen.study.setting import Setting
from halfseen.study.store import Store, as_json
from halfseen.wording import Claim
from halfseen.workers import Workers
from halfseen.world.scene import Scene

SETTING = Setting((Scene(np.zeros((2, 2)), name="two <cups>"),), repetitions=4)
ALONE = Workers(1)


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
        row = columns(gain, "gain", "se", "low", "high") | {"repetitions": len(pieces.repetitions)}
        return {"coin": pd.DataFrame([row])}

    def section(self, setting, tables):
        row = tables["coin"].iloc[0]
        gain = estimate_in(row, "gain", "se", int(row["repetitions"]))
        claim = Claim("The coin", "beats", "loses to", "a fair one", gain)
        cells = {"": [("this one", claim.verdict)]}
        listing = Listing("Table C", "Heads.", ("coin", "verdict"), cells, is_folded=False)
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
    run_study(SETTING, folder, (Coin(),), workers=ALONE)
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


def test_what_is_missing_is_made_again_to_the_same_bytes_and_more_repetitions_are_added(folder, tmp_path):
    run_study(SETTING, tmp_path / "new", (Coin(),), workers=ALONE)
    assert outputs(tmp_path / "new") == outputs(folder)
    shutil.copytree(folder / "progress", tmp_path / "again" / "progress")
    (tmp_path / "again/progress/coin/repetition-00002.json").unlink()
    run_study(SETTING, tmp_path / "again", (Coin(),), is_resumed=True, workers=ALONE)
    assert outputs(tmp_path / "again") == outputs(folder)
    store = store_of(Coin(), SETTING, tmp_path / "again", is_resumed=True)
    store.keep("repetition-00000", {"heads": 7.0, "index": 0})
    run_all((Coin(),), replace(SETTING, repetitions=6), [store], ALONE)
    assert len(list(store.folder.glob("repetition-*.json"))) == 6
    assert store.read("repetition-00000")["heads"] == 7.0


@pytest.mark.parametrize(
    "other", [{"hides": np.array([[0.0, 0.1], [0.0, 0.0]])}, {"grip": np.ones(2)}, {"places_m": np.ones((2, 2))}]
)
def test_a_scene_of_the_same_name_and_other_content_is_another_study(tmp_path, other):
    for is_resumed in (False, True):
        store_of(Coin(), SETTING, tmp_path, is_resumed=is_resumed)
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
    run_all(coins, SETTING, stores, ALONE)
    assert begun[0] == ("study", pytest.approx(num_made / 3, abs=0.0, rel=1e-12))


@pytest.mark.parametrize(("bias", "words"), [(0.5, "inconclusive"), (0.1, "not supported")])
def test_a_claim_that_fails_is_said_to_fail(tmp_path, bias, words):
    results = run_study(SETTING, tmp_path, (Coin(bias=bias),), workers=ALONE)
    assert f"beats a fair one: {words}" in results.answer[0]


DESIGN = {"seed": 0}


def store(folder, design=DESIGN, *, is_resumed=True):
    return Store(folder, design, is_resumed=is_resumed)


def again():
    raise AssertionError("it is there already")


def test_pieces_come_back_unless_a_study_is_begun_anew_and_are_never_of_another_design(tmp_path):
    folder = tmp_path / "new" / "study"
    piece = {"values": [0.1, 1 / 3, 1e-300], "names": ["ö"]}
    first = store(folder, is_resumed=False)
    assert first.kept("piece", lambda: piece) == first.kept("piece", again) == piece
    with pytest.raises(ArgumentError, match=r"--resume: .*belongs to a study of another design, seed or version"):
        store(folder, {"seed": 1})
    assert store(folder).kept("piece", again) == piece
    assert store(folder, is_resumed=False).kept("piece", lambda: [2]) == [2]


@pytest.mark.parametrize("change", [("1.5", "1.6"), ('"sha256"', '"sha512"'), ("1.5", ""), ("{", "[")])
def test_a_piece_that_was_changed_is_not_believed(tmp_path, change):
    store(tmp_path, is_resumed=False).keep("piece", {"value": 1.5})
    file = tmp_path / "piece.json"
    file.write_text(file.read_text().replace(*change, 1))
    with pytest.raises(ArgumentError, match=r"piece.json cannot be read .*; remove it and go on with --resume"):
        store(tmp_path).read("piece")


def test_the_same_value_gives_the_same_bytes_and_nan_is_refused():
    assert as_json({"a": 1, "b": 2}) == as_json({"b": 2, "a": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        as_json(float("nan"))


def test_what_no_study_wrote_is_not_removed(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ArgumentError, match=r"holds no study .design.json is missing., so it is not removed"):
        store(tmp_path, is_resumed=False)
    assert (tmp_path / "notes.txt").read_text() == "mine"
