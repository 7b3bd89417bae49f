"""What was found in words: a table, and sentences that are worked out from the numbers."""

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy import stats
from trial_comparison import CUT_SHARES, METHODS
from trial_optimum import best_sequence, optimum, random_value
from trial_patients import HORIZON

PAIRS = (("default", "linear"), ("default", "kernel"), ("kernel", "uncut only"), ("doubly robust", "kernel"))


def plain_policies() -> str:
    """Tell what needs no learning: optimum, best fixed sequence and chance, all three exact."""
    best, _ = optimum()
    fixed, name = best_sequence()
    randomised = random_value()
    return (
        f"Expected survival in {HORIZON} stages [years]: optimum {best:.3f}; best fixed sequence ({name}) {fixed:.3f}, "
        f"{fixed / best:.1%} of it; treatment by chance {randomised:.3f}, {randomised / best:.1%}."
    )


def table(found: pd.DataFrame) -> str:
    """Mean share of the optimum that each method reaches, ± its standard error, a line for each share of cuts."""
    lines = []
    for share, part in found.groupby("cut_share"):
        line = {"wanted": f"{share:.0%}", "patients cut": f"{part['measured_share'].mean():.1%}"}
        for method in (name for name in METHODS if name in set(part["method"])):
            ratios = part.loc[part["method"] == method, "ratio"].to_numpy()
            error = f"± {standard_error(ratios):.1%}" if len(ratios) > 1 else "(one trial)"
            line[method] = f"{ratios.mean():.1%} {error}"
        lines.append(line)
    return pd.DataFrame(lines).to_string(index=False)


def paired_differences(found: pd.DataFrame) -> str:
    """Tell the 95 % interval of the mean difference between two methods on the same trials, for each pair and share."""
    lines = []
    for ours, other in PAIRS:
        parts = []
        for share in CUT_SHARES:
            ratios = found[found["cut_share"] == share].pivot_table(index="trial", columns="method", values="ratio")
            if {ours, other} <= set(ratios.columns):
                parts.append(f"{share:.0%} cut: {_interval((ratios[ours] - ratios[other]).to_numpy())}")
        lines.append(f"{ours} − {other}, in % of the optimum: {'; '.join(parts)}")
    return "\n".join(lines)


def standard_error(values: Float[np.ndarray, " R"]) -> float:
    """Standard error of the mean of two values or more."""
    return float(stats.sem(values))


def _interval(differences: Float[np.ndarray, " R"]) -> str:
    if len(differences) < 2:
        return f"{differences.mean():+.1%} (one trial)"
    reach = stats.t.ppf(0.975, len(differences) - 1) * standard_error(differences)
    return f"{differences.mean():+.1%} ± {reach:.1%}"
