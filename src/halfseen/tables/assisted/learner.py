"""The learner of tables: model-assisted censored Q-learning.

1. *Laws*, fitted to the log under censoring (`halfseen.tables.laws`).
2. *Q_h = Q_1 + E_h*: the look one step ahead under them, in closed form, and what it misses (`synthetic`).
3. *Do the laws foretell the log?* Tested by the weighted residuals of eq. 3 (`law_test`). Where they do not, the policy
   is the rule of thumb that relies on them least, or linear eq. 3 where the log clearly speaks for it (`choice`).
"""

from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import expit
from halfseen.errors import HalfseenError, PositivityError
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import path_arrays, stage_places
from halfseen.learning.streaming import sample_of
from halfseen.learning.targets import Weighted
from halfseen.learning.task import Encoded
from halfseen.logs import Logs, LogStream
from halfseen.planners.belief import known_seeing
from halfseen.shapes import Float
from halfseen.tables.assisted.choice import gain_of
from halfseen.tables.assisted.law_test import LawTest, Watched, hotelling_test, residuals_of
from halfseen.tables.assisted.mending import Mending, mending_of
from halfseen.tables.assisted.policy import AssistedPolicy, RulePolicy
from halfseen.tables.assisted.synthetic import fitted_excess
from halfseen.tables.encoding import logged_actions, states_alone
from halfseen.tables.grasp.beta_grasp import BetaGrasp
from halfseen.tables.grasp.choice import grasp_model_of
from halfseen.tables.laws import FittedLaws, fitted_laws
from halfseen.tables.laws.evidence import evidence_of
from halfseen.tables.laws.prices import paid_in
from halfseen.workers import Workers
from halfseen.workers.threads import in_one_thread
from halfseen.world.actions import ActionSpace
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.state import Layout, TableState

MODEL, RULE, LINEAR = "model", "rule", "linear"


class Assisted(NamedTuple):
    """What was learned with the help of laws."""

    policy: Policy
    basis: str
    """What it is built on: the model, a rule, or linear eq. 3."""
    laws: FittedLaws
    test: LawTest
    sentences: tuple[str, ...]


@dataclass(eq=False, repr=False)
class TableLearner(CensoredQLearner):
    """Learns a policy of tables from logs of which some were cut, with the help of laws fitted to the same log.

    Parameters
    ----------
    horizon, actions, covariates, q_function, censoring, stages, reg, pessimism, random_state
        As of `CensoredQLearner`: linear eq. 3 without laws, which is learned beside, and decides where the laws do not
        foretell the log and the log speaks for it.
    world
        What is known of prices and times; None to read them off the log. Its laws are not looked at.
    prior_law
        Laws about which those of the log are fitted, such as a cell's own; None for weak priors.

    Attributes
    ----------
    assisted_ : Assisted
        The laws, what the log says of them, and what the policy is built on.
    linear_policy_ : LinearTablePolicy
        What linear eq. 3 learns without laws.
    """

    _: KW_ONLY
    world: WorldConfig | None = None
    prior_law: WorldConfig | None = None

    assisted_: Assisted = field(init=False)
    linear_policy_: Any = field(init=False)

    @in_one_thread
    def fit(self, logs: Logs | LogStream, workers: Workers | None = None) -> "TableLearner":
        """Learn from a log; of a `LogStream`, the laws from a sample of its trajectories.

        Raises
        ------
        ArgumentError, LogError, PositivityError
            As of `CensoredQLearner.fit`.
        """
        super().fit(logs, workers)
        self.linear_policy_ = self.policy_
        some = logs if isinstance(logs, Logs) else sample_of(logs, self.random_state)
        self.assisted_ = assisted_by_laws(some, self.model_, self.policy_, self.world, self.prior_law)
        self.policy_ = self.assisted_.policy
        self.chosen_ = (*self.chosen_, *self.assisted_.sentences)
        return self


def assisted_by_laws(
    logs: Logs,
    model: QModel,
    linear: Policy,
    known: WorldConfig | None = None,
    prior: WorldConfig | None = None,
) -> Assisted:
    """Fit laws to a log, and learn with their help.

    Parameters
    ----------
    logs
        A log of one robot's tables.
    model
        Of linear eq. 3, fitted to the log but for Q.
    linear
        What that learns.
    known, prior
        As `TableLearner` takes them.

    Raises
    ------
    LogError
        The log breaks a rule of tables.
    """
    states = states_alone(logs, model.horizon)
    known = paid_in(logs, model.horizon, _left(logs, states)) if known is None else known
    evidence = evidence_of(logs, known)
    laws = fitted_laws(evidence, known, prior)
    mending = mending_of(evidence.told, known_seeing(laws.config), evidence.dirty_share) if laws.is_mended else None
    watched, why_not = watched_in(logs, states, mending)
    test = (
        LawTest(0.0, 1.0, {}) if watched is None else hotelling_test(residuals_of(laws.config, watched), logs.num_paths)
    )
    told = (laws.sentence, *([] if why_not is None else [why_not]))
    if not test.is_rejected:
        layouts = Layout(*(leaf[:, 0] for leaf in (states.hides, states.is_object, states.grip)))
        excess = fitted_excess(laws.config, layouts, model.random_state)
        return Assisted(AssistedPolicy(laws.config, mending, excess), MODEL, laws, test, (*told, _foretold(test)))
    policy, basis, why = _without_laws(logs, model, linear, states, RulePolicy(laws.config, mending))
    return Assisted(policy, basis, laws, test, (*told, _foretold(test), why))


def _left(logs: Logs, states: TableState) -> Float[np.ndarray, " rows"]:
    """Objects expected to be dirty on the table before each stage of a log."""
    is_dirty = np.where(states.is_on_table, expit(states.log_odds.astype(np.float64)), 0.0)
    return is_dirty.sum(axis=-1)[stage_places(logs)]


def watched_in(logs: Logs, states: TableState, mending: Mending | None = None) -> tuple[Watched | None, str | None]:
    """The log with its weights; or why there are none."""
    action = logged_actions(logs, states.horizon, states.num_objects)
    num_actions = ActionSpace(states.num_objects).num_actions
    nothing = Encoded(np.zeros((*action.shape, 1, 0)), np.ones((*action.shape, num_actions), dtype=bool), action)
    paths = path_arrays(logs, nothing, None)
    try:
        weighted = Weighted()
        weight = weighted.weights(paths, weighted.fit_cuts(paths.clocks))
    except PositivityError as error:
        return None, f"the laws are not tested on the log: {error}"
    states = states if mending is None else mending(states)
    return Watched(states, paths.action, paths.reward, weight, paths.is_last), None


def _without_laws(
    logs: Logs, model: QModel, linear: Policy, states: TableState, rule: RulePolicy
) -> tuple[Policy, str, str]:
    """The rule, or linear eq. 3 where the log clearly speaks for that."""
    with suppress(HalfseenError):
        rule = replace(rule, grasp=grasp_model_of(BetaGrasp(), logs, model.horizon))
    gain, low = gain_of(linear, rule, model, model.lay_out(logs), states)
    if low > 0.0:
        why = f"the policy is linear eq. 3 without laws: it is worth {gain:.2g} more than the rule (at least {low:.2g})"
        return linear, LINEAR, why
    why = (
        "the policy is the rule that counts history and penalty: the log does not clearly speak for linear eq. 3 "
        f"(it is worth {gain:.2g} more, perhaps {low:.2g})"
    )
    return rule, RULE, why


def _foretold(test: LawTest) -> str:
    said = ", ".join(f"{verb} {z:+.1f}" for verb, z in test.z.items())
    if not test.is_rejected:
        return (
            f"the laws foretell the log (p = {test.p_value:.2g}; residuals in standard errors: {said}), so Q is what "
            "they imply"
        )
    return f"the laws do not foretell the log (p = {test.p_value:.2g}; residuals in standard errors: {said})"
