"""The learners of tables: model-assisted censored Q-learning, for one robot or for a team one robot at a time.

1. *Laws*, and for a team prices, are fitted to the log under censoring (`laws`).
2. *Q = look + E*: the one-step look-ahead under these laws, and its error (`excess`).
3. *Does the log contradict the laws?* This is tested on the weighted log (`law_test`). If so, the policy of one robot
   is the heuristic that relies least on the laws, or linear eq. 3 where the log clearly supports it. The policy of a
   team is then the one learned without laws: a separate policy for each robot, improved by one Q for the team.

*Comparing two policies on a log.* Q of each policy is fitted by eq. 3 with the policy's action in place of the best
one. It is linear, without laws, and fitted to all trajectories and to all but each of some groups. The delete-a-group
jackknife estimates the standard error of the difference of the two values. Importance weights of whole trajectories
are useless here: each deviation from the logged action divides by a probability of about 3 %.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import expit
from halfseen.errors import ArgumentError, HalfseenError
from halfseen.learning.judging import judged
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.q_model import QModel
from halfseen.learning.recursion import fit_q
from halfseen.learning.rows import TrajectoryArrays, stage_places
from halfseen.learning.streaming import sample_of
from halfseen.logs import Logs, LogStream
from halfseen.planners.belief import known_seeing
from halfseen.shapes import Float
from halfseen.tables import law_test
from halfseen.tables.assisted import AssistedPolicy, AssistedTeamPolicy, RulePolicy
from halfseen.tables.encoding import layouts_of, states_alone, team_states
from halfseen.tables.evidence import Evidence, brought_by, evidence_of
from halfseen.tables.excess import counting_time, fitted_excess, fitted_team_excess
from halfseen.tables.grasp_choice import grasp_model_of
from halfseen.tables.grasp_models import BetaGrasp
from halfseen.tables.laws import FittedLaws, fitted_laws, laws_in_words, paid_in, paid_in_team
from halfseen.tables.policy import table_probabilities
from halfseen.tables.recorder import mending_of, seeing_of
from halfseen.workers import Workers
from halfseen.workers.threads import in_one_thread, one_thread
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.state import Layout, TableState

MODEL, RULE, LINEAR = "model", "rule", "linear"
KNOWN = ("FINISH", "WASH", "LIFT")
"""Verbs that the laws cover."""
NUM_GROUPS = 8
"""Groups of trajectories of the jackknife."""
GAIN_LEVEL = 0.99
"""Level of its one-sided confidence bound."""
FEWEST_TO_CHOOSE = 20
"""Fewest trajectories for comparing policies."""
UNPRICED_PER_ROBOT_S = 0.018
"""Price of a second of each of several robots where the log does not price time [1/s]. At price 0 robots wait for
whatever may still be revealed and try what hardly pays: two robots take .65 of the time of one. At this price they take
.52, for slightly less reward."""


class Assisted(NamedTuple):
    """Result of model-assisted learning."""

    policy: Policy
    basis: str
    """Basis of the policy: the model, a rule, or linear eq. 3 without laws."""
    laws: FittedLaws
    test: law_test.LawTest
    sentences: tuple[str, ...]


@dataclass(eq=False, repr=False)
class TableLearner(CensoredQLearner):
    """Learns a policy of tables from logs with cut trajectories, assisted by laws fitted to the same log.

    Parameters
    ----------
    horizon, actions, covariates, q_function, censoring, stages, reg, pessimism, random_state
        As in `CensoredQLearner`, for linear eq. 3 without laws. It is learned as well, and decides where the log
        contradicts the laws and, for one robot, supports it.
    world
        Known prices and times; None to read them from the log. Its laws are ignored.
    prior_law
        Laws at which the prior is centred, such as a cell's own; None for weak priors.

    Attributes
    ----------
    assisted_ : Assisted or None
        The laws, their test on the log, and the basis of the policy; None if no laws can be fitted.
    linear_policy_ : LinearTablePolicy or LinearTeamPolicy
        Policy of linear eq. 3 without laws.
    """

    _: KW_ONLY
    world: WorldConfig | None = None
    prior_law: WorldConfig | None = None

    assisted_: Assisted | None = field(init=False)
    linear_policy_: Any = field(init=False)

    @in_one_thread
    def fit(self, logs: Logs | LogStream, workers: Workers | None = None) -> "TableLearner":
        """Learn from a log; for a `LogStream`, the laws are fitted to a sample of its trajectories.

        Raises
        ------
        ArgumentError, LogError, PositivityError
            As in `CensoredQLearner.fit`.
        """
        super().fit(logs, workers)
        self.linear_policy_ = self.policy_
        some = logs if isinstance(logs, Logs) else sample_of(logs, self.random_state)
        try:
            found = self._assisted(some)
        except HalfseenError as error:
            self.assisted_, self.chosen_ = None, (*self.chosen_, f"Q is linear eq. 3 without laws: {error}")
            return self
        self.assisted_, self.policy_ = found, found.policy
        # Choices made for linear eq. 3 matter only where it decides.
        self.chosen_ = (*(self.chosen_ if found.basis == LINEAR else ()), *found.sentences)
        return self

    def _assisted(self, logs: Logs) -> Assisted:
        found = assisted_by_laws(logs, self.model_, self.policy_, self.world, self.prior_law)
        assert self.model_.support is not None
        # A verb that was never completed is never taken, whatever the laws imply.
        seen = np.any(self.model_.support.is_seen(self.model_.stages), axis=0)
        if seen.all() or not isinstance(found.policy, AssistedPolicy):
            return found
        return found._replace(policy=replace(found.policy, is_seen=seen))


def assisted_by_laws(
    logs: Logs, model: QModel, linear: Policy, known: WorldConfig | None = None, prior: WorldConfig | None = None
) -> Assisted:
    """Fit laws to a log, and learn a policy with them.

    `model` is that of linear eq. 3, fitted to the log except for Q, and `linear` its policy; `known` and `prior` are
    `world` and `prior_law` of `TableLearner`.

    Raises
    ------
    ArgumentError
        No law covers some verb.
    LogError
        The log breaks a rule of tables, or the outcome of an attempt is unknown.
    """
    unknown = [verb.name for verb in Verb if verb.name not in KNOWN]
    if unknown:
        raise ArgumentError(f"no law predicts the outcome of {', '.join(unknown)}")
    states = states_alone(logs, model.horizon)
    if known is None:
        is_dirty = np.where(states.is_on_table, expit(states.log_odds.astype(np.float64)), 0.0)
        known = paid_in(logs, model.horizon, is_dirty.sum(axis=-1)[stage_places(logs)])

    def without(rule: RulePolicy) -> Chosen:
        with suppress(HalfseenError):
            rule = replace(rule, grasp=grasp_model_of(BetaGrasp(), logs, model.horizon))
        return rule_or_linear(rule, linear, model, model.lay_out(logs), states)

    evidence, log = evidence_of(logs, known), law_test.weighted_log(logs, states)
    return assisted_by(evidence, log, layouts_of(states), known, model.random_state, without, prior)


def assisted_by(
    evidence: Evidence,
    log: law_test.WeightedLog | str,
    layouts: Layout,
    known: WorldConfig,
    seed: int,
    without: Callable[[RulePolicy], "Chosen"],
    prior: WorldConfig | None = None,
) -> Assisted:
    """Fit laws to the evidence of a log, test them, and learn a policy: the part of `assisted_by_laws` after reading.

    `log` is the log on which the laws are tested, or the reason why they cannot be tested. Trajectories began with
    `layouts`. `known` holds prices and times. `without` is called with the heuristic, and chooses the policy where the
    log contradicts the laws.
    """
    laws = fitted_laws(evidence, known, prior)
    mending = mending_of(evidence.labels, known_seeing(laws.config), evidence.dirty_share) if laws.is_mended else None
    sentences = [laws.sentence, laws_in_words(laws, evidence.tried)]
    test = law_test.LawTest(0.0, 1.0, {})
    if isinstance(log, str):
        sentences.append(log)
    else:
        log = log if mending is None else log._replace(states=mending(log.states))
        config, priced = law_test.with_lift_price(laws.config, log)
        laws, residuals = laws._replace(config=config), law_test.residuals_of(config, log)
        test = law_test.hotelling_test(residuals, len(log.weight))
        sentences += [*([] if priced is None else [priced]), test.sentence]
    if not test.is_rejected:
        policy = AssistedPolicy(laws.config, mending, fitted_excess(laws.config, layouts, seed))
        return Assisted(policy, MODEL, laws, test, tuple(sentences))
    policy, basis, why = without(RulePolicy(laws.config, mending))
    return Assisted(policy, basis, laws, test, (*sentences, why))


class Chosen(NamedTuple):
    """The policy where the log contradicts the laws, its basis, and a sentence that gives the reason."""

    policy: Policy
    basis: str
    why: str


def rule_or_linear(
    rule: RulePolicy, linear: Policy, model: QModel, trajectories: TrajectoryArrays, states: TableState
) -> Chosen:
    """Choose the rule, or linear eq. 3 where the log clearly supports it."""
    gain, low = gain_of(linear, rule, model, trajectories, states)
    if low > 0.0:
        why = f"the policy is linear eq. 3 without laws: it is worth {gain:.2g} more than the rule (at least {low:.2g})"
        return Chosen(linear, LINEAR, why)
    why = (
        "the policy is the rule that counts history and penalty: the log does not clearly speak for linear eq. "
        f"3 (it is worth {gain:.2g} more, but perhaps only {low:.2g})"
    )
    return Chosen(rule, RULE, why)


def gain_of(
    policy: Policy, over: Policy, model: QModel, trajectories: TrajectoryArrays, states: TableState
) -> tuple[float, float]:
    """Gain in value of one policy over another, and its lower confidence bound; the rest as in `rule_or_linear`."""
    from scipy.special import stdtrit

    if trajectories.num_trajectories < FEWEST_TO_CHOOSE:
        return 0.0, -np.inf
    group = np.random.default_rng([model.random_state, 5]).permutation(trajectories.num_trajectories) % NUM_GROUPS
    value, other = (_values(each, model, trajectories, states, group) for each in (policy, over))
    gain = value - other
    without = np.array([gain[k][group != k].mean() for k in range(NUM_GROUPS)])
    error = np.sqrt((NUM_GROUPS - 1) / NUM_GROUPS * np.sum((without - without.mean()) ** 2))
    found = float(gain[-1].mean())
    return found, found - float(stdtrit(NUM_GROUPS - 1, GAIN_LEVEL)) * float(error)


def _values(
    policy: Policy, model: QModel, trajectories: TrajectoryArrays, states: TableState, group: np.ndarray
) -> Float[np.ndarray, "G1 n"]:
    """V̂_1(S_1) of every trajectory, by Q fitted without each group and, last, to all."""
    log = model.transitions(trajectories)._replace(policy=table_probabilities(policy, states))
    regression = replace(model, pessimism=0.0).regression(*log.is_possible.shape[::2])
    found = []
    with one_thread():
        for k in range(NUM_GROUPS + 1):
            q = fit_q(log.counted((group != k).astype(np.float64)), regression)
            found.append(judged(q, log, regression.block_of_action, regression.stages, log.reward).value[:, 0])
    return np.stack(found)


@dataclass(eq=False, repr=False)
class TeamLearner(TableLearner):
    """Learns a policy of a team; it takes all parameters of `TableLearner`, and one more.

    Parameters
    ----------
    unpriced_per_robot_s
        Price of a second of each of several robots where the log does not price time, ≥ 0 [1/s].
    """

    _: KW_ONLY
    unpriced_per_robot_s: float | int = UNPRICED_PER_ROBOT_S

    def _assisted(self, logs: Logs) -> Assisted:
        states = team_states(logs, self.horizon)
        laws = team_laws(logs, states, self.world, self.prior_law)
        config, sentence, log = laws.config, laws.sentence, law_test.weighted_log(logs, states, is_team=True)
        test = law_test.LawTest(0.0, 1.0, {})
        if not isinstance(log, str):
            test = law_test.tested_on_team(config, logs, states, brought_by(logs, states), log.weight)
        said = log if isinstance(log, str) else test.sentence
        if test.is_rejected:
            why = f"{said}, so the policy is learned without them"
            return Assisted(self.linear_policy_, LINEAR, laws, test, (sentence, why))
        num_sharing = config.num_robots if config.num_robots > 1 else 0
        counted = counting_time(config, num_sharing * float(self.unpriced_per_robot_s))
        policy = AssistedTeamPolicy(counted, fitted_team_excess(counted, layouts_of(states), self.random_state))
        sentences = [sentence, said]
        if config.reward_per_s != counted.reward_per_s:
            sentences.append(
                f"the log has no price for time; a second costs {-float(counted.reward_per_s):.3g}, so that "
                "robots do not wait for little gain (unpriced_per_robot_s=0 removes this cost)"
            )
        return Assisted(policy, MODEL, laws, test, tuple(sentences))


def team_laws(
    logs: Logs, states: TableState, known: WorldConfig | None = None, prior: WorldConfig | None = None
) -> FittedLaws:
    """Fit laws and prices to the log of a team, and report whether the recorder's law of seeing is kept.

    The recorded log-odds are kept, together with the law that produced them, even where labels contradict it. Both are
    tested on the log with the other laws.
    """
    known = paid_in_team(logs, states) if known is None else known
    evidence = evidence_of(logs, known)
    laws = fitted_laws(evidence, known, prior)
    if not laws.is_mended:
        return laws
    recorder = seeing_of(evidence.labels, evidence.dirty_share).recorder
    if recorder is None:
        return laws._replace(
            sentence="no single law of seeing explains the log-odds of the log: the law is fitted to the labels"
        )
    config = replace(laws.config, seeing=recorder)
    return FittedLaws(config, False, "the law of seeing is read from the log-odds of the log")
