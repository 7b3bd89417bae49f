"""The trial: patients in three stages, who live on for a time that treatment, wellness and tumour decide.

The trial is this project's own; that survival times are rewards, and that a stage may be the last one, follows
[GoldbergKosorok2012]_.

========  ==============================================================================================
symbol    here
========  ==============================================================================================
w, m      wellness and size of the tumour, uniform on [0, 1]² as a patient enters
a         treatment: A is aggressive, it shrinks the tumour and costs wellness; B is gentle, it does neither; C is
          between them, and offered in the second stage only
R         survival in the stage [years]: mean(w, m, a) · Gamma(2, ½); the reward
          the patient may die at the end of a stage, and the trajectory is then over: it has one stage, two or three
C         cut: exponential in the time since the patient entered, at the rate that cuts the wanted share of patients
========  ==============================================================================================
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from scipy.optimize import brentq

from halfseen.logs import Logs

HORIZON = 3
TREATMENTS = ("A", "B", "C")
ACTIONS = {1: ["A", "B"], 2: ["A", "B", "C"], 3: ["A", "B"]}
COVARIATES = ["wellness", "tumour"]
YEAR_S = 365.25 * 24 * 3600.0
NOISE = 0.1
"""Standard deviation of what a stage adds to wellness and to the tumour."""
WELLNESS_STEP = np.array([-0.25, 0.10, -0.05])
TUMOUR_STEP = np.array([-0.30, 0.15, -0.10])
"""What each treatment adds to wellness and to the tumour, on average."""

Decision = Callable[[pd.DataFrame, int], Int[np.ndarray, " m"]]
"""(covariates, stage from 1) → index of the treatment of each row."""


def mean_survival(
    w: Float[np.ndarray, "*S"], m: Float[np.ndarray, "*S"], treatment: Int[np.ndarray, "*S"] | int
) -> Float[np.ndarray, "*S"]:
    """Mean survival in a stage [years]."""
    aggressive = 0.4 + 1.4 * w * m + 0.2 * (1.0 - m)
    gentle = 0.3 + 1.2 * (1.0 - m) ** 2 * (0.5 + w) + 0.2 * w
    between = 0.3 + 1.2 * np.exp(-12.0 * ((w - 0.4) ** 2 + (m - 0.5) ** 2))
    return np.choose(treatment, [aggressive, gentle, between])


def chance_of_death(
    w: Float[np.ndarray, "*S"], m: Float[np.ndarray, "*S"], treatment: Int[np.ndarray, "*S"] | int
) -> Float[np.ndarray, "*S"]:
    """Chance that the end of a stage is the end of the patient."""
    burden = np.choose(treatment, [0.4 - 1.2 * m, 0.2 + 0.0 * m, 0.3 - 0.6 * m])
    return 1.0 / (1.0 + np.exp(2.0 - 2.2 * m + 1.5 * w - burden))


def random_treatment(covariates: pd.DataFrame, stage: int, rng: np.random.Generator) -> Int[np.ndarray, " m"]:
    """Draw one of the treatments of a stage, as the trial does."""
    return rng.integers(0, len(ACTIONS[stage]), size=len(covariates))


def follow(num_patients: int, decide: Decision | None, rng: np.random.Generator) -> pd.DataFrame:
    """Follow patients to their end, with nobody cut: a row for each stage.

    Parameters
    ----------
    num_patients
        Who enter.
    decide
        Who is treated how; None randomises, as the trial does.
    rng
        Draws.

    Returns
    -------
    DataFrame
        patient, stage, wellness, tumour, treatment (its index), survival [years].
    """
    patient = np.arange(num_patients)
    w, m = rng.random(num_patients), rng.random(num_patients)
    parts = []
    for stage in range(1, HORIZON + 1):
        frame = pd.DataFrame({"patient": patient, "stage": stage, "wellness": w, "tumour": m})
        treatment = random_treatment(frame, stage, rng) if decide is None else decide(frame, stage)
        survival = mean_survival(w, m, treatment) * rng.gamma(2.0, 0.5, size=len(w))
        parts.append(frame.assign(treatment=treatment, survival=survival))
        lives = rng.random(len(w)) >= chance_of_death(w, m, treatment)
        w = np.clip(w + WELLNESS_STEP[treatment] + NOISE * rng.normal(size=len(w)), 0.0, 1.0)
        m = np.clip(m + TUMOUR_STEP[treatment] + NOISE * rng.normal(size=len(m)), 0.0, 1.0)
        patient, w, m = patient[lives], w[lives], m[lives]
    return pd.concat(parts, ignore_index=True).sort_values(["patient", "stage"], ignore_index=True)


def trial(num_patients: int, cut_share: float, seed: int) -> Logs:
    """Run the trial and write its log.

    The reward of a stage is its time. The paper writes the clock of eq. 3 as Σ R_i for this case; a log has a clock of
    its own, ``elapsed_s``, and here that is Σ R_i, in seconds.

    Parameters
    ----------
    num_patients
        n.
    cut_share
        Share of patients who are cut, in [0, 1), in expectation.
    seed
        Of all draws; the same seed gives the same patients whatever share is cut.
    """
    rng = np.random.default_rng([seed, 1])
    cut = np.full(num_patients, np.inf)
    if cut_share > 0:
        cut = rng.exponential(size=num_patients) / cut_rate(cut_share)
    life = follow(num_patients, None, np.random.default_rng([seed, 0]))
    until = life.groupby("patient")["survival"].cumsum().to_numpy()
    cut_of_row = cut[life["patient"]]
    is_begun, is_completed = until - life["survival"] <= cut_of_row, until <= cut_of_row
    chances = np.array([1.0 / len(ACTIONS[stage]) for stage in range(1, HORIZON + 1)])
    stages = pd.DataFrame(
        {
            "trajectory": life["patient"],
            "stage": life["stage"],
            "elapsed_s": np.where(is_completed, YEAR_S * until, np.nan),
            "action": np.array(TREATMENTS, dtype=object)[life["treatment"]],
            "reward": life["survival"].where(is_completed),
            "probability": chances[life["stage"] - 1],
            **{name: life[name] for name in COVARIATES},
        }
    )
    total = np.bincount(life["patient"], life["survival"])
    is_cut: Bool[np.ndarray, " n"] = total > cut
    trajectories = pd.DataFrame(
        {
            "trajectory": np.arange(num_patients),
            "end_s": np.where(is_cut, YEAR_S * cut, stages.groupby("trajectory")["elapsed_s"].max()),
            "ending": np.where(is_cut, "cut", "finished"),
            "cause": pd.Series("left the trial", index=range(num_patients)).where(is_cut),
        }
    )
    return Logs(stages.loc[is_begun], trajectories)


@cache
def cut_rate(cut_share: float, num_patients: int = 20_000) -> float:
    """Rate of the exponential cuts that cuts a share of the randomised patients [1/years]."""
    total = follow(num_patients, None, np.random.default_rng(0)).groupby("patient")["survival"].sum().to_numpy()
    root, _ = brentq(lambda rate: float(-np.expm1(-rate * total).mean()) - cut_share, 0.0, 100.0, full_output=True)
    return float(root)
