"""A stage in words: its reason, its actions with their values, its objects, what happened; as HTML."""

from html import escape

from halfseen.watch.stage_view import Option, StageView

_CLEAN, _UNSURE, _DIRTY = (86, 180, 233), (225, 225, 225), (213, 94, 0)
"""Told apart by colour-blind eyes (Okabe and Ito 2008)."""
_HIDES = 0.02
_STYLE = "border-collapse:collapse;width:100%;font-size:0.85em;margin:0.4em 0 0.8em"
_CELL = "padding:0.15em 0.4em;text-align:{align};border-bottom:1px solid rgba(128,128,128,0.25)"


def dirty_colour(is_dirty: float) -> tuple[int, int, int]:
    """Colour of P(DIRTY): blue where clean, grey where unsure, orange where dirty.

    Examples
    --------
    >>> dirty_colour(1.0)
    (213, 94, 0)
    """
    end, share = (_DIRTY, 2 * is_dirty - 1) if is_dirty > 0.5 else (_CLEAN, 1 - 2 * is_dirty)
    red, green, blue = (round(begin + share * (to - begin)) for begin, to in zip(_UNSURE, end, strict=True))
    return red, green, blue


def stage_html(stage: StageView) -> str:
    """Write a stage for a page, in HTML that asks for nothing."""
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
    has_interval = any(option.low is not None for option in stage.options)
    has_chance = any(option.chance_best is not None for option in stage.options)
    head = ["action", "value", *(["95 %"] if has_interval else []), *(["best"] if has_chance else [])]
    rows = []
    for option in stage.options:
        row = [escape(option.name), f"{option.value:+.2f}"]
        row += [_interval(option)] if has_interval else []
        row += [_share(option.chance_best)] if has_chance else []
        is_done = option.name == stage.action
        rows.append([f"<strong>{cell}</strong>" if is_done else cell for cell in row])
    return _table(head, rows)


def _interval(option: Option) -> str:
    return "" if option.low is None or option.high is None else f"{option.low:+.2f} to {option.high:+.2f}"


def _share(share: float | None) -> str:
    return "" if share is None else f"{share:.0%}"


def _objects(stage: StageView) -> str:
    rows = []
    for shown, hidden_by in zip(stage.objects, stage.hides.tolist(), strict=True):
        hiders = sorted(
            ((share, other.number) for share, other in zip(hidden_by, stage.objects, strict=True) if share >= _HIDES),
            reverse=True,
        )
        by = ", ".join(str(number) for _, number in hiders)
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
