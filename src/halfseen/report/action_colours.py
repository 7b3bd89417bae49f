"""One colour for each action, the same in all figures of the page."""

from collections.abc import Iterable, Sequence

from halfseen.pages.palette import LINES, SOFT

OTHERS, OTHERS_COLOUR = "other actions", SOFT
UNKNOWN_COLOUR = "#b9b9b9"


def action_colours(actions: Sequence[str]) -> dict[str, str]:
    """Colours of actions in the order of their importance; those that are too many for the palette are `OTHERS`.

    Examples
    --------
    >>> list(action_colours(["A", "B"]))
    ['A', 'B']
    >>> list(action_colours("ABCDEFGHI"))
    ['A', 'B', 'C', 'D', 'E', 'F', 'other actions']
    """
    if len(actions) <= len(LINES):
        return dict(zip(actions, LINES, strict=False))
    return {**dict(zip(actions, LINES[:-1], strict=False)), OTHERS: OTHERS_COLOUR}


def colour_of(action: str, colours: dict[str, str]) -> str:
    """Its own colour, or that of all others."""
    return colours.get(action, OTHERS_COLOUR)


def names_shown(actions: Iterable[str], colours: dict[str, str]) -> list[str]:
    """What a legend of these actions names, in the order of the colours."""
    shown = {action if action in colours else OTHERS for action in actions}
    return [name for name in colours if name in shown]
