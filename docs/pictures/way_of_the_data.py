"""The folders in the order of the data, as boxes; that they are the package's folders is read from where it says so."""

import tomllib
from textwrap import wrap
from typing import NamedTuple

from pictures.picture import ROOT, Picture

INK, SOFT, NEW, EDGE = "#1d2733", "#5b6875", "#8a4b08", "#b9c3cc"
KINDS = {
    "#e8f1f8": "what is there and what happens",
    "#fdf3e1": "what was recorded, and what was cut",
    "#e9f5ec": "what is learned or planned",
    "#f3edf8": "what decides, what it is worth, what people read",
}
WIDTH_PX, BOX_PX, STEP_PX, LETTERS = 572, (258, 106), (286, 138), 34
HEAD_LETTERS, MAKES_LOWER_PX = 30, 39
MARGIN_PX, TOP_PX, COLUMNS, LEGEND_PX = 14, 66, 2, 24
PASSED_OVER = {
    "workers",
    "estimator",
    "figures",
    "wording",
    "writing",
    "reading",
    "installation",
    "arrays",
    "shapes",
    "errors",
    "progress",
    "suggestions",
    "text_table",
}
"""Layers of the package that data does not pass: what all of it stands on."""
HEADING = "The folders are the way that data takes;", "imports point back along it"


class Box(NamedTuple):
    """A folder, or some."""

    folders: str
    makes: str
    holds: str
    new: str
    colour: int


BOXES = (
    Box(
        "scene, cell",
        "point clouds",
        "the physical table: cups, sensor, and an arm that works at it",
        "a camera, a cup, an arm",
        0,
    ),
    Box("perception", "a Scene", "cloud → plane → objects → who hides whom", "a way to find objects", 0),
    Box("world", "episodes", "actions, laws, state, transition; one robot or several", "a verb, a law, a reward", 0),
    Box("logs", "Logs", "stages, endings and their causes; on disk", "a log format", 1),
    Box("censoring", "weights", "Ĝ by trajectory or by stage; positivity", "a censoring model", 1),
    Box("learning", "Q-functions", "censored SVM and Q-learning on arrays", "a function class, targets", 2),
    Box("tables", "a Task", "the task of tables: features, grasp models, reasons", "a feature, a grasp model", 2),
    Box("planners", "policies", "heuristics, rollouts, exact optimum", "a planner, a baseline", 2),
    Box("policies", "decisions", "the port: decide(observation) → Decision; folders", "a kind of policy", 3),
    Box(
        "evaluation, monitoring",
        "a verdict",
        "what a policy is worth, from logs of another; in service",
        "an estimator of value",
        3,
    ),
    Box("study, view", "figures", "experiments; report of a log; runs in 3-D", "a figure, an experiment", 3),
    Box("serving, cli", "what you read", "decisions over HTTP; one file a verb: parses, prints", "a command", 3),
)


def folders() -> set[str]:
    """All folders of the boxes."""
    return {name for box in BOXES for name in box.folders.split(", ")}


def layers() -> set[str]:
    """Folders of the package, as the contract of its imports lists them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (whole,) = (contract for contract in contracts if contract["containers"] == ["halfseen"])
    return {name.strip() for layer in whole["layers"] for name in layer.split("|")} - PASSED_OVER


def _text(x: float, y: float, size: float, words: str, colour: str = INK, **more: str) -> str:
    others = "".join(f' {name.replace("_", "-")}="{value}"' for name, value in more.items())
    return f'<text x="{x:g}" y="{y:g}" font-size="{size:g}" fill="{colour}"{others}>{words}</text>'


def _drawn_box(box: Box, x: int, y: int) -> list[str]:
    width, height = BOX_PX
    fill, makes = list(KINDS)[box.colour], f"→ {box.makes}"
    is_long = len(box.folders) + len(makes) > HEAD_LETTERS
    return [
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="8" fill="{fill}" stroke="{EDGE}"/>',
        _text(x + 10, y + 24, 16, box.folders, font_weight="700"),
        _text(x + width - 10, y + 24 + MAKES_LOWER_PX * is_long, 13.5, makes, SOFT, text_anchor="end"),
        *(_text(x + 10, y + 46 + 17 * row, 14, line) for row, line in enumerate(wrap(box.holds, LETTERS))),
        _text(x + 10, y + 95, 13.5, f"new here: {box.new}", NEW, font_style="italic"),
    ]


def _arrow(path: str) -> str:
    return f'<path d="{path}" fill="none" stroke="{SOFT}" stroke-width="1.6" marker-end="url(#tip)"/>'


def draw() -> bytes:
    """Draw it as SVG."""
    if folders() != layers():
        raise AssertionError(f"way_of_the_data.BOXES and the layers of pyproject.toml differ by {folders() ^ layers()}")
    width, height = BOX_PX
    num_rows = len(BOXES) // COLUMNS
    whole_px = TOP_PX + STEP_PX[1] * num_rows + LEGEND_PX * len(KINDS)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX} {whole_px}" width="{WIDTH_PX}" '
        f'height="{whole_px}" font-family="Helvetica, Arial, sans-serif" role="img" aria-labelledby="title">',
        '<title id="title">The way of the data through the folders of halfseen, and where something new goes</title>',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        f'<path d="M0 0 L8 4 L0 8 z" fill="{SOFT}"/></marker></defs>',
        f'<rect width="{WIDTH_PX}" height="{whole_px}" fill="#ffffff"/>',
        *(_text(MARGIN_PX, 26 + 24 * row, 18, line, font_weight="700") for row, line in enumerate(HEADING)),
    ]
    for place, box in enumerate(BOXES):
        row, column = divmod(place, COLUMNS)
        x, y = MARGIN_PX + STEP_PX[0] * column, TOP_PX + STEP_PX[1] * row
        lines += _drawn_box(box, x, y)
        if column + 1 < COLUMNS:
            lines.append(_arrow(f"M{x + width + 2} {y + height / 2:g} h24"))
        elif place + 1 < len(BOXES):
            middle, below = x + width / 2, y + height
            lines.append(_arrow(f"M{middle:g} {below + 2} V{below + 14} H{MARGIN_PX + width / 2:g} V{below + 30}"))
    for row, (colour, words) in enumerate(KINDS.items()):
        y = TOP_PX + STEP_PX[1] * num_rows + LEGEND_PX * row
        lines.append(
            f'<rect x="{MARGIN_PX}" y="{y - 12}" width="14" height="14" rx="3" fill="{colour}" stroke="{EDGE}"/>'
        )
        lines.append(_text(MARGIN_PX + 22, y, 14, words, SOFT))
    return ("\n".join([*lines, "</svg>"]) + "\n").encode()


WAY_OF_THE_DATA = Picture("way-of-the-data", "docs/way-of-the-data.svg", draw)
