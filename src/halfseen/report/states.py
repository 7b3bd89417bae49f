"""States of a log as a policy of named actions sees them: what holds numbers, and what is usual."""

from typing import Any

import pandas as pd

from halfseen.learning.flat_policy import FlatPolicy


def numeric_of(policy: FlatPolicy) -> list[str]:
    """Covariates of numbers."""
    return [name for name in policy.covariates if name not in policy.categories]


def middle_of(policy: FlatPolicy, states: pd.DataFrame) -> dict[str, Any]:
    """Median of each covariate of numbers, and the commonest category of each of text, the first of those equal."""
    return {
        name: states[name].astype(str).mode()[0] if name in policy.categories else float(states[name].median())
        for name in policy.covariates
    }
