"""How strong a cause of cuts that was not recorded would have to be to undo a verdict (Γ).

Weights 1/Ĝ are right if, given what was recorded, cuts have nothing to do with what would have followed. Suppose that
something else has a say, and that of two stages which look alike it makes the odds of being seen to the end up to Γ
times as large for one as the model has it, and as small for another: the true weight of a completed stage is then some

    w* ∈ [1 + (w − 1)/Γ, 1 + (w − 1)Γ],    w = 1/Ĝ(U_t⁻)

(the marginal sensitivity model [Tan2006]_). Weights of a stage have a known mean, so what one stage gains another
loses [DornGuo2023]_. Of all such weights those that shift Σ_t E[w* v_t] most, v the weighted error of Q, give Γ to the
stages below the 1/(Γ + 1)-quantile of v (by w − 1), and 1/Γ to those above, or the other way round.

Γ is where the end of the interval that lies nearer to 0, shifted by so much, reaches it. v holds the whole error of Q,
of which the regression of cut stages may know a part; so the true Γ is as large or larger. That the interval itself
would be another under other weights is left out. Γ of 1 trusts the model, and
2 is a cause which doubles or halves the odds.
"""

from math import exp, log

import numpy as np

from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.student_t import crossing
from halfseen.shapes import Float

STRONGEST = 100.0
"""Γ beyond which nothing is looked for."""


def shift(excess: Float[np.ndarray, "n T"], error: Float[np.ndarray, "n T"], gamma: float) -> float:
    """The furthest that causes of strength Γ take Σ_t E[w v_t] down.

    Parameters
    ----------
    excess
        w − 1 of each completed stage, 0 elsewhere.
    error
        v.
    gamma
        Γ ≥ 1.
    """
    return float(sum(_shift(*columns, gamma) for columns in zip(excess.T, error.T, strict=True)) / len(excess))


def undone_at(difference: Estimate, excess: Float[np.ndarray, "n T"], error: Float[np.ndarray, "n T"]) -> float:
    """Γ that takes an interval to 0.

    Parameters
    ----------
    difference
        Value of a policy less that of another.
    excess
        w − 1 of each completed stage, 0 elsewhere.
    error
        What w is multiplied by in the difference.

    Returns
    -------
    gamma
        1 where the interval holds 0 already; `STRONGEST` where nothing weaker does it.
    """
    is_above = difference.value > 0
    lead = difference.low if is_above else -difference.high
    if lead <= 0:
        return 1.0
    signed = error if is_above else -error
    if lead + shift(excess, signed, STRONGEST) > 0:
        return STRONGEST
    log_gamma = crossing(lambda each: lead + shift(excess, signed, exp(each)), 0.0, log(STRONGEST))
    return exp(log_gamma)


def in_words(gamma: float) -> str:
    """Say how much it would take, in one sentence."""
    how = f"more than {STRONGEST:g}" if gamma >= STRONGEST else f"{gamma:.2g}"
    if gamma < 1.05:
        return "Any cause of cuts that is not in the log could undo this"
    return (
        f"To undo this, a cause of cuts that is not in the log would have to change the odds of being cut by a factor "
        f"of {how}"
    )


def _shift(excess: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"], gamma: float) -> float:
    """The same of one stage, summed over trajectories."""
    order = np.argsort(error, kind="stable")
    excess, error = np.maximum(excess[order], 0.0), error[order]
    total = excess.sum()
    # Of each stage as much of its excess gets Γ as lies below the quantile: of one all, of the next a part, then none.
    raised = np.clip(total / (gamma + 1.0) - (np.cumsum(excess) - excess), 0.0, excess)
    return float(np.sum(error * ((gamma - 1.0) * raised - (1.0 - 1.0 / gamma) * (excess - raised))))
