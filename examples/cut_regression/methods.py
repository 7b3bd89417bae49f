"""Who estimates the median: the SVM with each Ĝ, the SVM on uncut rows only, and Cox's model of the times."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from cut_regression.settings import TAU, Sample, Setting, TrueCuts
from halfseen.censoring import CensoringModel, Cox
from halfseen.learning import CensoredSVR, survival_array

Predictor = Callable[[Float[np.ndarray, "m F"]], Float[np.ndarray, " m"]]

METHODS = {
    "kaplan-meier": "the SVM weighted by Kaplan–Meier",
    "cox": "the SVM weighted by Cox's model of the cuts",
    "kernel": "the SVM weighted by kernel Kaplan–Meier",
    "true": "the SVM weighted by the truth about the cuts",
    "uncut": "the SVM on uncut rows only",
    "cox-times": "Cox's model of the times",
}
"""Method → name in a sentence."""
CONSTANT = "constant"
"""What stands for no method at all: the best constant, by the truth."""
REG = 0.005
"""λ of all SVMs: about where the one on uncut rows did best in a trial run; the weighted ones like it larger."""


def fitted(method: str, sample: Sample, setting: Setting, reg: float | str) -> Predictor:
    """Fit one of `METHODS`; the setting is known to the true Ĝ alone.

    All SVMs have the absolute loss, the Gaussian kernel of width ``"scale"``, the target min(T, τ) and, unless `reg` is
    ``"cv"``, the same λ, so they differ in their weights only. With τ an uncut row is one of which min(T, τ) was seen,
    which is kinder to the SVM on uncut rows than to take only those that finished.
    """
    if method == "cox-times":
        return cox_median(sample)
    models: dict[str, str | CensoringModel] = {"true": TrueCuts(setting), "uncut": "none"}
    model = CensoredSVR(loss="absolute", censoring=models.get(method, method), tau=TAU, reg=reg, tol=1e-5)
    return model.fit(sample.covariates, survival_array(sample.time, sample.is_finished)).predict


def cox_median(sample: Sample) -> Predictor:
    """Median of min(T, τ) by Cox's model of the times [Cox1972]_: our `Cox`, finish and cut in each other's role.

    The answer is the first time at which P(T > t | z) ≤ ½. Where the curve is still above ½ at τ, or at the last finish
    that was seen, the answer is τ: had the curve been the truth, min(T, τ) would have this median. Times are continuous
    here, so that it does not matter which of a finish and a cut comes first at equal times.
    """
    model = Cox().fit(sample.time, ~sample.is_finished, sample.covariates)
    times = model.times_[model.times_ < TAU]

    def median(covariates: Float[np.ndarray, "m F"]) -> Float[np.ndarray, " m"]:
        just_after = np.tile(times + 2.0 * model.tolerance_s_, (len(covariates), 1))
        is_above = model.survival(just_after, covariates) > 0.5
        return np.append(times, TAU)[is_above.sum(axis=1)]

    return median
