"""Why an action, by a policy that was learned: how much it hangs on which paths happened to be logged.

What Q is when paths are drawn anew with replacement (`bootstrap`) are draws of what Q may be.

The bootstrap knows the sampling error of the log. It does not know that Q may not be linear in its features, which more
paths do not mend. So the probabilities are those of a policy that can be learned from such logs, and too sure of
themselves as probabilities of what is best of all: ``benchmarks/calibration.py`` says by how much.
"""

from dataclasses import dataclass, replace

import jax
import numpy as np

from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.bootstrap import bootstrap
from halfseen.learners.q_learning.q_learner import CensoredQLearner
from halfseen.logs import Logs
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.action_space import possible_actions
from halfseen.world.explanation import Explanation, alike, explained
from halfseen.world.state import TableState, check_goes_on


@jax.jit
def _values_and_draws(policy: LinearTablePolicy, replicates: jax.Array, state: TableState):
    draws = jax.vmap(lambda coefficients: replace(policy, coefficients=coefficients).q_values(state))(replicates)
    return policy.q_values(state), draws, possible_actions(state)


@dataclass(frozen=True, eq=False)
class LearnedExplainer:
    """Explains the decisions of a policy that was learned from a log.

    Parameters
    ----------
    policy
        What was learned.
    replicates
        The same, learned from paths drawn anew; its coefficients have a leading axis.
    """

    policy: LinearTablePolicy
    replicates: LinearTablePolicy

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
        return cls(learner.policy_, bootstrap(learner, logs, num_replicates, random_state).replicates)

    def explain(self, state: TableState, level: float = 0.9) -> Explanation:
        """Explain what the policy would do at one table.

        Parameters
        ----------
        state
            One table, with a step to go.
        level
            Probability with which the intervals would hold if Q were linear in its features.

        Returns
        -------
        Explanation
            Its values are those of `policy`, so its best action is the one that `policy` takes.

        Raises
        ------
        ArgumentError
            `level` is out of range, or the path is over.
        """
        check_goes_on(state)
        leaves = _values_and_draws(self.policy, self.replicates.coefficients, state)
        values, draws, is_possible = (np.asarray(leaf) for leaf in leaves)
        # In float32 interchangeable objects differ by rounding, and that must not choose.
        same = alike(state)
        return explained(values[same].astype(np.float64), draws[:, same].astype(np.float64), is_possible, level)
