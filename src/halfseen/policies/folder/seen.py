"""What the states of a log looked like: beyond these ranges a policy was taught nothing."""

from itertools import zip_longest
from operator import index
from typing import Any

from halfseen.errors import PolicyError
from halfseen.lazy import Frame


def joined_seen(one: list[dict[str, Any]], other: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Join what two parts of a log have seen, stage by stage or of all stages."""
    pairs = zip_longest(one, other)
    return [first or second if not (first and second) else _joined(first, second) for first, second in pairs]


def check_seen(seen: Any, names: tuple[str, ...]) -> None:
    """Refuse what does not give a range of each of these names.

    Raises
    ------
    PolicyError
        It does not.
    """
    try:
        for entry in seen:
            first, last = (index(stage) for stage in entry["stages"])
            ranges = entry["ranges"]
            is_right = first <= last and set(ranges) == set(names)
            if not (is_right and all(map(_is_range, ranges.values()))):
                raise ValueError("a range is missing, of something else, or ends before it begins")
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
        raise PolicyError(
            f"seen does not give the range of {', '.join(names) or 'nothing'} in the log ({error}); learn anew"
        ) from error


def _joined(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    ranges = {name: _wider(seen, other["ranges"][name]) for name, seen in one["ranges"].items()}
    last = max(one["stages"][1], other["stages"][1])
    return entry(one["stages"][0], last, one["num_states"] + other["num_states"], ranges)


def _wider(one: Any, other: Any) -> Any:
    if isinstance(one, dict):
        # In the order of the categories, as one log alone would have them.
        return {name: one.get(name, 0) + other.get(name, 0) for name in sorted({*one, *other})}
    return [min(one[0], other[0]), max(one[1], other[1])]


def _is_range(seen: Any) -> bool:
    if isinstance(seen, dict):
        return bool(seen) and all(index(count) > 0 for count in seen.values())
    low, high = seen
    return float(low) <= float(high)


def entry(first: int, last: int, num_states: int, ranges: dict[str, Any]) -> dict[str, Any]:
    """What so many states of some stages looked like."""
    return {"stages": [first, last], "num_states": num_states, "ranges": ranges}


def ranges(frame: Frame, names: tuple[str, ...]) -> dict[str, list[float]]:
    """Give the least and the largest value of some columns."""
    return {name: [float(frame[name].min()), float(frame[name].max())] for name in names}
