"""Figures of the study, drawn by the study itself from the tables that `halfseen study --only reward` writes."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import pandas as pd

from halfseen.figures import drawn
from halfseen.writing import write_file
from pictures.picture import NUMBERS, ROOT, Numbers, Picture, Row, Table

TABLES = ("figure1", "table1", "peer", "weights")
"""What the study's section needs to draw its figure."""
PIECES = Path("progress") / "reward"
CHECKED_SIZE = 25
STUDY = ROOT / "runs" / "pictures" / "study"
_RULES = ("greedy", "history", "greedy-penalty", "history-penalty")


@cache
def _setting():
    """The study's tables, under its law, as `halfseen study` sets them up."""
    from halfseen.cell.calibration.law import shipped_law
    from halfseen.perception import perceive, read_cloud
    from halfseen.scene import table_paths
    from halfseen.study.setting import Setting, under

    setting, law = under(Setting(()), shipped_law())
    scenes = tuple(replace(law.scene(perceive(read_cloud(path))), name=path.stem) for path in table_paths())
    return replace(setting, scenes=scenes)


def draw_figure(name: str, prefix: str = "study", kind: str = "png") -> bytes:
    """Draw a figure as the study does, from the tables that are kept under a prefix."""
    from halfseen.study.experiments.reward import Reward

    tables = {name: pd.read_csv(NUMBERS / f"{prefix}-{name}.csv", float_precision="round_trip") for name in TABLES}
    section = Reward().section(_setting(), tables)
    (drawing,) = (each for each in (section.opening, *section.drawings) if each is not None and each.name == name)
    return drawn(partial(drawing.draw, drawing.title), kind)


def repetitions_in(folder: Path) -> Table:
    """What was earned in each repetition, from the pieces that a study keeps."""
    import json

    rows: Table = []
    for file in sorted((folder / PIECES).glob("repetition-*.json")):
        piece, at = json.loads(file.read_text(encoding="utf-8"))["piece"], {"repetition": int(file.stem.split("-")[1])}
        rows += [
            {name: row[name] for name in ("policy", "num_trajectories", "cut_share")} | at | {"reward": row["reward"]}
            for row in piece["rows"]
            if row["policy"] == "censored_q"
        ]
        rows += [
            {"policy": row["policy"], "num_trajectories": 0, "cut_share": 0.0} | at | {"reward": row["reward"]}
            for row in piece["baselines"]
            if row["policy"] in _RULES
        ]
    return rows


def take_in(folder: Path) -> Table:
    """Keep the tables that a study wrote into a folder, and what was earned in each of its repetitions."""
    keep_tables(folder, "study")
    return repetitions_in(folder)


def keep_tables(folder: Path, prefix: str) -> None:
    """Keep the tables that a study wrote into a folder, under names that begin alike."""
    for name in TABLES:
        write_file(NUMBERS / f"{prefix}-{name}.csv", (folder / f"{name}.csv").read_text(encoding="utf-8"))


def run_study(folder: Path, repetitions: int) -> Path:
    """Repeat the study of rewards so often."""
    from click.testing import CliRunner

    from halfseen.cli import halfseen

    words = ["study", "--only", "reward", "--repetitions", str(repetitions), "--out", str(folder)]
    done = CliRunner().invoke(halfseen, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return folder


def _first_repetition() -> Mapping[int, Row]:
    """What the heuristics, and policies learned from the smallest logs, earn in the first repetition."""
    from halfseen.study.experiments.reward import Reward
    from halfseen.study.pipeline import CUT_KIND, Source
    from halfseen.study.policies import HEURISTICS

    design, setting = Reward(), _setting()
    source, num_all = Source.of(setting, 0), design.episodes_per_scene * len(setting.scenes)
    episodes = source.play(max(design.num_trajectories))
    rates = [source.cut_rate(share, CUT_KIND) for share in design.cut_shares]
    logs = [(source.cut(episodes, rate, CUT_KIND), "weighted") for rate in rates]
    learned = source.logged(episodes, laws=design.laws).learn(logs, [CHECKED_SIZE])
    policies = {(each.name, 0, 0.0): each.policy(source.world) for each in HEURISTICS}
    places = [("censored_q", CHECKED_SIZE, share) for share in design.cut_shares]
    policies |= {place: one.policy for place, one in zip(places, learned, strict=True)}
    each = source.control_each(list(policies.values()), range(num_all), source.start_value(design.num_starts))
    found = {place: played.means()["reward"] for place, played in zip(policies, each, strict=True)}
    return {
        index: row | {"reward": found[row["policy"], row["num_trajectories"], row["cut_share"]]}
        for index, row in enumerate(FIGURE1_NUMBERS.read())
        if row["repetition"] == 0 and (row["policy"], row["num_trajectories"], row["cut_share"]) in found
    }


FIGURE1_NUMBERS = Numbers("figure1.csv", lambda: take_in(run_study(STUDY, 40)), _first_repetition)
OPENING, FIGURE1 = (
    Picture(name, f"docs/{name}.png", partial(draw_figure, name), FIGURE1_NUMBERS, seconds=15.0)
    for name in ("opening", "figure1")
)
