"""What must hold for a log of several robots: no two of them are at one object at once.

A stage belongs to the robot that decided at its beginning, and what a robot began is over, at the latest, by the clock
at which it decides again; what it began last may end at any time.
"""

import numpy as np
import pandas as pd
from jaxtyping import Int

from halfseen.logs.refusal import refuse, shown, value_at

ROBOT = "robot"
"""Column of the robot that decides in a stage; a log without it is of one robot."""


def check_robots(stages: pd.DataFrame, path_row: Int[np.ndarray, " rows"]) -> None:
    """Refuse two robots at one object; stages without robots are left alone.

    Parameters
    ----------
    stages
        Sorted by path and stage.
    path_row
        Path of each row.

    Raises
    ------
    LogError
        A robot began something with an object that another robot was at.
    """
    if ROBOT not in stages.columns:
        return
    row = pd.Series(np.arange(len(stages)), index=stages.index)
    begin_s = stages["elapsed_s"].groupby(path_row).shift(fill_value=0.0)
    decides_again_s = begin_s.groupby([path_row, stages[ROBOT]]).shift(-1).to_numpy()
    earlier = row.groupby([path_row, stages["object"]]).shift(1)
    there = earlier.notna().to_numpy()
    before = earlier.fillna(0).to_numpy(dtype=np.int64)
    robots = stages[ROBOT].to_numpy()
    is_still_there = decides_again_s[before] > begin_s.to_numpy()
    at_once = there & (robots[before] != robots) & is_still_there

    def told(at: int) -> str:
        target, other = shown(value_at(stages, "object", at)), shown(robots[before[at]])
        return (
            f"robot {shown(robots[at])} begins with object {target}, which robot {other} is at since stage "
            f"{value_at(stages, 'stage', int(before[at]))}; mend robot or object, or leave {ROBOT!r} out if one robot "
            "made all stages"
        )

    refuse(stages, at_once, told)
