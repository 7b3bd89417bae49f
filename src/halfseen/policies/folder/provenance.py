"""Which logs a policy comes from: the folders that were joined, and which of their trajectories."""

from typing import Any

from halfseen.lazy import Frame
from halfseen.logs.joining import RUN, RUN_TRAJECTORY


def sources_of(trajectories: Frame, name: str | None = None) -> list[dict[str, Any]]:
    """Name the logs that a log is made of, in their order.

    Parameters
    ----------
    trajectories
        Its table; one that was joined of several folders says which (`halfseen.logs.compact`).
    name
        Of a log that does not say where it comes from.

    Returns
    -------
    list of dict
        ``name``, ``num_trajectories``, and what its ``first`` and ``last`` one are called there.
    """
    is_joined = RUN in trajectories.columns and RUN_TRAJECTORY in trajectories.columns
    names: Any = trajectories[RUN_TRAJECTORY if is_joined else "trajectory"]
    each = names.groupby(trajectories[RUN], sort=False) if is_joined else [(name, names)]
    return [
        {"name": run, "num_trajectories": len(some), "first": some.iloc[0], "last": some.iloc[-1]} for run, some in each
    ]
