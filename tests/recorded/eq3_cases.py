"""What eq. 3 is recorded on: learners, by name, and the numbers of a learner that must not change."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from halfseen.learning import CensoredQLearner, DoublyRobust
from halfseen.logs import read_logs
from halfseen.tables import TableTask

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "examples"
FOLDERS = {
    "cell": EXAMPLES / "pick_cell" / "logs",
    "later": EXAMPLES / "pick_cell" / "later_logs",
    "trial": HERE / "trial_300",
    "tables": HERE / "tables_100",
    "given tables": HERE / "tables_100",
    "team": EXAMPLES / "two_robots" / "logs",
}
GRIPPERS = ["suction", "parallel", "soft"]


@dataclass(frozen=True)
class GivenTables(TableTask):
    """Tables whose features are those of the recording: whatever makes features in float32 rounds its own way."""

    def encode(self, logs, horizon):
        """Features, what is possible and what was done, as recorded."""
        encoded = super().encode(logs, horizon)
        with np.load(HERE / "tables_encoded.npz") as given:
            return encoded._replace(**{name: exactly(given[name]) for name in given.files})


def exactly(array):
    """Float64 of recorded float32 numbers."""
    return array.astype(np.float64) if array.dtype == np.float32 else array


NEW = {
    "cell": partial(
        CensoredQLearner,
        4,
        {1: GRIPPERS} | {stage: [*GRIPPERS, "hand over", "stop"] for stage in (2, 3, 4)},
        ["weight_kg", "shine", "clutter"],
    ),
    "trial": partial(CensoredQLearner, 3, {1: ["A", "B"], 2: ["A", "B", "C"], 3: ["A", "B"]}, ["wellness", "tumour"]),
    "tables": partial(CensoredQLearner.for_table, 10),
    "given tables": partial(CensoredQLearner, 10, GivenTables(grasp=None)),
    "team": partial(CensoredQLearner.for_team, 2, 10, laws=None),
}
FOUR = {
    "pooled-imputed": {"stages": "pooled"},
    "separate-imputed": {"stages": "separate"},
    "pooled-weighted": {"stages": "pooled", "censoring": "kaplan-meier"},
    "separate-weighted": {"stages": "separate", "censoring": "kaplan-meier"},
}
CASES = {
    **{
        f"{log}/{name}": (log, how) for log in ("cell", "trial", "given tables", "tables") for name, how in FOUR.items()
    },
    "cell/pooled-weighted-pessimistic": ("cell", FOUR["pooled-weighted"] | {"pessimism": 1.0}),
    "cell/pooled-doubly-robust": ("cell", {"stages": "pooled", "censoring": DoublyRobust("kaplan-meier")}),
    "cell/separate-linear": ("cell", {"stages": "separate", "q_function": "linear"}),
    "given tables/auto": ("given tables", {}),
    "given tables/pooled-doubly-robust": (
        "given tables",
        {"stages": "pooled", "censoring": DoublyRobust("kaplan-meier")},
    ),
    "team/each-alone-pooled-imputed": ("team", {"stages": "pooled"}),
    "team/best-pooled-imputed": ("team", {"stages": "pooled", "base": None}),
    "team/best-pooled-weighted": ("team", {"stages": "pooled", "base": None, "censoring": "kaplan-meier"}),
}


def fitted(name):
    """A learner of a case, fitted to its log."""
    log, how = CASES[name]
    return NEW[log](**how).fit(read_logs(FOLDERS[log]))


def numbers_of(learner, recorded):
    """Coefficients, λ, weights, outcome regressions and, of the roots R, what rotations of R leave: of S = R Rᵀ."""
    q, signs = learner.q_functions_, signs_of(learner, recorded["coefficients"])
    found = {"coefficients": q.coefficients * signs, "reg": q.reg, "weights": learner.weights_}
    if q.outcome is not None:
        found["outcome"] = q.outcome * np.append(signs, np.ones(q.outcome.shape[-1] - len(signs)))
    if q.root is not None:
        found |= of_root(np.asarray(q.root) * signs[:, None])
    return {what: np.asarray(value) for what, value in found.items()}


def signs_of(learner, coefficients):
    """Of each coefficient, as recorded: an eigenvector of the landmarks' kernel has whatever sign LAPACK gives it."""
    signs, kernel_map = np.ones(coefficients.shape[-1]), getattr(learner.policy_, "kernel_map", None)
    rank = 0 if kernel_map is None else kernel_map.projection.shape[1]
    if rank:
        signs[-rank:] = np.sign(np.sum(learner.q_functions_.coefficients * coefficients, axis=(0, 1)))[-rank:]
    return signs


def of_root(root):
    """Diagonal of S = R Rᵀ, and S times a fixed vector."""
    square = root @ np.swapaxes(root, -1, -2)
    return {
        "root_diagonal": np.diagonal(square, axis1=-2, axis2=-1),
        "root_times": square @ np.cos(np.arange(square.shape[-1])),
    }


def q_of_cell(learner):
    """Q̂ by the public door, of the first 50 rows of each stage of the pick cell's or the trial's log, margins off."""
    log = "cell" if learner.horizon == 4 else "trial"
    rows = read_logs(FOLDERS[log]).stages
    each = [rows[rows["stage"] == stage].head(50) for stage in range(1, learner.horizon + 1)]
    return {f"q_{k}": learner.q_values(frame, k) for k, frame in enumerate(each, start=1)}
