"""Where a log tells of one action alone: everywhere, or in some states."""

from collections.abc import Iterator
from typing import Any

from halfseen.logs.inspection.groups import grouped_covariates
from halfseen.logs.logs import Logs

FEWEST_ROWS, FEWEST_STAGES = 10, 50


def one_action(logs: Logs) -> Iterator[str]:
    """Tell of a log in which nothing was chosen."""
    actions = logs.stages["action"].dropna()
    if len(actions) >= FEWEST_ROWS and actions.nunique() == 1:
        yield f"only one action, {actions.iloc[0]}, was ever taken: there is nothing to choose, and nothing to learn"


def no_alternative(logs: Logs) -> Iterator[str]:
    """Tell of states in which one action alone was ever tried, though others were elsewhere."""
    stages: Any = logs.stages[logs.stages["action"].notna()]
    actions = stages["action"].astype(str)
    if actions.nunique() < 2 or logs.has_objects:
        return
    for each in grouped_covariates(logs, stages):
        kinds = actions.groupby(each.group).agg(["nunique", "size", "first"])
        for group, (num_kinds, size, name) in zip(kinds.index, kinds.to_numpy(), strict=True):
            if num_kinds == 1 and size >= FEWEST_STAGES:
                where = f"{each.name} is {each.words[int(group)]}"
                yield (
                    f"where {where}, all {size} stages took {name}: nothing is known of any other action there; try "
                    "others now and then"
                )
