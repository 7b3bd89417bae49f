"""What a censoring model is: anything that, once fitted to the ends of paths, tells P(C ≥ u | z)."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike


@runtime_checkable
class CensoringModel(Protocol):
    """Estimates how long a path is watched before something outside the task cuts it.

    The cut time C is itself censored, by the path's own end. At equal times completions come before cuts.

    A model that was fitted has an attribute whose name ends in ``_``, as in scikit-learn; one without is fitted, on a
    copy, by whoever needs it. A model that conditions on covariates says ``uses_covariates = True``; one that does not
    say so is taken not to (`uses_covariates`).
    """

    def fit(self, time: ArrayLike, is_finished: ArrayLike, covariates: Any = None) -> "CensoringModel":
        """Fit to the observed ends of paths `time` [s], shape (n,), False in `is_finished` where a path was cut."""
        ...

    def survival(self, u: ArrayLike, covariates: Any = None) -> Float[np.ndarray, "..."]:
        """Ĝ(u⁻ | z) = P(C ≥ u | z), the left limit, at the times `u` [s]; `covariates` has one row for each of `u`."""
        ...
