"""A new experiment is one class: it runs, resumes, tabulates, draws, claims and is reported like all others."""

import shutil
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.study.compare import means, wide
from halfseen.study.experiment import Experiment
from halfseen.study.runner import run_study
from halfseen.study.setting import Setting
from halfseen.workers import Workers
from halfseen.world.scene import Scene

SETTING = Setting((Scene(np.zeros((2, 2)), name="two <cups>"),), repetitions=4)
ALONE = Workers(1)


@dataclass(frozen=True)
class Coin(Experiment):
    """Whether a coin falls on heads more often than not."""

    bias: float = 0.9
    num_throws: int = 50
    most_repetitions: int | None = None
    name: ClassVar[str] = "coin"
    texts: ClassVar[str] = """
        heading = "Is the coin fair?"
        sentences = ["{{ fair.sentence }}"]
        [claims.fair]
        row = "row_of(coin)"
        columns = "heads"
        subject = "The coin"
        more = "beats"
        less = "loses to"
        rival = "a fair one"
        [[figures]]
        name = "coin_figure"
        label = "Figure C"
        title = "{{ fair.title }}"
        caption = "One point."
        size = [4, 3]
        below = 0.2
        grid = { bottom = 0.2 }
        [[figures.panels]]
        title = "heads"
        layers = [{ draw = "bars", rows = "coin", x = "side", y = "heads", look = { color = "BLUE" } }]
        [[tables]]
        label = "Table C"
        caption = "Heads."
        rows = "coin"
        folded = false
        cells = { coin = "'this one'", verdict = "fair.verdict" }"""

    def prepare(self, setting):
        return {"half": 0.5}

    def repeat(self, setting, prepared, index):
        rng = np.random.default_rng([setting.seed, index])
        return {"rows": [{"side": 0, "heads": (rng.random(self.num_throws) < self.bias).mean() - prepared["half"]}]}

    def tabulate(self, setting, pieces):
        heads = wide(pieces.rows, ["side"], "heads")
        return {"coin": means(heads, ("heads", "heads_se", "heads_low", "heads_high")).reset_index()}


def run(folder, *coins, setting=SETTING, is_resumed=False):
    return run_study(setting, folder, coins or (Coin(),), is_resumed=is_resumed, workers=ALONE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("coin")
    run(folder)
    return folder


@pytest.fixture
def copied(folder, tmp_path):
    """What was kept of that study."""
    shutil.copytree(folder / "progress", tmp_path / "progress")
    return tmp_path


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
        "laws of grasping and seeing are assumed, not estimated: a grasp takes 9 times as long",
        "num_throws",
    ):
        assert words.casefold() in page.casefold()
    assert "http" not in page


@pytest.mark.slow
def test_what_is_missing_is_made_again_to_the_same_bytes_and_more_repetitions_are_added(folder, copied, monkeypatch):
    kept, made, repeat = copied / "progress" / "coin", [], Coin.repeat
    monkeypatch.setattr(Coin, "repeat", lambda *given: (made.append(given[-1]), repeat(*given))[1])
    (kept / "repetition-00002.json").unlink()
    run(copied, is_resumed=True)
    assert (made, outputs(copied)) == ([2], outputs(folder))
    run(copied, setting=replace(SETTING, repetitions=6), is_resumed=True)
    assert made == [2, 4, 5]
    assert len(list(kept.glob("repetition-*.json"))) == 6
    # Begun again, it makes all of them.
    run(copied)
    assert (made[3:], outputs(copied)) == ([0, 1, 2, 3], outputs(folder))


@pytest.mark.parametrize(
    "other",
    [
        replace(SETTING, seed=1),
        *(
            replace(SETTING, scenes=(replace(SETTING.scenes[0], **changed),))
            for changed in (
                {"hides": np.array([[0.0, 0.1], [0.0, 0.0]])},
                {"grip": np.ones(2)},
                {"places_m": np.ones((2, 2))},
            )
        ),
    ],
    ids=["seed", "hides", "grip", "places"],
)
def test_another_seed_or_a_scene_of_the_same_name_and_other_content_is_another_study(copied, other):
    with pytest.raises(ArgumentError, match=r"--resume: .*belongs to a study of another design, seed or version"):
        run(copied, setting=other, is_resumed=True)


def test_pieces_of_before_are_of_another_study(copied):
    file = copied / "progress" / "coin" / "design.json"
    file.write_text(file.read_text().replace(' "format": 2,\n', ""))
    with pytest.raises(ArgumentError, match="belongs to a study of another design, seed or version"):
        run(copied, is_resumed=True)


@pytest.mark.parametrize(("bias", "words"), [(0.5, "inconclusive"), (0.1, "not supported")])
def test_a_claim_that_fails_is_said_to_fail(tmp_path, bias, words):
    assert f"beats a fair one: {words}" in run(tmp_path, Coin(bias=bias)).answer[0]


@pytest.mark.parametrize("change", [("heads", "tails"), ('"sha256"', '"sha512"'), ("0.", ""), ("{", "[")])
def test_a_piece_that_was_changed_is_not_believed(copied, change):
    file = copied / "progress" / "coin" / "repetition-00001.json"
    file.write_text(file.read_text().replace(*change, 1))
    with pytest.raises(ArgumentError, match=r"00001.json cannot be read .*; remove it and run again with --resume"):
        run(copied, is_resumed=True)


def test_what_no_study_wrote_is_not_removed_and_nan_is_never_kept(tmp_path):
    notes = tmp_path / "progress" / "coin" / "notes.txt"
    notes.parent.mkdir(parents=True)
    notes.write_text("mine")
    with pytest.raises(ArgumentError, match=r"holds no study .design.json is missing., so it is not removed"):
        run(tmp_path)
    assert notes.read_text() == "mine"
    with pytest.raises(ValueError, match="not JSON compliant"):
        run(tmp_path / "nan", type("Nothing", (Coin,), {"repeat": lambda *_: {"rows": [{"heads": float("nan")}]}})())
