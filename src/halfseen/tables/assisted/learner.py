"""The learner of tables: model-assisted censored Q-learning.

1. *Laws*, fitted to the log under censoring (`halfseen.tables.laws`).
2. *Q_h = Q_1 + E_h*: the look one step ahead under them, in closed form, and what it misses (`synthetic`).
3. *Do the laws foretell the log?* Tested by the weighted residuals of eq. 3 (`law_test`). Where they do not, the policy
   is the rule of thumb that relies on them least, or linear eq. 3 where the log clearly speaks for it (`choice`).
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import expit
from halfseen.errors import HalfseenError, PositivityError
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import PathArrays, path_arrays, stage_places
from halfseen.learning.streaming import sample_of
from halfseen.learning.targets import Weighted
from halfseen.learning.task import Encoded
from halfseen.logs import Logs, LogStream
from halfseen.planners.belief import known_seeing
from halfseen.shapes import Float
from halfseen.tables.assisted.choice import gain_of
from halfseen.tables.assisted.explain import laws_in_words
from halfseen.tables.assisted.law_test import LawTest, Watched, hotelling_test, residuals_of
from halfseen.tables.assisted.mending import Mending, mending_of
from halfseen.tables.assisted.policy import AssistedPolicy, RulePolicy
from halfseen.tables.assisted.synthetic import fitted_excess
from halfseen.tables.encoding import logged_actions, states_alone
from halfseen.tables.grasp.beta_grasp import BetaGrasp
from halfseen.tables.grasp.choice import grasp_model_of
from halfseen.tables.laws import FittedLaws, fitted_laws
from halfseen.tables.laws.evidence import Evidence, evidence_of
from halfseen.tables.laws.prices import paid_in
from halfseen.workers import Workers
from halfseen.workers.threads import in_one_thread
from halfseen.world.actions import ActionSpace, Verb
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
        As of `CensoredQLearner`: linear eq. 3 without laws, which is learned beside, and decides where the laws do not
        foretell the log and the log speaks for it.
    world
        What is known of prices and times; None to read them off the log. Its laws are not looked at.
    prior_law
        Laws about which those of the log are fitted, such as a cell's own; None for weak priors.

    Attributes
    ----------
    assisted_ : Assisted or None
        The laws, what the log says of them, and what the policy is built on; None where a verb has been added.
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
        unknown = [verb.name for verb in Verb if verb.name not in KNOWN]
        if unknown:
            why = f"no law says what comes of {', '.join(unknown)}, so Q is linear eq. 3 without laws"
            self.assisted_, self.chosen_ = None, (*self.chosen_, why)
            return self
        some = logs if isinstance(logs, Logs) else sample_of(logs, self.random_state)
        found = assisted_by_laws(some, self.model_, self.policy_, self.world, self.prior_law)
        self.assisted_, self.policy_ = found, self._of_what_was_seen(found.policy)
        self.chosen_ = (*self.chosen_, *found.sentences)
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
    LogError
        The log breaks a rule of tables.
    """
    states = states_alone(logs, model.horizon)
    known = paid_in(logs, model.horizon, _left(logs, states)) if known is None else known

    def without(rule: RulePolicy) -> Chosen:
        with suppress(HalfseenError):
            rule = replace(rule, grasp=grasp_model_of(BetaGrasp(), logs, model.horizon))
        return rule_or_linear(rule, linear, model, model.lay_out(logs), states)

    watched, why_not = watched_in(logs, states)
    found = str(why_not) if watched is None else watched
    return assisted_by(evidence_of(logs, known), found, layouts_of(states), known, model.random_state, without, prior)


def assisted_by(
    evidence: Evidence,
    watched: Watched | str,
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
    watched
        The log on which laws are tested, as `weighed` says.
    layouts
        Tables that its trajectories began with.
    known, prior
        As `TableLearner` takes them; prices and times must be told.
    seed
        Of the synthetic trajectories.
    without
        Chooses what the policy is where the laws do not foretell the log; it is given the rule of thumb.
    """
    laws = fitted_laws(evidence, known, prior)
    mending = mending_of(evidence.told, known_seeing(laws.config), evidence.dirty_share) if laws.is_mended else None
    told: tuple[str, ...] = (laws.sentence, laws_in_words(laws, evidence.tried))
    if isinstance(watched, str):
        test, told = LawTest(0.0, 1.0, {}), (*told, watched)
    else:
        states = watched.states if mending is None else mending(watched.states)
        test = hotelling_test(residuals_of(laws.config, watched._replace(states=states)), len(watched.weight))
    if not test.is_rejected:
        excess = fitted_excess(laws.config, layouts, seed)
        return Assisted(AssistedPolicy(laws.config, mending, excess), MODEL, laws, test, (*told, _foretold(test)))
    policy, basis, why = without(RulePolicy(laws.config, mending))
    return Assisted(policy, basis, laws, test, (*told, _foretold(test), why))


def layouts_of(states: TableState) -> Layout:
    """Tables that trajectories began with, of states with axes (n, T)."""
    return Layout(*(leaf[:, 0] for leaf in (states.hides, states.is_object, states.grip)))


def _left(logs: Logs, states: TableState) -> Float[np.ndarray, " rows"]:
    """Objects expected to be dirty on the table before each stage of a log."""
    is_dirty = np.where(states.is_on_table, expit(states.log_odds.astype(np.float64)), 0.0)
    return is_dirty.sum(axis=-1)[stage_places(logs)]


def watched_in(logs: Logs, states: TableState, mending: Mending | None = None) -> tuple[Watched | None, str | None]:
    """The log with its weights; or why there are none."""
    action = logged_actions(logs, states.horizon, states.num_objects)
    num_actions = ActionSpace(states.num_objects).num_actions
    nothing = Encoded(np.zeros((*action.shape, 1, 0)), np.ones((*action.shape, num_actions), dtype=bool), action)
    states = states if mending is None else mending(states)
    found = weighed(path_arrays(logs, nothing, None), states)
    return (None, found) if isinstance(found, str) else (found, None)


def weighed(paths: PathArrays, states: TableState) -> Watched | str:
    """A log with its weights; or a sentence on why there are none."""
    try:
        weighted = Weighted()
        weight = weighted.weights(paths, weighted.fit_cuts(paths.clocks))
    except PositivityError as error:
        return f"the laws are not tested on the log: {error}"
    return Watched(states, paths.action, paths.reward, weight, paths.is_last)


class Chosen(NamedTuple):
    """What the policy is where laws do not foretell the log, what it is built on, and a sentence on why."""

    policy: Policy
    basis: str
    why: str


def rule_or_linear(rule: RulePolicy, linear: Policy, model: QModel, paths: PathArrays, states: TableState) -> Chosen:
    """The rule, or linear eq. 3 where the log clearly speaks for that.

    Parameters
    ----------
    rule, linear
        The two.
    model
        Of linear eq. 3, fitted to the log but for Q.
    paths, states
        The log, as that model sees it.
    """
    gain, low = gain_of(linear, rule, model, paths, states)
    if low > 0.0:
        why = f"the policy is linear eq. 3 without laws: it is worth {gain:.2g} more than the rule (at least {low:.2g})"
        return Chosen(linear, LINEAR, why)
    why = (
        "the policy is the rule that counts history and penalty: the log does not clearly speak for linear eq. 3 "
        f"(it is worth {gain:.2g} more, perhaps {low:.2g})"
    )
    return Chosen(rule, RULE, why)


def _foretold(test: LawTest) -> str:
    said = ", ".join(f"{verb} {z:+.1f}" for verb, z in test.z.items())
    if not test.is_rejected:
        return (
            f"the laws foretell the log (p = {test.p_value:.2g}; residuals in standard errors: {said}), so Q is what "
            "they imply"
        )
    return f"the laws do not foretell the log (p = {test.p_value:.2g}; residuals in standard errors: {said})"
