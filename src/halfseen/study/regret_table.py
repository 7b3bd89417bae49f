"""From the pieces on small tables to the table of regrets."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import pandas as pd

from halfseen.study.statistics import mean_and_error

OPTIMUM = "optimum"
COLUMNS = ["policy", "num_paths", "cut_share", "regret", "se", "regret_share", "optimum", "repetitions"]


def regret_table(baselines: Mapping[str, Any], pieces: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """How much less than the best of all policies each policy earns, mean over the small tables.

    Parameters
    ----------
    baselines
        What `halfseen.study.regret.run_regret_baselines` returned.
    pieces
        What `halfseen.study.regret.run_regret_repetition` returned, one for each repetition.

    Returns
    -------
    pandas.DataFrame
        policy, num_paths, cut_share, regret, se, regret_share, optimum, repetitions. The standard error is over
        repetitions: of learned policies, over logs; of planners, over the states in which they were asked and their own
        draws. Heuristics and the optimum are exact: their se is 0. The tables are given, so how tables differ is in no
        se. `regret_share` is the mean regret as a share of what the optimum earns above FINISH at once, `optimum` what
        it earns. num_paths and cut_share are null where nothing was learned, repetitions where nothing was repeated.
    """
    optimum = float(np.mean(baselines["optimum"]))
    scale = optimum - float(np.mean(baselines["finish"]))
    frame = pd.DataFrame(
        [row | {"regret": float(np.mean(row["regrets"]))} for piece in pieces for row in piece["rows"]]
    )
    repeated = [
        (*cast(tuple[str, float, float], key), len(group), *mean_and_error(group["regret"].to_numpy()))
        for key, group in frame.groupby(["policy", "num_paths", "cut_share"], sort=False, dropna=False)
    ]
    exact = {name: float(np.mean(regrets)) for name, regrets in baselines["regrets"].items()} | {OPTIMUM: 0.0}
    rows = [(*key, regret, se, count) for *key, count, regret, se in repeated]
    rows += [(name, None, None, regret, 0.0, None) for name, regret in exact.items()]
    table = pd.DataFrame(rows, columns=pd.Index([*COLUMNS[:5], COLUMNS[-1]]))
    table = table.assign(regret_share=table["regret"] / scale, optimum=optimum)
    # What was learned comes first, as in the other tables; the order among the others is kept.
    ordered = table.sort_values("num_paths", key=pd.isna, kind="stable", ignore_index=True)
    return ordered.loc[:, COLUMNS].astype({"num_paths": "Int64", "cut_share": "Float64", "repetitions": "Int64"})
