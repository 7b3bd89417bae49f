"""A picture of a view: the depth image, the objects in colour, and arrows from occluders to hidden objects."""

import io
import os
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from halfseen.perception.view import View, hidden_by_others, most_hidden
from halfseen.shapes import Float
from halfseen.writing import write_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colour-blind-safe palette (Okabe and Ito 2008), without black and grey, as the depth image is grey.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#8C6BB1", "#66A61E", "#A6761D")
MASK_OPACITY = 0.75
# Smaller shares get no arrow, to avoid clutter.
SMALLEST_ARROW_SHARE = 0.02
DOTS_PER_INCH = 150
MOST_LETTERS = 84  # a line of the sentence above the picture
WIDTH_INCHES = 9.0
THUMBNAIL_INCHES = (5.2, 3.9)
THUMBNAIL_NUMBERS = 21.0
"""Font size of the objects' numbers [pt], legible at the width of a thumb."""
THUMBNAIL_MARGIN = 0.07


def sentence(view: View) -> str:
    """Describe in a sentence what is on the table and which object is hidden most.

    Parameters
    ----------
    view
        The view to describe.
    """
    if not view.objects:
        return "No objects on the table."
    num = len(view.objects)
    start = f"{num} object{'s' if num > 1 else ''} on the table"
    worst = most_hidden(view.objects)
    if worst.occlusion < SMALLEST_ARROW_SHARE:
        return f"{start}; nothing hides {'another' if num > 1 else 'it'}."
    hider = int(np.argmax(view.hides[worst.id]))
    is_other = hidden_by_others(view, worst) > view.hides[worst.id, hider]
    by = "something cut by the image border or beside the table" if is_other else f"object {hider}"
    own = hidden_by_others(view, worst) if is_other else float(view.hides[worst.id, hider])
    whole, most = f"{worst.occlusion:.2f}", f"{own:.2f}"
    if whole == most:
        return f"{start}; object {worst.id} is hidden most, by {by} ({whole})."
    return f"{start}; object {worst.id} is hidden most ({whole}), above all by {by} ({most})."


def draw(view: View, path: str | os.PathLike[str]) -> None:
    """Draw a view as a PNG file.

    Parameters
    ----------
    view
        The view to draw.
    path
        Output file, written atomically; missing parents are created.

    Raises
    ------
    ArgumentError
        The file cannot be written there.
    """
    from matplotlib.figure import Figure

    num_rows, num_columns = view.labels.shape
    figure = Figure(figsize=(WIDTH_INCHES, WIDTH_INCHES * num_rows / num_columns + 1.1), dpi=DOTS_PER_INCH)
    draw_view(figure.add_axes((0.0, 0.06, 1.0, 0.86)), view)
    lines = "\n".join(wrap(sentence(view), MOST_LETTERS))
    figure.text(0.5, 0.985, lines, ha="center", va="top", fontsize=13)
    figure.text(0.5, 0.02, _legend(view), ha="center", va="bottom", fontsize=8.5)
    write_file(Path(path), _png(figure))


def thumbnail(view: View) -> bytes:
    """Draw a close-up PNG of a view's objects, with numbers legible in a small picture.

    Parameters
    ----------
    view
        The view to draw.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=THUMBNAIL_INCHES, dpi=DOTS_PER_INCH)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    draw_view(axes, view, THUMBNAIL_NUMBERS, has_shares=False)
    left, right, top, bottom = _frame_px(view)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    return _png(figure)


def _png(figure: "Figure") -> bytes:
    image = io.BytesIO()
    figure.savefig(image, format="png")
    return image.getvalue()


def _frame_px(view: View) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of the smallest frame with a thumbnail's aspect that holds all objects [px]."""
    rows, columns = np.nonzero(view.labels >= 0 if view.objects else view.image.is_return)
    size_px = np.array([np.ptp(columns), np.ptp(rows)]) * (1.0 + 2.0 * THUMBNAIL_MARGIN)
    half_px = 0.5 * max(size_px / np.array(THUMBNAIL_INCHES)) * np.array(THUMBNAIL_INCHES)
    middle_px = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2.0
    (left, top), (right, bottom) = middle_px - half_px, middle_px + half_px
    return float(left), float(right), float(top), float(bottom)


def draw_view(axes: "Axes", view: View, number_size: float = 8.0, *, has_shares: bool = True) -> None:
    """Draw a view into axes: depth, objects with their numbers and outlines, and who hides whom.

    Parameters
    ----------
    axes
        Matplotlib axes; their units become image pixels.
    view
        The view to draw.
    number_size
        Font size of the objects' numbers [pt].
    has_shares
        Whether to write the hidden share next to each number.
    """
    axes.imshow(_coloured(view), interpolation="nearest")
    axes.set_axis_off()
    for seen in view.objects:
        colour = COLOURS[seen.id % len(COLOURS)]
        axes.contour(view.silhouettes[seen.id].astype(float), levels=[0.5], colors=[colour], linewidths=1.2)
    _add_arrows(axes, view)
    _add_numbers(axes, view, number_size, has_shares)


def _coloured(view: View) -> Float[np.ndarray, "H W 3"]:
    """RGB image: depth in grey, bright if near; no return in white; objects in their colours."""
    from matplotlib.colors import to_rgb

    depth = view.image.depth_m
    near, far = np.nanpercentile(depth, [1, 90])
    grey = np.clip((far - depth) / max(float(far - near), 1e-6), 0.0, 1.0) * 0.5 + 0.25
    picture = np.repeat(np.where(view.image.is_return, grey, 1.0)[..., None], 3, axis=2)
    for seen in view.objects:
        mask = view.labels == seen.id
        colour = np.array(to_rgb(COLOURS[seen.id % len(COLOURS)]))
        picture[mask] = (1 - MASK_OPACITY) * picture[mask] + MASK_OPACITY * colour
    return picture


def _middle_px(view: View, index: int) -> tuple[float, float]:
    """Pixel (column, row) in the middle of an object's visible part."""
    rows, columns = np.nonzero(view.labels == index)
    nearest = np.argmin((rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2)
    return float(columns[nearest]), float(rows[nearest])


def _add_arrows(axes: "Axes", view: View) -> None:
    for hidden, hider in np.argwhere(view.hides >= SMALLEST_ARROW_SHARE):
        axes.annotate(
            "",
            xy=_middle_px(view, int(hidden)),
            xytext=_middle_px(view, int(hider)),
            arrowprops={
                "arrowstyle": "-|>",
                "color": "black",
                "linewidth": 0.8 + 3.0 * float(view.hides[hidden, hider]),
                "mutation_scale": 14,
                "shrinkA": 9,
                "shrinkB": 9,
            },
        )


def _add_numbers(axes: "Axes", view: View, size: float, has_shares: bool) -> None:
    for seen in view.objects:
        box = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
        axes.text(
            *_middle_px(view, seen.id),
            f"{seen.id}: {seen.occlusion:.2f}" if has_shares else str(seen.id),
            ha="center",
            va="center",
            fontsize=size,
            bbox=box,
        )


def _legend(view: View) -> str:
    parts = ["number: hidden share of the silhouette", "line: completed silhouette"]
    if np.any(view.hides >= SMALLEST_ARROW_SHARE):
        parts.append("arrow: from the hiding object to the hidden one")
    parts.append("white: no return")
    return "  |  ".join(parts)
