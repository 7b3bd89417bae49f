"""Which object of a history is which that the cloud shows now: by where they are, or else by their order."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from halfseen.arrays import Hides
from halfseen.errors import PolicyError
from halfseen.logs.columns import shown
from halfseen.perception.tracking import FARTHEST_M, NEARLY_AS_NEAR_M, matched
from halfseen.shapes import Float, Int

DIFFERS = 0.3
"""If who hides whom changes by this much, objects may stand in another order than before."""


class Identities(NamedTuple):
    """What each object that is on the table now was in the history.

    The objects of the cloud come first, in its order; after them those that it does not show.
    """

    was: Int[np.ndarray, " k"]
    """Rank of each in the history; −1 where it is new."""
    is_washed: bool
    """Whether the object of a last WASH is gone."""
    notes: tuple[str, ...]
    """What is doubtful."""


def by_place(
    kept: Int[np.ndarray, " k"],
    names: Sequence[object],
    was_m: Float[np.ndarray, "n 3"],
    now_m: Float[np.ndarray, "m 3"],
    washed: int | None,
    racked: int | None = None,
) -> Identities:
    """Find the objects of a history again where they were, or near.

    As a robot remembers them (`halfseen.cell.memory`): what is not seen any more stays on the table, hidden, unless it
    was washed; what is seen and was not there before is new.

    Parameters
    ----------
    kept
        Ranks of the objects of the history that are on the table.
    names, was_m
        Of all objects of the history: the names, and where they were [m].
    now_m
        Where the objects of the cloud are, in the same frame [m].
    washed
        Rank of the object of a WASH of which nobody wrote down whether it held; None if there was none.
    racked
        Rank of the object of a WASH that held just now, not among those kept; None if there was none.

    Raises
    ------
    PolicyError
        Nothing is where anything was.
    """
    found = matched(was_m[kept], now_m)
    number_of = dict(zip(kept.tolist(), found.now.tolist(), strict=True))
    is_washed = washed is not None and number_of[washed] < 0
    hidden = [rank for rank, now in number_of.items() if now < 0 and not (is_washed and rank == washed)]
    if len(hidden) == len(kept) > 0 and len(now_m):
        raise PolicyError(
            f"none of the {len(now_m)} objects that the cloud shows is within {FARTHEST_M:.2f} m of where one of the "
            f"{len(kept)} objects on the table was: the history is of another table, or its camera stood elsewhere; "
            "give the log of this table, or begin a new trajectory"
        )
    was = np.full(len(now_m), -1)
    for rank, now in number_of.items():
        if now >= 0:
            was[now] = rank
    notes = [
        f"object {now} may be another than {shown(names[rank])} of the history, which it is taken for: one more is "
        "nearly as near"
        for (rank, now), is_doubtful in zip(number_of.items(), found.is_doubtful.tolist(), strict=True)
        if is_doubtful and now >= 0
    ]
    if washed is not None and not is_washed:
        away_m = float(np.linalg.norm(now_m[number_of[washed]] - was_m[washed]))
        if away_m > NEARLY_AS_NEAR_M:
            notes.append(
                f"WASH of {shown(names[washed])} is taken to have failed: object {number_of[washed]}, {away_m:.2f} m "
                "from where it was, is taken for it"
            )
    if racked is not None:
        stands = (was < 0) & (np.linalg.norm(now_m - was_m[racked], axis=1) < NEARLY_AS_NEAR_M)
        notes += [
            f"WASH of {shown(names[racked])} held, but object {now} stands where it was: it is taken for another"
            for now in np.flatnonzero(stands).tolist()
        ]
    notes += [
        f"object {len(now_m) + k} is {shown(names[rank])} of the history, which the cloud does not show: it is taken "
        "to be hidden where it was"
        for k, rank in enumerate(hidden)
    ]
    return Identities(np.concatenate([was, np.array(hidden, dtype=was.dtype)]), is_washed, tuple(notes))


def by_order(
    kept: Int[np.ndarray, " k"], hides_before: Float[np.ndarray, "n n"], hides_now: Hides, washed: int | None
) -> Identities:
    """Take the objects of a history for those of the cloud one after the other: it does not tell where they were.

    Parameters
    ----------
    kept
        Ranks of the objects of the history that are on the table.
    hides_before, hides_now
        Who hides whom in the history, all of its objects, and in the cloud.
    washed
        Rank of the object of a WASH of which nobody wrote down whether it held: it did if the cloud shows one object
        less. None if there was none.

    Raises
    ------
    PolicyError
        The cloud shows another number of objects.
    """
    is_washed = washed is not None and len(kept) == len(hides_now) + 1
    was = kept[kept != washed] if is_washed else kept
    if len(was) != len(hides_now):
        raise PolicyError(
            f"{len(kept)} objects are on the table, and the cloud shows {len(hides_now)}: the history is of other "
            "objects than the cloud shows; give the log of this table, or one with the places of its objects"
        )
    note = "objects of the history have no places (x_m, y_m, z_m): they are taken in their order"
    return Identities(was, is_washed, (note, *_other_order(hides_before[np.ix_(was, was)], hides_now)))


def _other_order(before: Hides, now: Hides) -> list[str]:
    change = np.abs(before - now)
    if change.max(initial=0.0) < DIFFERS:
        return []
    i, j = np.unravel_index(int(change.argmax()), change.shape)
    return [f"object {i} was hidden by object {j} to {before[i, j]:.2f} and is to {now[i, j]:.2f} now: is it the same?"]
