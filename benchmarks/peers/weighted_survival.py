"""DWSurv [Simoneau, Moodie, Nijjar, Platt, 2019]: the blip of log survival by one weighted linear regression a stage.

With 𝛿 whether the time was seen, π(x) the probability of treatment 1 and κ(x) that of being seen, both logistic,

    log T = β·f + ψ·(a h) + ε,    weights  𝛿 |a − π(x)| / κ(x),

so that ψ is right if β·f is, or if π and κ are.
"""

import numpy as np
from jaxtyping import Bool, Float
from sklearn.linear_model import LogisticRegression

RIDGE = 100.0


def blip(
    log_time: Float[np.ndarray, " n"],
    treated: Float[np.ndarray, " n"],
    is_seen: Bool[np.ndarray, " n"],
    free: Float[np.ndarray, "n F"],
    modifier: Float[np.ndarray, "n P"],
    of_treatment: Float[np.ndarray, "n K"] | None,
    of_seeing: Float[np.ndarray, "n L"] | None,
) -> Float[np.ndarray, " P"]:
    """ψ; designs have their column of ones, `log_time` counts where it was seen, and None stands for no weights."""
    weight = np.ones(len(treated))
    if of_treatment is not None:
        weight = np.abs(treated - logistic(of_treatment, treated))
    if of_seeing is not None:
        weight = weight / logistic(of_seeing, is_seen.astype(float))
    design = np.column_stack([free, treated[:, None] * modifier])[is_seen]
    root = np.sqrt(weight[is_seen])
    found = np.linalg.lstsq(design * root[:, None], log_time[is_seen] * root, rcond=None)[0]
    return found[free.shape[1] :]


def logistic(design: Float[np.ndarray, "n K"], outcome: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Fitted probabilities; a slight ridge keeps them from 0 where few are separated by many covariates."""
    if design.shape[1] == 1 or len(np.unique(outcome)) == 1:
        return np.full(len(outcome), outcome.mean())
    fitted = LogisticRegression(C=RIDGE).fit(design[:, 1:], outcome)
    return fitted.predict_proba(design[:, 1:])[:, 1]
