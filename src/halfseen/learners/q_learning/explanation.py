"""Why an action, by a policy that was learned: how much it hangs on which paths happened to be logged.

Paths are drawn anew from the log with replacement, and Q is fitted to each such draw as it was to the log (the
bootstrap [Efron1979]_): a path that was drawn k times counts k times, with the weight δ / Ĝ that it had. What Q is in
each of these fits are draws of what Q may be.

The bootstrap knows what chance did to the log. It does not know that Q may not be linear in its features, which more
paths do not mend, nor how wrong Ĝ is, which is not estimated anew. So the chances are those of a policy that can be
learned from such logs, and too sure of themselves as chances of what is best of all: ``benchmarks/calibration.py``
says by how much.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.encoding import Encoding, TableEncoding
from halfseen.learners.q_learning.linear_policy import LinearTablePolicy
from halfseen.learners.q_learning.q_learner import REGS, CensoredQLearner, as_policy
from halfseen.learners.q_learning.recursion import QFunctions, StageMode, Transitions, backward
from halfseen.logs import Logs
from halfseen.world.actions import possible_actions
from halfseen.world.explanation import Explanation, alike, explained
from halfseen.world.state import TableState

_BATCH_SIZE = 10


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
            B; chances of being best are multiples of 1/B.
        random_state
            Seed of the draws.

        Raises
        ------
        ArgumentError
            The learner is not one of tables, has not been fitted to this log, or `num_replicates` is below 2.
        """
        if num_replicates < 2:
            raise ArgumentError(f"num_replicates is {num_replicates}; at least 2 are needed")
        log, encoding, num_folds = _fitted_log(learner, logs)
        regs = REGS if learner.reg == "cv" else np.array([float(learner.reg)])
        stages: StageMode = "pooled" if learner.stages == "pooled" else "separate"
        q = bootstrap(log, encoding, regs, stages, num_folds, num_replicates, random_state)
        return cls(learner.policy_, replace(learner.policy_, coefficients=as_policy(q, stages).coefficients))

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
        if int(state.steps_to_go) < 1 or not np.asarray(state.is_on_table).any():
            raise ArgumentError("the path is over: no step to go or no object left; explain a state before its end")
        told = (np.asarray(leaf) for leaf in _values_and_draws(self.policy, self.replicates.coefficients, state))
        values, draws, is_possible = told
        # In float32 interchangeable objects differ by rounding, and that must not choose.
        same = alike(state)
        return explained(values[same].astype(np.float64), draws[:, same].astype(np.float64), is_possible, level)


def bootstrap(
    log: Transitions,
    encoding: Encoding,
    regs: Float[np.ndarray, " L"],
    stages: StageMode,
    num_folds: int,
    num_replicates: int = 100,
    seed: int = 0,
) -> QFunctions:
    """Fit Q to paths drawn anew with replacement, in float64.

    Parameters
    ----------
    log
        One log.
    encoding, regs, stages, num_folds
        As for `fit_q_functions`.
    num_replicates
        B, draws of as many paths as the log has.
    seed
        Seed of the draws.

    Returns
    -------
    QFunctions
        With a leading axis of B.
    """
    num_paths = len(log.action)
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(num_paths, np.full(num_paths, 1.0 / num_paths), size=num_replicates)
    options = {
        "num_blocks": encoding.num_blocks,
        "stages": stages,
        "num_folds": num_folds,
        "end_action": encoding.end_action if stages == "pooled" else None,
    }
    with jax.enable_x64(True):
        blocks = jnp.asarray(encoding.block_of_action(log.is_possible.shape[-1]))
        arrays = jax.tree.map(jnp.asarray, log)
        fits = _fit_each(
            arrays, jnp.asarray(counts, dtype=np.float64), blocks, jnp.asarray(regs), tuple(options.items())
        )
        return QFunctions(*(np.asarray(leaf) for leaf in fits))


@partial(jax.jit, static_argnames="options")
def _fit_each(
    log: Transitions, counts: jax.Array, blocks: jax.Array, regs: jax.Array, options: tuple[tuple[str, Any], ...]
) -> QFunctions:
    def fit(count: jax.Array) -> QFunctions:
        return backward(log._replace(weight=log.weight * count[:, None]), blocks, regs, **dict(options))

    return jax.lax.map(fit, counts, batch_size=_BATCH_SIZE)


def _fitted_log(learner: CensoredQLearner, logs: Logs) -> tuple[Transitions, Encoding, int]:
    """What a learner of tables was fitted to."""
    if not hasattr(learner, "policy_"):
        raise ArgumentError("the learner has no policy_; fit it to a log of tables first")
    if learner.weights_.shape[0] != logs.num_paths:
        raise ArgumentError(
            f"the log has {logs.num_paths} paths, but the learner was fitted to {learner.weights_.shape[0]}; give it "
            "the log that it was fitted to"
        )
    encoding = TableEncoding(learner.horizon, learner.grasp_)
    num_folds = min(learner.num_folds, logs.num_paths) if learner.reg == "cv" else 1
    return learner.transitions(logs, encoding, num_folds), encoding, num_folds
