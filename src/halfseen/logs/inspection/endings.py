"""Endings that do not look like ends: paths that are called finished and stop in mid-task, as a cut would stop them.

Where a task ends, something tells: the action that ends it, what it paid, or the number of stages. Stages of one action
that paid the same, with paths going on after them and paths ending, differ in nothing that is known. If those that end
are clearly shorter, too, somebody or something stopped them.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from halfseen.logs.logs import Logs

FEWEST = 10
LEVEL = 1e-4


def cuts_called_finished(logs: Logs) -> Iterator[str]:
    """Tell of finished paths that look as if they had been cut."""
    from scipy.stats import mannwhitneyu

    stages: Any = logs.stages
    duration_s = stages["elapsed_s"] - stages.groupby("path")["elapsed_s"].shift(fill_value=0.0)
    is_last = ~stages.duplicated("path", keep="last")
    finished = set(logs.paths["path"][logs.is_finished])
    is_end = is_last & stages["path"].isin(finished) & (stages["stage"] < logs.horizon)
    reward = stages["reward"].astype(float)
    for name, rows in stages.groupby(stages["action"].astype(str)).groups.items():
        ends, goes_on = reward.loc[rows][is_end.loc[rows]], reward.loc[rows][~is_last.loc[rows]]
        if len(ends) < FEWEST or len(goes_on) < FEWEST:
            continue
        paid = goes_on.mode().iloc[0] if goes_on.nunique() <= len(goes_on) / 2 else None
        if paid is None:
            continue
        alike_end, alike_on = ends.index[ends == paid], goes_on.index[goes_on == paid]
        if len(alike_end) < FEWEST or len(alike_on) < FEWEST:
            continue
        shorter = mannwhitneyu(duration_s[alike_end], duration_s[alike_on], alternative="less")
        if shorter.pvalue < LEVEL:
            ended_s, went_on_s = (float(np.median(duration_s[each])) for each in (alike_end, alike_on))
            yield (
                f"{len(alike_end)} paths are called finished after a {name} that paid {paid:g} and lasted "
                f"{ended_s:.2g} s, yet {len(alike_on)} went on after one that paid the same and lasted "
                f"{went_on_s:.2g} s: if something stopped them, their ending is 'cut', and that stage has neither "
                "reward nor elapsed_s"
            )
