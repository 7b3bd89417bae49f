"""The learner of tables: model-assisted censored Q-learning.

1. *Laws*, fitted to the log under censoring (`halfseen.tables.laws`).
2. *Q_h = Q_1 + E_h*: the look one step ahead under them, in closed form, and what it misses (`synthetic`).
3. *Does the log contradict the laws?* Tested by the weighted residuals of eq. 3 (`law_test`). Where it does, the policy
   is the rule of thumb that relies on them least, or linear eq. 3 where the log clearly speaks for it (`choice`).
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import expit
from halfseen.errors import ArgumentError, HalfseenError
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import TrajectoryArrays, stage_places
from halfseen.learning.streaming import sample_of
from halfseen.logs import Logs, LogStream
from halfseen.planners.belief import known_seeing
from halfseen.shapes import Float
from halfseen.tables.assisted.choice import gain_of
from halfseen.tables.assisted.explain import laws_in_words
from halfseen.tables.assisted.law_test import LawTest, hotelling_test, residuals_of
from halfseen.tables.assisted.lift_price import with_lift_price
from halfseen.tables.assisted.mending import mending_of
from halfseen.tables.assisted.policy import AssistedPolicy, RulePolicy
from halfseen.tables.assisted.synthetic import fitted_excess
from halfseen.tables.assisted.weighted_log import WeightedLog, layouts_of, weighted_log
from halfseen.tables.encoding import states_alone
from halfseen.tables.grasp.beta_grasp import BetaGrasp
from halfseen.tables.grasp.choice import grasp_model_of
from halfseen.tables.laws import FittedLaws, fitted_laws
from halfseen.tables.laws.evidence import Evidence, evidence_of
from halfseen.tables.laws.prices import paid_in
from halfseen.workers import Workers
from halfseen.workers.threads import in_one_thread
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.state import Layout, TableState

MODEL, RULE, LINEAR = "model", "rule", "linear"
KNOWN = ("FINISH", "WASH", "LIFT")
"""Verbs that laws say something of."""


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
        As of `CensoredQLearner`: linear eq. 3 without laws, which is learned beside, and decides where the log
        contradicts the laws and speaks for it.
    world
        What is known of prices and times; None to read them off the log. Its laws are not looked at.
    prior_law
        Laws about which those of the log are fitted, such as a cell's own; None for weak priors.

    Attributes
    ----------
    assisted_ : Assisted or None
        The laws, what the log says of them, and what the policy is built on; None where none can be fitted.
    linear_policy_ : LinearTablePolicy
        What linear eq. 3 learns without laws.
    """

    _: KW_ONLY
    world: WorldConfig | None = None
    prior_law: WorldConfig | None = None

    assisted_: Assisted | None = field(init=False)
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
        try:
            found = assisted_by_laws(some, self.model_, self.policy_, self.world, self.prior_law)
        except HalfseenError as error:
            self.assisted_, self.chosen_ = None, (*self.chosen_, f"Q is linear eq. 3 without laws: {error}")
            return self
        self.assisted_, self.policy_ = found, self._of_what_was_seen(found.policy)
        # What was chosen for linear eq. 3 matters where that decides.
        self.chosen_ = (*(self.chosen_ if found.basis == LINEAR else ()), *found.sentences)
        return self

    def _of_what_was_seen(self, policy: Policy) -> Policy:
        """A verb that was never completed is never taken, whatever laws imply for it."""
        assert self.model_.support is not None
        seen = np.any(self.model_.support.is_seen(self.model_.stages), axis=0)
        return replace(policy, is_seen=seen) if isinstance(policy, AssistedPolicy) and not seen.all() else policy


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
    ArgumentError
        There is a verb of which no law says what comes of it.
    LogError
        The log breaks a rule of tables, or does not tell what became of its attempts.
    """
    unknown = [verb.name for verb in Verb if verb.name not in KNOWN]
    if unknown:
        raise ArgumentError(f"no law says what comes of {', '.join(unknown)}")
    states = states_alone(logs, model.horizon)
    known = paid_in(logs, model.horizon, _left(logs, states)) if known is None else known

    def without(rule: RulePolicy) -> Chosen:
        with suppress(HalfseenError):
            rule = replace(rule, grasp=grasp_model_of(BetaGrasp(), logs, model.horizon))
        return rule_or_linear(rule, linear, model, model.lay_out(logs), states)

    evidence, log = evidence_of(logs, known), weighted_log(logs, states)
    return assisted_by(evidence, log, layouts_of(states), known, model.random_state, without, prior)


def assisted_by(
    evidence: Evidence,
    log: WeightedLog | str,
    layouts: Layout,
    known: WorldConfig,
    seed: int,
    without: Callable[[RulePolicy], "Chosen"],
    prior: WorldConfig | None = None,
) -> Assisted:
    """Learn from what a log tells of laws, and test them on it: what `assisted_by_laws` does once all is read.

    Parameters
    ----------
    evidence
        What it tells.
    log
        On which the laws are tested; or why they cannot be.
    layouts
        Tables that its trajectories began with.
    known, prior
        As `TableLearner` takes them; prices and times must be told.
    seed
        Of the synthetic trajectories.
    without
        Chooses what the policy is where the log contradicts the laws; it is given the rule of thumb.
    """
    laws = fitted_laws(evidence, known, prior)
    mending = mending_of(evidence.told, known_seeing(laws.config), evidence.dirty_share) if laws.is_mended else None
    told: tuple[str, ...] = (laws.sentence, laws_in_words(laws, evidence.tried))
    if isinstance(log, str):
        test, said = LawTest(0.0, 1.0, {}), log
    else:
        log = log if mending is None else log._replace(states=mending(log.states))
        config, priced = with_lift_price(laws.config, log)
        laws, told = laws._replace(config=config), (*told, *([] if priced is None else [priced]))
        test = hotelling_test(residuals_of(config, log), len(log.weight))
        said = test.sentence
    if not test.is_rejected:
        excess = fitted_excess(laws.config, layouts, seed)
        return Assisted(AssistedPolicy(laws.config, mending, excess), MODEL, laws, test, (*told, said))
    policy, basis, why = without(RulePolicy(laws.config, mending))
    return Assisted(policy, basis, laws, test, (*told, said, why))


def _left(logs: Logs, states: TableState) -> Float[np.ndarray, " rows"]:
    """Objects expected to be dirty on the table before each stage of a log."""
    is_dirty = np.where(states.is_on_table, expit(states.log_odds.astype(np.float64)), 0.0)
    return is_dirty.sum(axis=-1)[stage_places(logs)]


class Chosen(NamedTuple):
    """What the policy is where the log contradicts the laws, what it is built on, and a sentence on why."""

    policy: Policy
    basis: str
    why: str


def rule_or_linear(
    rule: RulePolicy, linear: Policy, model: QModel, trajectories: TrajectoryArrays, states: TableState
) -> Chosen:
    """The rule, or linear eq. 3 where the log clearly speaks for that.

    Parameters
    ----------
    rule, linear
        The two.
    model
        Of linear eq. 3, fitted to the log but for Q.
    trajectories, states
        The log, as that model sees it.
    """
    gain, low = gain_of(linear, rule, model, trajectories, states)
    if low > 0.0:
        why = f"the policy is linear eq. 3 without laws: it is worth {gain:.2g} more than the rule (at least {low:.2g})"
        return Chosen(linear, LINEAR, why)
    why = (
        "the policy is the rule that counts history and penalty: the log does not clearly speak for linear eq. 3 "
        f"(it is worth {gain:.2g} more, perhaps {low:.2g})"
    )
    return Chosen(rule, RULE, why)
