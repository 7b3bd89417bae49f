"""Whether attempts hold as often as was predicted, by what is hidden and by what was predicted."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import Rows
from halfseen.cell.calibration.attempts import OCCLUSION_EDGES, Share, occlusion_bins, shares_by
from halfseen.shapes import Float, Int
from halfseen.study.experiment import PieceOf
from halfseen.study.experiments.attempts.design import MODEL_NAMES, NUM_PREDICTION_BINS


def calibration_of(tried: pd.DataFrame, repetitions: Sequence[PieceOf]) -> pd.DataFrame:
    """Compare shares that held with predictions of models that had not seen the table.

    An attempt that was held out more than once counts once, with the mean of what was said of it.

    Parameters
    ----------
    tried
        All attempts.
    repetitions
        With rows (of `tried`), row_weight, and what each model said of them, learned from the largest log.
    """
    num = np.zeros(len(tried))
    sums = {name: np.zeros(len(tried)) for name in ("weight", *MODEL_NAMES)}
    for piece in repetitions:
        rows = np.array(piece["rows"], dtype=np.int64)
        num[rows] += 1.0
        sums["weight"][rows] += piece["row_weight"]
        for model in MODEL_NAMES:
            sums[model][rows] += piece["said"][model]
    kept = np.flatnonzero(num)
    mean = {name: values[kept] / num[kept] for name, values in sums.items()}
    met = tried.iloc[kept]
    held, tables = met["succeeded"].to_numpy(dtype=bool), met["trajectory"].to_numpy()
    lines = []
    for model in MODEL_NAMES:
        by_prediction, edges = _alike(mean[model])
        ways = {
            "occlusion": (occlusion_bins(met["occlusion"].to_numpy()), OCCLUSION_EDGES),
            "prediction": (by_prediction, edges),
        }
        for by, (groups, ends) in ways.items():
            found = shares_by(groups, held, mean[model], mean["weight"], tables)
            lines += [_line(model, by, ends[k : k + 2], share, len(kept)) for k, share in found.items()]
    return pd.DataFrame(lines)


def _alike(said: Rows) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " edges"]]:
    """Groups of attempts, about alike in number, by what was said of them; equal predictions stay together."""
    edges = np.unique(np.quantile(said, np.linspace(0.0, 1.0, NUM_PREDICTION_BINS + 1)))
    if len(edges) < 2:
        edges = np.repeat(edges, 2)
    return np.searchsorted(edges[1:-1], said, side="right").astype(np.int64), edges


def _line(model: str, by: str, ends: Float[np.ndarray, "2"], share: Share, num_all: int) -> dict[str, Any]:
    low, high = share.low - share.predicted, share.high - share.predicted
    return {
        "model": model,
        "by": by,
        "bin_from": float(ends[0]),
        "bin_to": float(ends[1]),
        "attempts": share.num_attempts,
        "share_of_attempts": share.num_attempts / num_all,
        "tables": share.num_tables,
        "mean_probability": share.predicted,
        "share_held": share.held,
        "difference": share.difference,
        "low": low,
        "high": high,
    }
