"""What cameras see: pictures of views, drawn by the library's own drawing, beside the colours of the cloud."""

import io

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from halfseen.figures import drawn
from pictures.guide_pages import names_after
from pictures.picture import Picture
from pictures.style import WIDTH_INCHES

NUM_COLOURS = 256


def _small(figure_of) -> bytes:
    """Draw as PNG, in few colours, so that the file is small."""
    with Image.open(io.BytesIO(drawn(figure_of, "png"))) as image:
        reduced = image.convert("RGB").quantize(
            NUM_COLOURS, Image.Quantize.MEDIANCUT, kmeans=4, dither=Image.Dither.NONE
        )
    content = io.BytesIO()
    reduced.save(content, "PNG", optimize=True)
    return content.getvalue()


def _window(views) -> tuple[float, float, float, float]:
    """The part of the image in which objects are, with some room: left, right, bottom, top."""
    rows, columns = np.nonzero(np.any([view.labels >= 0 for view in views], axis=0))
    room = 25
    return columns.min() - room, columns.max() + room, rows.max() + room, rows.min() - room


def _panels(num: int, window: tuple[float, float, float, float]):
    left, right, bottom, top = window
    height = WIDTH_INCHES * (bottom - top) / (right - left)
    made = Figure(figsize=(WIDTH_INCHES, num * (height + 0.3)), layout="constrained")
    panels = np.atleast_1d(made.subplots(num, 1))
    for axes in panels:
        axes.set(xlim=(left, right), ylim=(bottom, top), xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    return made, panels


def _with_labels() -> bytes:
    from halfseen.perception import StainCounter, perceive
    from halfseen.perception.picture import draw_view

    cloud = names_after("what-looks-dirty", 0)["cloud"]
    view = perceive(cloud)
    words = [label.word for label in StainCounter()(view, cloud)]

    def figure_of() -> Figure:
        window = _window([view])
        made, (coloured, seen) = _panels(2, window)
        coloured.imshow(cloud.colours.reshape(*view.labels.shape, 3))
        draw_view(seen, view, 9.0, has_shares=False)
        text = ", ".join(f"{k} {word}" for k, word in enumerate(words))
        for axes, heading in (
            (coloured, "the colours of the cloud"),
            (seen, f"what halfseen look makes of it:\n{text}"),
        ):
            axes.set(xlim=window[:2], ylim=window[2:])
            axes.set_title(heading, loc="left", fontsize=9.5)
        return made

    return _small(figure_of)


def _table() -> bytes:
    """A table that comes with halfseen, as `halfseen look` draws it."""
    from halfseen.perception import perceive, read_cloud
    from halfseen.perception.picture import draw_view
    from halfseen.scene import table_paths

    view = perceive(read_cloud(table_paths()[0]))

    def figure_of() -> Figure:
        window = _window([view])
        made, (axes,) = _panels(1, window)
        draw_view(axes, view, 9.0, has_shares=False)
        axes.set(xlim=window[:2], ylim=window[2:])
        return made

    return _small(figure_of)


def _two_cameras() -> bytes:
    from halfseen.perception.picture import draw_view
    from halfseen.scene import capture

    names = names_after("another-camera", 0)
    perceive = names["perceive"]
    right = perceive(capture(names["table"], seed=1).cloud)
    short = perceive(names["cloud"], sensor=names["short"])

    def figure_of() -> Figure:
        window = _window([right, short])
        made, panels = _panels(2, window)
        words = f"an Xtion: {len(right.objects)} objects", f"a third of its baseline: {len(short.objects)} objects"
        for axes, view, text in zip(panels, (right, short), words, strict=True):
            draw_view(axes, view, 8.0, has_shares=False)
            axes.set(xlim=window[:2], ylim=window[2:])
            axes.set_title(text, loc="left", fontsize=9.5)
        return made

    return _small(figure_of)


PICTURES = (
    Picture("table", "docs/static/guide/table.png", _table, seconds=4.0),
    Picture("stained", "docs/static/guide/stained.png", _with_labels, seconds=6.0),
    Picture("two-cameras", "docs/static/guide/two-cameras.png", _two_cameras, seconds=8.0),
)
