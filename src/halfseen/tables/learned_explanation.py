"""Why an action, by a policy that was learned: how far what it believes may be from the truth.

What Q is when paths are drawn anew with replacement (`bootstrap`) are draws of what Q may be. They know the sampling
error of the log, though too little of it: λ shrinks all of them alike. They do not know that Q may not be linear in its
features, which more paths do not mend. So their deviations from the mean are stretched: by a factor, and as far as an
error of Q asks for that no log ever takes away. Both numbers were chosen on tables of three cups over six steps and two
over eight, in the world's default numbers, and checked on others: ``benchmarks/calibration.py``.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from halfseen.errors import ArgumentError
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.resampling import bootstrap
from halfseen.logs import Logs
from halfseen.tables.policy import LinearTablePolicy
from halfseen.world.actions import possible_actions
from halfseen.world.explanation import Explanation, alike, explained
from halfseen.world.state import TableState, check_goes_on

WIDENED = 1.5
"""By which the deviations of the bootstrap are multiplied, where it knows the whole error."""

LASTING_ERROR = 0.1
"""Error of Q that no log takes away, in standard deviations of what a stage pays."""


@dataclass(frozen=True, eq=False)
class LearnedExplainer:
    """Explains the decisions of a policy that was learned from a log.

    Parameters
    ----------
    policy
        What was learned.
    replicates
        The same, learned from paths drawn anew; its coefficients have a leading axis.
    lasting_error
        Standard deviation of the error of Q that no log takes away [reward].
    """

    policy: LinearTablePolicy
    replicates: LinearTablePolicy
    lasting_error: float = 0.0

    @classmethod
    def of(
        cls, learner: CensoredQLearner, logs: Logs, num_replicates: int = 100, random_state: int = 0
    ) -> "LearnedExplainer":
        """Draw paths anew and fit each draw.

        Parameters
        ----------
        learner
            Fitted to `logs`, which are of tables.
        logs
            The log that it was fitted to.
        num_replicates
            B; probabilities of being best are multiples of 1/B.
        random_state
            Seed of the draws.

        Raises
        ------
        ArgumentError
            The learner is not one of tables, has not been fitted to this log, or `num_replicates` is below 2.
        """
        if num_replicates < 2:
            raise ArgumentError(f"num_replicates is {num_replicates}; at least 2 are needed")
        if not isinstance(getattr(learner, "policy_", None), LinearTablePolicy):
            raise ArgumentError("the learner has no policy_ of tables; fit it to a log of tables first")
        paid = logs.stages["reward"].to_numpy(dtype=np.float64, na_value=np.nan)
        lasting_error = LASTING_ERROR * float(np.nanstd(paid))
        return cls(learner.policy_, bootstrap(learner, logs, num_replicates, random_state).replicates, lasting_error)

    def explain(self, state: TableState, level: float = 0.9) -> Explanation:
        """Explain what the policy would do at one table.

        Parameters
        ----------
        state
            One table, with a step to go.
        level
            Probability with which the intervals are to hold.

        Returns
        -------
        Explanation
            Its values are those that `policy` goes by (lower confidence bounds, with pessimism), so its best action is
            the one that `policy` takes; intervals and probabilities are those of Q itself.

        Raises
        ------
        ArgumentError
            `level` is out of range, or the path is over.
        """
        check_goes_on(state)
        bare = replace(self.policy, margin=None)
        drawn = replace(bare, coefficients=self.replicates.coefficients).q_values(state)
        values, q, is_possible = self.policy.q_values(state), bare.q_values(state), possible_actions(state)
        # In float32 interchangeable objects differ by rounding, and that must not choose.
        same = alike(state)
        values, q, draws = (leaf[..., same].astype(np.float64) for leaf in (values, q, drawn))
        is_known = is_possible & np.isfinite(values)
        return explained(values, _stretched(q, draws, is_known, self.lasting_error), is_known, level)


def _stretched(
    q: Float[np.ndarray, " A"], draws: Float[np.ndarray, "B A"], is_known: Bool[np.ndarray, " A"], lasting_error: float
) -> Float[np.ndarray, "B A"]:
    """Draws of Q about Q, as far apart as its whole error."""
    known = draws[:, is_known]
    deviation = known - known.mean(axis=0)
    spread = np.sqrt(np.mean(deviation**2))
    factor = np.hypot(WIDENED, lasting_error / spread if spread > 0 else 0.0)
    stretched = np.full(draws.shape, -np.inf)
    stretched[:, is_known] = q[is_known] + factor * deviation
    return stretched
