"""The one way from a policy to a policy: play → cut → encode → treat → learn → evaluate.

What tells the probability of a grasp in the features is chosen by each log's attempts, as where the product is told
nothing, and alike for all treatments of the log: so they differ in what they make of cuts alone.

A cut path is treated in one of five ways, as what the learner sees of it:

``imputed``
    Every begun stage, with an imputed target where it was cut, and Q at its lower confidence bound: what the product
    does where nothing is said.
``weighted``
    Every completed stage, weighted by 1/Ĝ(U⁻): the paper's.
``unweighted``
    Every completed stage alike.
``dropped``
    Only paths that finished, all their stages alike.
``failures``
    Every completed stage alike, and the stage in which the cut fell counts as a failed attempt that ended the path:
    WASH costs what a failure costs, LIFT the time until the cut, and the dirty objects left are paid for as at every
    end.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import mapped
from halfseen.censoring import StageClocks, weight_diagnostics
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import PathArrays
from halfseen.learning.task import AUTO, Encoded
from halfseen.shapes import Float
from halfseen.study.experiment import Setting
from halfseen.study.policies import logging_policy
from halfseen.study.tried import tried_in
from halfseen.tables.encoding import encoded_states
from halfseen.tables.features import table_features
from halfseen.tables.grasp.choice import choose_by
from halfseen.tables.policy import LinearTablePolicy
from halfseen.world import random
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutEpisodes, CutKind, cut, cut_rate
from halfseen.world.logs import elapsed_s
from halfseen.world.policy import GraspModel, Policy
from halfseen.world.random import Key
from halfseen.world.rollout import Episodes, Totals, evaluate_each, evaluate_some, play
from halfseen.world.state import Layout
from halfseen.world.table_world import NUM_PILOT_PATHS

PILOT, LOGS, EVALUATION, HELD_OUT, SELECTION = range(5)
"""What random keys are for; other experiments' worlds draw from `purpose` on."""
TREATMENTS = ("imputed", "weighted", "unweighted", "dropped", "failures")
CENSORING = {"imputed": "auto", "weighted": "kaplan-meier"}
"""Treatment → what the learner is told of cuts; nothing where it is not here."""

Grasp = GraspModel | Literal["auto"] | None
"""What tells the probability of a grasp: a model; None for the rule of succession; ``"auto"``, chosen by the log."""


@lru_cache(maxsize=64)
def random_key(seed: int, purpose: int, index: int = 0) -> Key:
    """Key of one purpose of a repetition."""
    return random.fold_in(random.fold_in(random.key_of(seed), purpose), index)


class Played(NamedTuple):
    """What a policy earned on single episodes."""

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
    """Where the paths of repetition `index` come from: a world, its tables, and the seed of the study."""

    world: WorldConfig
    layouts: Layout
    seed: int
    index: int = 0

    @classmethod
    def of(cls, setting: Setting, index: int = 0) -> "Source":
        """The tables and the world of all experiments."""
        return cls(setting.world, setting.layouts, setting.seed, index)

    def play(self, num_paths: int, purpose: int = LOGS) -> Episodes:
        """Paths of the logging policy that nothing cut."""
        key = random_key(self.seed, purpose, self.index)
        return play(self.world, self.layouts, logging_policy(self.world), key, num_paths)

    def cut(self, episodes: Episodes, rate: float, kind: CutKind) -> CutEpisodes:
        """Cut them, with the same draws for every rate and kind: a larger rate cuts the same paths earlier."""
        return cut(episodes, rate, kind, np.random.default_rng([self.seed, self.index, 1]))

    def cut_rate(self, share: float, kind: CutKind) -> float:
        """Rate that cuts this proportion of the paths in expectation, from a pilot."""
        return cut_rate(self.play(NUM_PILOT_PATHS, PILOT), share, kind)

    def logged(self, episodes: Episodes, grasp: Grasp = AUTO) -> "LoggedPaths":
        """Take episodes to learn from; `grasp` tells the probability of a grasp in the features, by default the log."""
        return LoggedPaths(self, episodes, grasp)

    def evaluate(self, policy: Policy, num_episodes: int, purpose: int = EVALUATION) -> Played:
        """Play a policy on the episodes of a purpose that all policies share."""
        return self.evaluate_some(policy, range(num_episodes), purpose)

    def evaluate_each(self, policies: Sequence[Policy], num_episodes: int) -> list[Played]:
        """Play each policy on the episodes that all share."""
        key = random_key(self.seed, EVALUATION, self.index)
        return [_played(each) for each in evaluate_each(self.world, self.layouts, policies, key, num_episodes)]

    def evaluate_some(self, policy: Policy, episodes: Sequence[int], purpose: int = EVALUATION) -> Played:
        """Play a policy on some of them, by number."""
        key = random_key(self.seed, purpose, self.index)
        return _played(evaluate_some(self.world, self.layouts, policy, key, np.array(episodes)))


def _played(totals: Totals) -> Played:
    return Played(*(np.asarray(of_episode, dtype=np.float64) for of_episode in (totals.reward, totals.robot_s)))


@dataclass(frozen=True)
class LoggedPaths:
    """Paths of a source that are learned from, however they are cut and treated."""

    source: Source
    episodes: Episodes
    grasp: Grasp = AUTO
    """What tells the probability of a grasp in the features; None for the rule of succession."""

    @cached_property
    def encoded(self) -> Encoded:
        """All paths as the learner sees them where no log has its own model of grasps."""
        action, is_taken = (np.asarray(leaf) for leaf in (self.episodes.action, self.episodes.is_taken))
        return encoded_states(
            self.episodes.states, action, is_taken, None if isinstance(self.grasp, str) else self.grasp
        )

    def lay_out(self, cuts: CutEpisodes, treatment: str) -> PathArrays:
        """A log as the learner sees it under a treatment."""
        return treated(_path_arrays(cuts, self.encoded), cuts, treatment, self.source.world)

    def learn(
        self, logs: Sequence[tuple[CutEpisodes, str]], sizes: Sequence[int]
    ) -> list[tuple[LinearTablePolicy, dict[str, float]]]:
        """Learn from the first paths of logs, each under its treatment; at each size from all.

        Returns each policy with the effective sample size and the largest of its weights.
        """
        treatments: dict[int, list[int]] = {}
        for number, (cuts, _) in enumerate(logs):
            treatments.setdefault(id(cuts), []).append(number)
        learned: dict[tuple[int, int], tuple[LinearTablePolicy, dict[str, float]]] = {}
        for numbers in treatments.values():
            cuts = logs[numbers[0]][0]
            tried = tried_in(cuts) if isinstance(self.grasp, str) else None
            laid_out = {number: self.lay_out(cuts, logs[number][1]) for number in numbers}
            for size in sizes:
                grasp, encoded = self._seen_by(cuts, tried, size)
                for number, paths in laid_out.items():
                    first = paths.take(slice(size))._replace(encoded=encoded)
                    learned[size, number] = self._learn_from(first, logs[number][1], grasp)
        return [learned[size, number] for size in sizes for number in range(len(logs))]

    def learn_one(self, cuts: CutEpisodes, num_paths: int) -> LinearTablePolicy:
        """Learn from the first paths of a log, weighted."""
        return self.learn([(cuts, "weighted")], [num_paths])[0][0]

    def learn_and_play(
        self, logs: Sequence[tuple[CutEpisodes, str]], sizes: Sequence[int], num_episodes: int
    ) -> list[tuple[dict[str, float], Played]]:
        """Learn from logs, at each size from all, and play on the same episodes: weights and what was earned."""
        learned = self.learn(logs, sizes)
        played = self.source.evaluate_each([policy for policy, _ in learned], num_episodes)
        return [(weights, each) for (_, weights), each in zip(learned, played, strict=True)]

    def _learn_from(
        self, paths: PathArrays, treatment: str, grasp: GraspModel | None
    ) -> tuple[LinearTablePolicy, dict[str, float]]:
        model = self.model(treatment, grasp).with_cuts(paths)
        rows = model.transitions(paths)
        return model.policy(model.fit(rows)), _weights(np.asarray(rows.weight))

    def _seen_by(
        self, cuts: CutEpisodes, tried: pd.DataFrame | None, num_paths: int
    ) -> tuple[GraspModel | None, Encoded]:
        """What the first paths of a log choose to tell the probability of a grasp, and what the learner sees by it.

        It is seen until the next one is asked for: the features of all lie in the same memory.
        """
        common = mapped(lambda leaf: leaf[:num_paths], self.encoded)
        if not isinstance(self.grasp, str):
            return self.grasp, common
        assert tried is not None
        num_attempts = int(tried["path"].searchsorted(num_paths))
        grasp = choose_by(tried.iloc[:num_attempts], self.source.world.horizon).grasp
        if grasp is None:
            return None, common
        at = np.nonzero(cuts.is_begun[:num_paths])
        there = mapped(lambda leaf: np.asarray(leaf)[at], self.episodes.states)
        features = self._room[:num_paths]
        features[at] = table_features(there, grasp)
        return grasp, common._replace(features=features)

    @cached_property
    def _room(self) -> Float[np.ndarray, "n T A F"]:
        return np.zeros_like(self.encoded.features)

    def model(self, treatment: str, grasp: GraspModel | None = None) -> QModel:
        """How the product's own learner fits Q under a treatment."""
        source = self.source
        return CensoredQLearner.for_table(
            source.world.horizon,
            laws=None,
            grasp=grasp,
            censoring=CENSORING.get(treatment, "none"),
            random_state=int(np.random.SeedSequence([source.seed, source.index]).generate_state(1)[0]),
        ).compose()


def treated(paths: PathArrays, cuts: CutEpisodes, treatment: str, world: WorldConfig) -> PathArrays:
    """What a learner sees of a log under one of `TREATMENTS`."""
    if treatment not in TREATMENTS:
        raise ArgumentError(f"treatment is {treatment!r}; it is one of {', '.join(TREATMENTS)}")
    clocks = paths.clocks
    if treatment == "dropped":
        kept = cuts.is_finished[:, None]
        elapsed = np.where(kept, clocks.elapsed_s, np.nan)
        return paths._replace(clocks=clocks._replace(is_begun=clocks.is_begun & kept, elapsed_s=elapsed))
    if treatment == "failures":
        is_cut_stage = cuts.is_begun & ~cuts.is_completed
        elapsed = np.where(is_cut_stage, cuts.end_s[:, None], clocks.elapsed_s)
        ended = clocks._replace(elapsed_s=elapsed, is_finished=np.ones_like(clocks.is_finished))
        return paths._replace(reward=np.where(is_cut_stage, _failure_reward(cuts, world), paths.reward), clocks=ended)
    return paths


def _failure_reward(cuts: CutEpisodes, world: WorldConfig) -> Float[np.ndarray, "n T"]:
    verb = np.asarray(ActionSpace(cuts.episodes.states.num_objects).verb(cuts.episodes.action))
    begun_s = np.nan_to_num(elapsed_s(cuts)).max(axis=1)
    lifted = world.reward_lift_per_s * (cuts.end_s - begun_s)
    attempt = np.select([verb == Verb.WASH, verb == Verb.LIFT], [world.reward_wash_failed, lifted[:, None]], 0.0)
    is_dirty = np.asarray(cuts.episodes.hidden.is_dirty)[:, None, :]
    dirty_left = np.sum(np.asarray(cuts.episodes.states.is_on_table) & is_dirty, axis=-1)
    return attempt + world.reward_dirty_left * dirty_left


def _path_arrays(cuts: CutEpisodes, encoded: Encoded) -> PathArrays:
    """A log as arrays: what reading back its `Logs` gives, without writing them."""
    clocks = StageClocks(
        path_ids=np.arange(len(cuts.end_s)),
        elapsed_s=elapsed_s(cuts),
        end_s=cuts.end_s,
        is_finished=cuts.is_finished,
        is_begun=cuts.is_begun,
        covariates=np.zeros((*cuts.is_begun.shape, 0)),
        covariate_names=(),
    )
    return PathArrays(
        clocks=clocks,
        encoded=encoded,
        has_action=cuts.is_begun,
        probability=np.asarray(cuts.episodes.probability, dtype=np.float64),
        reward=np.where(cuts.is_completed, np.asarray(cuts.episodes.reward, dtype=np.float64), 0.0),
    )


def _weights(weight: Float[np.ndarray, "n T"]) -> dict[str, float]:
    found = weight_diagnostics(weight)
    return {"effective_sample_size": found.effective_sample_size, "largest_weight": found.largest_weight}


def episodes_in_turn(index: int, num_episodes: int, num_all: int) -> list[int]:
    """Which of a repetition's episodes a slow policy plays: each repetition goes on with the next.

    Episode i is of table i modulo their number: so all tables are met alike.
    """
    num_played = min(num_episodes, num_all)
    first = index * num_played if num_played < num_all else 0
    return sorted((first + k) % num_all for k in range(num_played))
