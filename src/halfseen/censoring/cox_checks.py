"""When a partial likelihood has no maximum, or more than one: say so, and say what to do."""

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.shapes import Float

# Proportion of the information in a direction that counts as none.
NO_INFORMATION = 1e-10
# A maximum that moves off takes the information with it, by a factor of about e a step; no fit comes near this.
INFORMATION_LOST = 1e-8


def refuse_too_few_cuts(num_cuts: int, names: list[str], ridge: float | int) -> None:
    """Refuse to fit more coefficients than there are cuts, unless a penalty holds them.

    Raises
    ------
    ArgumentError
        There are fewer cuts than covariates.
    """
    if num_cuts < len(names) and ridge == 0:
        raise ArgumentError(
            f"{num_cuts} {'trajectories were' if num_cuts > 1 else 'trajectory was'} cut, too few for {len(names)} "
            "covariates; leave covariates out, give ridge > 0, or use KaplanMeier"
        )


def refuse_unidentified(information: Float[np.ndarray, "p p"], num_cuts: int, names: list[str]) -> None:
    """Refuse covariates whose effects cannot be told apart, from the information at β = 0 in standard deviations.

    Raises
    ------
    ArgumentError
        A covariate does not vary where it counts, or is a linear combination of others; they are named.
    """
    own = np.diag(information)
    if (own <= NO_INFORMATION * num_cuts).any():
        column = int(np.argmin(own))
        raise ArgumentError(
            f"covariates, {names[column]}: the same for all trajectories still watched, whenever one was cut; leave it "
            "out, or give ridge > 0"
        )
    correlation = information / np.sqrt(np.outer(own, own))
    eigenvalues, directions = np.linalg.eigh(correlation)
    if eigenvalues[0] <= NO_INFORMATION:
        involved = [name for name, part in zip(names, directions[:, 0], strict=True) if abs(part) > 1e-4]
        raise ArgumentError(
            f"covariates {', '.join(involved)} are collinear (or cuts are too few to tell them apart), so their "
            "coefficients are not identified; leave one out, or give ridge > 0"
        )


def refuse_separation(
    information: Float[np.ndarray, "p p"], initial: Float[np.ndarray, "p p"], names: list[str]
) -> None:
    """Refuse a partial likelihood that has lost all its information along the way: its maximum is at infinity.

    Raises
    ------
    ArgumentError
        A coefficient runs off; its covariate is named.
    """
    import scipy.linalg

    shares, directions = scipy.linalg.eigh(information, initial)
    if shares[0] < INFORMATION_LOST:
        raise ArgumentError(separation_message(names[int(np.argmax(np.abs(directions[:, 0])))]))


def separation_message(name: str) -> str:
    """Tell which coefficient has no end: the partial likelihood is monotone in it."""
    return (
        f"covariates, {name}: its coefficient runs off to infinity, since it tells perfectly which of the trajectories "
        "still watched is cut next; leave it out, give ridge > 0, or use KaplanMeier"
    )
