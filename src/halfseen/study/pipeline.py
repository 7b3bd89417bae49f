"""The pipeline from a logging policy to a learned one: play → cut → encode → treat → learn → evaluate.

*With laws*, by default, it learns as the product does from tables: laws are fitted to the log, and eq. 3 on the
weighted log checks them. *Without*, it is linear eq. 3 alone, which is reported for comparison and by which treatments
of cuts are compared, as they are treatments of eq. 3:

``imputed``
    Every begun stage, with an imputed target where it was cut, and Q at its lower confidence bound: the default of the
    product.
``weighted``
    Every completed stage, weighted by 1/Ĝ(U⁻): the paper's.
``unweighted``
    Every completed stage, with equal weights.
``dropped``
    Only trajectories that finished, all their stages with equal weights.
``failures``
    Every completed stage, with equal weights, and the stage of the cut as a failed attempt that ended the trajectory:
    WASH costs what a failure costs, LIFT the time until the cut, and the dirty objects left cost as at every end.

The grasp model in the features of linear eq. 3 is chosen by each log's attempts, the same for all treatments of the
log: so they differ only in their treatment of cuts.

*Rewards by a control variate* (`halfseen.planners.control`), if the world has laws of known probabilities: the loss of
a policy's decisions relative to V°, plus the mean of V° over many tables that are not played. Policies differ only in
the former.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import mapped
from halfseen.censoring import StageClocks, weight_diagnostics
from halfseen.errors import ArgumentError, HalfseenError
from halfseen.learning import CensoredQLearner
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.task import AUTO, Encoded
from halfseen.logs import Logs
from halfseen.planners.control import controlled_each, start_values
from halfseen.shapes import Float
from halfseen.study.policies import Entrant, decision_times_ms, logging_policy, timed_policy
from halfseen.study.setting import Setting
from halfseen.tables.assisted import RulePolicy
from halfseen.tables.encoding import encoded_states, layouts_of
from halfseen.tables.evidence import Evidence, evidence_of
from halfseen.tables.features import table_features
from halfseen.tables.grasp_attempts import attempts
from halfseen.tables.grasp_choice import choose_by, grasp_model_by
from halfseen.tables.grasp_models import BetaGrasp
from halfseen.tables.law_test import weighed
from halfseen.tables.learner import LINEAR, Assisted, Chosen, assisted_by, rule_or_linear
from halfseen.tables.policy import LinearTablePolicy
from halfseen.workers.threads import one_thread
from halfseen.world import random
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutEpisodes, CutKind, cut, cut_rate
from halfseen.world.logs import elapsed_s, to_logs
from halfseen.world.policy import GraspModel, Policy
from halfseen.world.random import Key
from halfseen.world.rollout import Episodes, evaluate_each, play
from halfseen.world.scene import Scene
from halfseen.world.state import Layout
from halfseen.world.table_world import NUM_PILOT_TRAJECTORIES

PILOT, LOGS, EVALUATION, HELD_OUT, SELECTION, STARTS = range(6)
"""Purposes of random keys; worlds of other experiments draw from `purpose` on."""
CUT_KIND: CutKind = "independent"  # how logs are cut, unless an experiment compares kinds of cuts
TREATMENTS = ("imputed", "weighted", "unweighted", "dropped", "failures")
CENSORING = {"imputed": "auto", "weighted": "kaplan-meier"}
"""Treatment → the learner's model of cuts; none for treatments not listed."""

Grasp = GraspModel | Literal["auto"] | None
"""Source of the probability of a grasp: a model; None for the rule of succession; ``"auto"``, chosen by the log."""


@lru_cache(maxsize=64)
def random_key(seed: int, purpose: int, index: int = 0) -> Key:
    """Random key of one purpose of a repetition."""
    return random.fold_in(random.fold_in(random.key_of(seed), purpose), index)


class Played(NamedTuple):
    """Rewards and robot times of a policy on single episodes."""

    reward: Float[np.ndarray, "*B"]
    robot_s: Float[np.ndarray, "*B"]

    def means(self) -> dict[str, float]:
        """Mean reward and robot time."""
        return {"reward": float(self.reward.mean()), "robot_s": float(self.robot_s.mean())}

    def on(self, episodes: Sequence[int]) -> "Played":
        """Keep some of the episodes."""
        return Played(self.reward[list(episodes)], self.robot_s[list(episodes)])


@dataclass(frozen=True)
class Source:
    """Source of the trajectories of repetition `index`: a world, its tables, and the seed of the study."""

    world: WorldConfig
    layouts: Layout
    seed: int
    index: int = 0

    @classmethod
    def of(cls, setting: Setting, index: int = 0) -> "Source":
        """The tables and the world of all experiments."""
        return cls(setting.world, setting.layouts, setting.seed, index)

    def key(self, purpose: int) -> Key:
        """Random key of a purpose."""
        return random_key(self.seed, purpose, self.index)

    def play(self, num_trajectories: int, purpose: int = LOGS) -> Episodes:
        """Uncut trajectories of the logging policy."""
        return play(self.world, self.layouts, logging_policy(self.world), self.key(purpose), num_trajectories)

    def cut(self, episodes: Episodes, rate: float, kind: CutKind) -> CutEpisodes:
        """Cut them, with the same draws for every rate and kind: a larger rate cuts the same trajectories earlier."""
        return cut(episodes, rate, kind, np.random.default_rng([self.seed, self.index, 1]))

    def cut_rate(self, share: float, kind: CutKind) -> float:
        """Rate that cuts this proportion of the trajectories in expectation, from a pilot."""
        return cut_rate(self._pilot, share, kind)

    @cached_property
    def _pilot(self) -> Episodes:
        return self.play(NUM_PILOT_TRAJECTORIES, PILOT)

    def logged(self, episodes: Episodes, grasp: Grasp = AUTO, *, laws: bool = True) -> "LoggedTrajectories":
        """Prepare episodes for learning, as `LoggedTrajectories`."""
        return LoggedTrajectories(self, episodes, grasp, laws)

    def evaluate(self, policy: Policy, num_episodes: int, purpose: int = EVALUATION) -> Played:
        """Play a policy on the episodes of a purpose, which all policies share."""
        return self.evaluate_each([policy], num_episodes, purpose)[0]

    def evaluate_each(self, policies: Sequence[Policy], num_episodes: int, purpose: int = EVALUATION) -> list[Played]:
        """Play each policy on the same episodes."""
        each = evaluate_each(self.world, self.layouts, policies, self.key(purpose), num_episodes)
        return [Played(*(np.asarray(of, dtype=np.float64) for of in (one.reward, one.robot_s))) for one in each]

    def decision_times_ms(self, contenders: Iterable[Entrant], num_states: int, laws: bool) -> dict[str, float]:
        """Median decision times [ms], on one state of each of many trajectories, alternately early and late ones.

        `laws` are those of the learned policy.
        """
        episodes = self.play(num_states)
        num_stages = np.asarray(episodes.is_taken).sum(axis=1)
        states = [mapped(lambda leaf, k=k: leaf[k, k % num_stages[k]], episodes.states) for k in range(num_states)]
        timed = {each.name: timed_policy(each, self.world, laws) for each in contenders}
        return {name: float(np.median(values)) for name, values in decision_times_ms(timed, states).items()}

    def start_value(self, num_tables: int) -> float:
        """Mean of V° over this number of initial tables, none of which is played."""
        values = start_values(self.world, self.layouts, random_key(self.seed, STARTS), np.arange(num_tables))
        return float(values.mean())

    def control_each(
        self, policies: Sequence[Policy], episodes: Sequence[int], start: float, purpose: int = EVALUATION
    ) -> list[Played]:
        """Play each policy on the same episodes, by number: rewards by the control variate, with `start_value`."""
        each = controlled_each(self.world, self.layouts, policies, self.key(purpose), np.array(episodes))
        return [Played(start + one.advantage, one.robot_s) for one in each]


def log_of(cuts: CutEpisodes, world: WorldConfig) -> Logs:
    """Episodes as a log, to read attempts and laws from; of the world, only the share of dirty objects matters."""
    # The names of tables do not affect laws; nor does the cause of a cut.
    return to_logs(cuts, CUT_KIND, (Scene(np.zeros((1, 1))),), world.dirty_share)


def treated(cuts: CutEpisodes, encoded: Encoded, treatment: str, world: WorldConfig) -> TrajectoryArrays:
    """A log as a learner sees it under one of `TREATMENTS`; equal to reading back its `Logs`, without writing it."""
    if treatment not in TREATMENTS:
        raise ArgumentError(f"treatment is {treatment!r}; give one of {', '.join(TREATMENTS)}")
    clocks = StageClocks(
        trajectory_ids=np.arange(len(cuts.end_s)),
        elapsed_s=elapsed_s(cuts),
        end_s=cuts.end_s,
        is_finished=cuts.is_finished,
        is_begun=cuts.is_begun,
        covariates=np.zeros((*cuts.is_begun.shape, 0)),
        covariate_names=(),
    )
    reward = np.where(cuts.is_completed, np.asarray(cuts.episodes.reward, dtype=np.float64), 0.0)
    if treatment == "dropped":
        kept = cuts.is_finished[:, None]
        elapsed = np.where(kept, clocks.elapsed_s, np.nan)
        clocks = clocks._replace(is_begun=clocks.is_begun & kept, elapsed_s=elapsed)
    if treatment == "failures":
        is_cut_stage = cuts.is_begun & ~cuts.is_completed
        elapsed = np.where(is_cut_stage, cuts.end_s[:, None], clocks.elapsed_s)
        clocks = clocks._replace(elapsed_s=elapsed, is_finished=np.ones_like(clocks.is_finished))
        reward = np.where(is_cut_stage, _failure_reward(cuts, world), reward)
    probability = np.asarray(cuts.episodes.probability, dtype=np.float64)
    return TrajectoryArrays(clocks, encoded, has_action=cuts.is_begun, probability=probability, reward=reward)


def _failure_reward(cuts: CutEpisodes, world: WorldConfig) -> Float[np.ndarray, "n T"]:
    verb = np.asarray(ActionSpace(cuts.episodes.states.num_objects).verb(cuts.episodes.action))
    begun_s = np.nan_to_num(elapsed_s(cuts)).max(axis=1)
    lifted = world.reward_lift_per_s * (cuts.end_s - begun_s)
    attempt = np.select([verb == Verb.WASH, verb == Verb.LIFT], [world.reward_wash_failed, lifted[:, None]], 0.0)
    is_dirty = np.asarray(cuts.episodes.hidden.is_dirty)[:, None, :]
    dirty_left = np.sum(np.asarray(cuts.episodes.states.is_on_table) & is_dirty, axis=-1)
    return attempt + world.reward_dirty_left * dirty_left


class Learned(NamedTuple):
    """The result of learning from a log.

    `weights` are the effective sample size and largest weight of eq. 3, `linear` is the policy of linear eq. 3 without
    laws, and `assisted` holds the policy with laws and its basis; None if it is `linear`.
    """

    policy: Policy
    weights: dict[str, float]
    linear: LinearTablePolicy
    assisted: Assisted | None = None

    @property
    def basis(self) -> str:
        """The basis of the policy."""
        return LINEAR if self.assisted is None else self.assisted.basis


@dataclass(frozen=True)
class LoggedTrajectories:
    """Trajectories of a source to learn from, for all cuts and treatments.

    `grasp` is the source of the probability of a grasp in the features. With `laws`, which are for weighted logs only,
    laws are fitted; without them eq. 3 is linear.
    """

    source: Source
    episodes: Episodes
    grasp: Grasp = AUTO
    laws: bool = True

    @cached_property
    def encoded(self) -> Encoded:
        """All trajectories as the learner sees them, unless a log has its own grasp model."""
        action, is_taken = (np.asarray(leaf) for leaf in (self.episodes.action, self.episodes.is_taken))
        grasp = None if isinstance(self.grasp, str) else self.grasp
        return encoded_states(self.episodes.states, action, is_taken, grasp)

    def lay_out(self, cuts: CutEpisodes, treatment: str) -> TrajectoryArrays:
        """A log as the learner sees it under a treatment."""
        return treated(cuts, self.encoded, treatment, self.source.world)

    def learn(self, logs: Sequence[tuple[CutEpisodes, str]], sizes: Sequence[int]) -> list[Learned]:
        """Learn from the first trajectories of logs, each under its treatment; at each size from all logs."""
        treatments: dict[int, list[int]] = {}
        for number, (cuts, treatment) in enumerate(logs):
            if self.laws and treatment != "weighted":
                raise ArgumentError(f"laws are fitted to weighted logs, but this one is {treatment}; give laws=False")
            treatments.setdefault(id(cuts), []).append(number)
        learned: dict[tuple[int, int], Learned] = {}
        for numbers in treatments.values():
            cuts = logs[numbers[0]][0]
            tried, evidence = pd.DataFrame({"trajectory": []}), None
            if isinstance(self.grasp, str) or self.laws:
                # A log is written and read once; its prefixes are subsets of that.
                log = log_of(cuts, self.source.world)
                tried = attempts(log, cuts.is_begun.shape[1])
                evidence = evidence_of(log, self.source.world) if self.laws else None
            laid_out = {number: self.lay_out(cuts, logs[number][1]) for number in numbers}
            for size in sizes:
                first_tried = tried.iloc[: int(tried["trajectory"].searchsorted(size))]
                grasp, encoded = self._seen_by(cuts, first_tried, size)
                first_evidence = None if evidence is None else evidence.first(size)
                for number, trajectories in laid_out.items():
                    first = trajectories.take(slice(size))._replace(encoded=encoded)
                    model = self.model(logs[number][1], grasp)
                    model = model.with_clocks(first.clocks, model.support_in(first))
                    learned[size, number] = self._learn_from(first, model, first_evidence, first_tried)
        return [learned[size, number] for size in sizes for number in range(len(logs))]

    def learn_one(self, cuts: CutEpisodes, num_trajectories: int) -> Policy:
        """Learn from the first trajectories of a log, weighted."""
        return self.learn([(cuts, "weighted")], [num_trajectories])[0].policy

    def _learn_from(
        self, trajectories: TrajectoryArrays, model: QModel, evidence: Evidence | None, tried: pd.DataFrame
    ) -> Learned:
        """Linear eq. 3, and with evidence of laws also the policy of `TableLearner`, which they assist."""
        rows = model.transitions(trajectories)
        linear = model.policy(model.fit(rows))
        found = weight_diagnostics(np.asarray(rows.weight))
        weights = {"effective_sample_size": found.effective_sample_size, "largest_weight": found.largest_weight}
        if evidence is None:
            return Learned(linear, weights, linear)
        world = self.source.world
        states = mapped(lambda leaf: np.asarray(leaf)[: trajectories.num_trajectories], self.episodes.states)

        def without(rule: RulePolicy) -> Chosen:
            with suppress(HalfseenError):
                rule = replace(rule, grasp=grasp_model_by(BetaGrasp(), tried, world.horizon))
            return rule_or_linear(rule, linear, model, trajectories, states)

        with one_thread():
            log = weighed(trajectories, states)
            assisted = assisted_by(evidence, log, layouts_of(states), world, model.random_state, without)
        return Learned(assisted.policy, weights, linear, assisted)

    def _seen_by(
        self, cuts: CutEpisodes, tried: pd.DataFrame, num_trajectories: int
    ) -> tuple[GraspModel | None, Encoded]:
        """The grasp model chosen by the attempts of the first trajectories, and the trajectories encoded with it."""
        common = mapped(lambda leaf: leaf[:num_trajectories], self.encoded)
        if not isinstance(self.grasp, str):
            return self.grasp, common
        grasp = choose_by(tried, self.source.world.horizon).grasp
        if grasp is None:
            return None, common
        at = np.nonzero(cuts.is_begun[:num_trajectories])
        there = mapped(lambda leaf: np.asarray(leaf)[at], self.episodes.states)
        features = np.zeros_like(common.features)
        features[at] = table_features(there, grasp)
        return grasp, common._replace(features=features)

    def model(self, treatment: str, grasp: GraspModel | None = None) -> QModel:
        """The product's model of Q under a treatment, without laws."""
        source = self.source
        return CensoredQLearner.for_table(
            source.world.horizon,
            laws=None,
            grasp=grasp,
            censoring=CENSORING.get(treatment, "none"),
            random_state=int(np.random.SeedSequence([source.seed, source.index]).generate_state(1)[0]),
        ).compose()


def episodes_in_turn(index: int, num_episodes: int, num_all: int) -> list[int]:
    """Episodes of a repetition that a slow policy plays: each repetition continues where the last ended.

    Episode i is of table i modulo the number of tables, so all tables are played equally often.
    """
    num_played = min(num_episodes, num_all)
    first = index * num_played if num_played < num_all else 0
    return sorted((first + k) % num_all for k in range(num_played))
