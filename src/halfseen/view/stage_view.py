"""The data of one stage for display, independent of its source and of the renderer; and the stage as HTML.

Two back ends draw it: `recording` as pictures, `viewer` in 3-D. Positions are in one frame for all stages of a run,
whose third axis points up [m].
"""

from dataclasses import dataclass, field
from html import escape
from typing import NamedTuple

import numpy as np

from halfseen.arrays import Hides, Points
from halfseen.perception.clouds import Colours, Vector
from halfseen.shapes import Float
from halfseen.view.shapes import Mesh

Colour = tuple[int, int, int]
Poses = Float[np.ndarray, "moments parts 7"]
"""Position [m] and quaternion (w, x, y, z) of each part at each moment."""

_CLEAN, _UNSURE, _DIRTY = (86, 180, 233), (225, 225, 225), (213, 94, 0)
SHADOW, ARROW, GHOST, HAND = (40, 40, 60), (20, 20, 20), (0, 158, 115), (204, 121, 167)
"""Colours that colour-blind readers can distinguish (Okabe and Ito 2008)."""
_FINGER_M, _RAISED_M = 0.06, 0.08
"""Length of drawn fingers, and height of arrows above the centres of objects [m]."""
_SMALLEST_SHARE = 0.02  # smaller occlusions have no arrow
_TURN = np.deg2rad(40.0)
_STYLE = "border-collapse:collapse;width:100%;font-size:0.85em;margin:0.4em 0 0.8em"
_CELL = "padding:0.15em 0.4em;text-align:{align};border-bottom:1px solid rgba(128,128,128,0.25)"


@dataclass(frozen=True, eq=False)
class Shown:
    """An object of a stage.

    Parameters
    ----------
    number
        Its number in decisions.
    is_dirty
        P(DIRTY) given all observations.
    occlusion
        Hidden share of its silhouette.
    middle_m
        Its centre [m].
    solid
        Its completed shape; None if the last look does not show it.
    shadow
        The solid and its shadow as seen from the camera; None without a solid.
    revealed_m
        Points of other objects that a LIFT of it would reveal [m].
    """

    number: int
    is_dirty: float
    occlusion: float
    middle_m: Vector
    solid: Mesh | None
    shadow: Mesh | None = None
    revealed_m: Points = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True)
class Option:
    """A possible action.

    Parameters
    ----------
    name
        Name, such as ``"LIFT 2"``.
    value
        Its Q [reward].
    low, high
        95 % confidence interval of Q, if known.
    chance_best
        Probability that it is the best, if known.
    """

    name: str
    value: float
    low: float | None = None
    high: float | None = None
    chance_best: float | None = None


@dataclass(frozen=True, eq=False)
class Hand:
    """A planned grasp.

    Parameters
    ----------
    way_m
        Path of the point between the pads, until the object is lifted [m].
    at_m
        Position at which the hand is to close [m].
    axes
        The hand's axes as columns: across the fingers, the closing direction, and out of the palm.
    opening_m
        Distance between the pads on approach [m].
    """

    way_m: Points
    at_m: Vector
    axes: Float[np.ndarray, "3 3"]
    opening_m: float

    @property
    def lines_m(self) -> Float[np.ndarray, "lines 2 3"]:
        """The hand at its closing position, as lines: two fingers, and the palm between them."""
        aside, back = 0.5 * self.opening_m * self.axes[:, 1], -_FINGER_M * self.axes[:, 2]
        tips = [self.at_m - aside, self.at_m + aside]
        roots, palm = [tip + back for tip in tips], self.at_m + back
        lines = [(tips[0], roots[0]), (tips[1], roots[1]), (roots[0], roots[1]), (palm, palm + back)]
        return np.array(lines, dtype=np.float64)


class Arrow(NamedTuple):
    """Marks that one object hides a share of another; from above the one to above the other [m]."""

    hider: Shown
    hidden: Shown
    share: float
    ends_m: Points


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid body of the cell, such as a link of the arm or the table.

    Parameters
    ----------
    solid
        Its shape, in its own frame.
    colour
        Red, green and blue, in [0, 255].
    is_robot
        Whether it belongs to a robot; the cloud shows the other parts, too.
    """

    solid: Mesh
    colour: Colour
    is_robot: bool = True


@dataclass(frozen=True, eq=False)
class StageView:
    """The observations, decision and events of one stage.

    Parameters
    ----------
    title
        Title of the stage.
    points_m, colours
        The cloud, and red, green and blue of each point.
    eye_m
        Position of the camera [m].
    objects
        The objects known to be on the table.
    hides
        ``hides[i, j]`` is the share of ``objects[i]`` that ``objects[j]`` alone hides.
    options
        Actions, best first; none if the policy has no values.
    action
        The action; empty if there was no decision.
    reason
        Reason for the action, in one sentence.
    notes
        Doubts about the decision.
    events
        Observations, attempts and cuts so far, one sentence each.
    poses
        Poses of the parts of the cell, by moment; no moments without a cell.
    hand
        The planned grasp.
    """

    title: str
    points_m: Points
    colours: Colours
    eye_m: Vector
    objects: tuple[Shown, ...]
    hides: Hides
    options: tuple[Option, ...] = ()
    action: str = ""
    reason: str = ""
    notes: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    poses: Poses = field(default_factory=lambda: np.zeros((0, 0, 7)))
    hand: Hand | None = None

    @property
    def target(self) -> int | None:
        """Number of the object of the action; None if it has none."""
        *_, last = self.action.split() or [""]
        return int(last) if last.isdigit() else None

    @property
    def arrows(self) -> list[Arrow]:
        """Occlusions between objects."""
        objects, raised_m = self.objects, np.array([0.0, 0.0, _RAISED_M])
        return [
            Arrow(
                objects[hider],
                objects[hidden],
                float(self.hides[hidden, hider]),
                np.stack([objects[hider].middle_m, objects[hidden].middle_m]) + raised_m,
            )
            for hidden, hider in np.argwhere(self.hides >= _SMALLEST_SHARE).tolist()
        ]

    @property
    def revealed_m(self) -> Points:
        """What a LIFT of the target would reveal; without a target, of every object that hides another [m]."""
        lifted = [each for each in self.objects if each.number == self.target] or list(self.objects)
        return np.concatenate([np.zeros((0, 3)), *(each.revealed_m for each in lifted)])

    @property
    def viewpoint(self) -> tuple[Vector, Vector]:
        """A viewpoint to the side, which shows shadows, and the point to look at [m]."""
        middles_m = np.array([shown.middle_m for shown in self.objects] or [self.points_m.mean(axis=0)])
        middle_m = middles_m.mean(axis=0)
        x_m, y_m, z_m = self.eye_m - middle_m
        sine, cosine = np.sin(_TURN), np.cos(_TURN)
        turned_m = np.array([cosine * x_m - sine * y_m, sine * x_m + cosine * y_m, 0.9 * z_m])
        return middle_m + 0.75 * turned_m, middle_m


@dataclass(frozen=True, eq=False)
class Watched:
    """A run: its stages in order, and the cell that it ran in.

    Parameters
    ----------
    source
        Source of the run, in words.
    stages
        The stages, at least one.
    parts
        Bodies of the cell, in the order of `StageView.poses`; none without a cell.
    """

    source: str
    stages: tuple[StageView, ...]
    parts: tuple[Part, ...] = ()


def dirty_colour(is_dirty: float) -> Colour:
    """Colour of P(DIRTY): blue for clean, grey for unsure, orange for dirty.

    Examples
    --------
    >>> dirty_colour(1.0)
    (213, 94, 0)
    """
    end, share = (_DIRTY, 2 * is_dirty - 1) if is_dirty > 0.5 else (_CLEAN, 1 - 2 * is_dirty)
    red, green, blue = (round(begin + share * (to - begin)) for begin, to in zip(_UNSURE, end, strict=True))
    return red, green, blue


def stage_html(stage: StageView) -> str:
    """Write a stage as static HTML: reason, actions with their values, objects, events."""
    parts = [f"<p><strong>{escape(stage.title)}</strong></p>"]
    if stage.reason:
        parts.append(f"<p>{escape(stage.reason)}</p>")
    parts.extend(f"<p>warning: {escape(note)}</p>" for note in stage.notes)
    if stage.options:
        parts.append(_options(stage))
    parts.append(_objects(stage))
    if stage.events:
        parts.append("<p><strong>so far</strong></p>")
        listed = "".join(f"<li>{escape(event)}</li>" for event in reversed(stage.events))
        parts.append(f'<ul style="margin:0;padding-left:1.2em;font-size:0.85em">{listed}</ul>')
    return f'<div class="halfseen-stage" style="padding:0 0.75em;line-height:1.35">{"".join(parts)}</div>'


def _options(stage: StageView) -> str:
    """Actions by value, with intervals and chances if some are known."""
    columns = {
        "action": [escape(option.name) for option in stage.options],
        "value": [f"{option.value:+.2f}" for option in stage.options],
        "95 %": ["" if one.low is None else f"{one.low:+.2f} to {one.high:+.2f}" for one in stage.options],
        "best": ["" if one.chance_best is None else f"{one.chance_best:.0%}" for one in stage.options],
    }
    known = {head: cells for head, cells in columns.items() if any(cells)}
    is_done = [option.name == stage.action for option in stage.options]
    rows = [
        [f"<strong>{cell}</strong>" if done else cell for cell in row]
        for row, done in zip(zip(*known.values(), strict=True), is_done, strict=True)
    ]
    return _table(list(known), rows)


def _objects(stage: StageView) -> str:
    rows = []
    for shown, hidden_by in zip(stage.objects, stage.hides.tolist(), strict=True):
        hiders = [(share, other.number) for share, other in zip(hidden_by, stage.objects, strict=True)]
        by = ", ".join(str(number) for share, number in sorted(hiders, reverse=True) if share >= _SMALLEST_SHARE)
        colour = "rgb({}, {}, {})".format(*dirty_colour(shown.is_dirty))
        patch = f'<span style="display:inline-block;width:0.9em;height:0.9em;background:{colour}"></span>'
        seen = "" if shown.solid is not None else " (out of view)"
        rows.append([f"{patch} {shown.number}{seen}", f"{shown.is_dirty:.2f}", f"{shown.occlusion:.0%}", by or "–"])
    return _table(["object", "dirty", "hidden", "by"], rows)


def _table(head: list[str], rows: list[list[str]]) -> str:
    def line(cells: list[str], tag: str) -> str:
        written = [
            f'<{tag} style="{_CELL.format(align="left" if column == 0 else "right")}">{cell}</{tag}>'
            for column, cell in enumerate(cells)
        ]
        return f"<tr>{''.join(written)}</tr>"

    return f'<table style="{_STYLE}">{line(head, "th")}{"".join(line(row, "td") for row in rows)}</table>'
