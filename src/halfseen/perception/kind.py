"""Are these cups? What perception and every law know are tables of them: tumblers and mugs that stand or lie.

What counts as another thing: a height that no cup has; and, where more than a third of the objects show it, a shape
that no vessel fits, or a width that no cup has. One such shape among cups is most likely two cups that were taken for
one.

*What this cannot tell.* A can is a cup to it, and so is a bowl, a jar, a box that is partly hidden, or a thing of a
cup's size that is round: it tells what is surely something else, and passes what may be a cup.
"""

from halfseen.perception.solids import Hull
from halfseen.perception.view import SeenObject, View

LOWEST_M, HIGHEST_M = 0.045, 0.17
"""Heights that a cup has, standing or lying [m]: on the ten tables that come with halfseen, 0.062 to 0.149."""

WIDEST_M = 0.19
"""Longest that a cup is, across, handle included [m]: on these tables, 0.154."""

LARGEST_SHARE = 1.0 / 3.0
"""Share of objects without a cup's shape up to which they may be cups that were badly seen."""


def other_things(view: View) -> tuple[int, ...]:
    """Find the objects of a view that are surely no cups.

    Parameters
    ----------
    view
        What a camera sees, by `halfseen.perception.perceive`.

    Returns
    -------
    tuple
        Their numbers, rising; empty where all may be cups.
    """
    is_odd = {seen.id: _has_other_height(seen) or _has_other_shape(seen) for seen in view.objects}
    if sum(is_odd.values()) > LARGEST_SHARE * len(view.objects):
        return tuple(index for index, is_it in is_odd.items() if is_it)
    return tuple(seen.id for seen in view.objects if _has_other_height(seen))


def other_things_in_words(view: View) -> str:
    """Say which objects are no cups, and by what; nothing where all may be.

    Parameters
    ----------
    view
        What a camera sees.
    """
    odd = [view.objects[index] for index in other_things(view)]
    if not odd:
        return ""
    each = "; ".join(f"{seen.id} {_by(seen)}" for seen in odd)
    them = "this is no table of cups" if len(odd) == len(view.objects) else "not all on this table are cups"
    return f"{them}, and of other things nothing was learned: {each}"


def _has_other_height(seen: SeenObject) -> bool:
    return not LOWEST_M <= seen.height_m <= HIGHEST_M


def _has_other_shape(seen: SeenObject) -> bool:
    return isinstance(seen.solid, Hull) or _width_m(seen) > WIDEST_M


def _width_m(seen: SeenObject) -> float:
    return float(seen.size_m[:2].max())


def _by(seen: SeenObject) -> str:
    if _has_other_height(seen):
        return f"is {seen.height_m:.3f} m high (a cup {LOWEST_M} to {HIGHEST_M})"
    if isinstance(seen.solid, Hull):
        return "is no vessel by its shape"
    return f"is {_width_m(seen):.3f} m wide (a cup at most {WIDEST_M})"
