"""One cloud with a policy, as one stage."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from halfseen.perception.clouds import Cloud
from halfseen.perception.view import View
from halfseen.policies.decision import Decision
from halfseen.tables.present import Present
from halfseen.watch.seen_objects import Known, coloured_points, eye_over_table, shown_objects
from halfseen.watch.stage_view import Option, StageView, Watched


def watched_cloud(cloud: Cloud, view: View, now: Present | None, decision: Decision | None, horizon: int) -> Watched:
    """Show what a camera sees and what a policy decides there.

    Parameters
    ----------
    cloud, view
        What the camera returned, and what was perceived in it.
    now
        Where the trajectory stands, its first objects those of the view; None without a policy.
    decision
        What was decided; None without a policy.
    horizon
        T of the policy [stages].
    """
    title = "what is seen" if now is None else f"stage {now.stage} of {horizon}"
    if now is None or decision is None:
        stage = seen_stage(cloud, view, title, [0.5] * len(view.objects))
    else:
        chances = 1.0 / (1.0 + np.exp(-np.asarray(now.state.log_odds, dtype=np.float64)))
        stage = seen_stage(cloud, view, title, chances.tolist(), decision, [now.seen] if now.seen else [])
    return Watched(cloud.name, (stage,))


def seen_stage(
    cloud: Cloud,
    view: View,
    title: str,
    is_dirty: Sequence[float],
    decision: Decision | None = None,
    events: Sequence[str] = (),
) -> StageView:
    """Show one look, in coordinates of its table.

    Parameters
    ----------
    cloud, view
        What the camera returned, and what was perceived in it.
    title
        Which stage it is.
    is_dirty
        P(DIRTY) of each object of the view, and of others after that, which are not shown.
    decision
        What was decided; None where nothing was.
    events
        What was seen, tried and cut so far.
    """
    known = [
        Known(seen.id, float(is_dirty[seen.id]), seen.occlusion, seen.solid.middle_m, seen.solid)
        for seen in view.objects
    ]
    eye_m = eye_over_table(view, cloud)
    points_m, colours = coloured_points(cloud, np.linalg.inv(view.cloud_from_table))
    return StageView(
        title,
        points_m,
        colours,
        eye_m,
        shown_objects(known, eye_m, np.eye(4)),
        view.hides,
        () if decision is None else options_of(decision.q_values, decision.intervals, decision.chance_best),
        "" if decision is None else str(decision.action),
        "" if decision is None else decision.reason,
        () if decision is None else tuple(decision.warnings),
        (_counted(view), *events),
    )


def _counted(view: View) -> str:
    num = len(view.objects)
    cut = f", {view.num_cut} more cut by the border of the image" if view.num_cut else ""
    return f"seen: {num} object{'' if num == 1 else 's'}{cut}"


def options_of(
    q_values: Mapping[str, float | None],
    intervals: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    chance_best: Mapping[str, float] = MappingProxyType({}),
) -> tuple[Option, ...]:
    """Actions that have a value, best first, with how sure that is where it is known."""
    unknown = None, None
    known = [
        Option(name, q, *intervals.get(name, unknown), chance_best.get(name))
        for name, q in q_values.items()
        if q is not None
    ]
    return tuple(sorted(known, key=lambda option: -option.value))
