"""One repetition: fresh logs, cut in every way; policies learned from them; all policies on the same fresh episodes."""

from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from halfseen.censoring import weight_diagnostics
from halfseen.learners.q_learning.encoding import Encoded, encode_states
from halfseen.study.design import TREATMENTS, StudyDesign
from halfseen.study.learning import NUM_FOLDS, learn
from halfseen.study.policies import heuristics, logging_policy
from halfseen.study.treatments import Treated, treat
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutEpisodes, CutKind, cut, cut_rate
from halfseen.world.episodes import Episodes, Totals, evaluate, play
from halfseen.world.policy import Policy
from halfseen.world.state import Layout
from halfseen.world.table_world import NUM_PILOT_PATHS

PILOT, LOGS, EVALUATION, HELD_OUT = range(4)
"""What random keys are for."""

CutRates: TypeAlias = dict[tuple[CutKind, float], float]
"""Rate of cuts for each kind and share."""


@dataclass(frozen=True)
class Arm:
    """One way to come by a learned policy."""

    treatment: str
    cut_kind: CutKind
    cut_share: float


def arms(design: StudyDesign) -> list[Arm]:
    """All ways that the study compares: weighted at every share, and each treatment where Figure 4 wants it."""
    shares = [Arm("weighted", "independent", share) for share in design.cut_shares]
    treated = [
        Arm(treatment, kind, design.treatment_cut_share)
        for kind in design.treatment_cut_kinds
        for treatment in TREATMENTS
    ]
    return list(dict.fromkeys(shares + treated))


def cut_rates(design: StudyDesign, layouts: Layout) -> CutRates:
    """Rate of cuts for each kind and share that the study needs, from one pilot."""
    pilot = play(design.world, layouts, logging_policy(design), random_key(design, PILOT), NUM_PILOT_PATHS)
    return {(arm.cut_kind, arm.cut_share): cut_rate(pilot, arm.cut_share, arm.cut_kind) for arm in arms(design)}


def run_repetition(design: StudyDesign, layouts: Layout, rates: CutRates, repetition: int) -> dict[str, Any]:
    """Learn and evaluate; return plain numbers, means over the repetition's block of episodes."""
    key = random_key(design, EVALUATION, repetition)
    num_episodes = design.episodes_per_scene * layouts.is_object.shape[0]
    played = evaluate_each(design, layouts, key, num_episodes)
    return {
        "repetition": repetition,
        "baselines": {name: means(totals) for name, totals in played.items()},
        "learned": _learned(design, layouts, rates, repetition, key, num_episodes),
    }


def evaluate_each(design: StudyDesign, layouts: Layout, key: jax.Array, num_episodes: int) -> dict[str, Totals]:
    """Play every heuristic on the same episodes."""
    policies = heuristics(design)
    return {name: evaluate(design.world, layouts, policy, key, num_episodes) for name, policy in policies.items()}


def _learned(
    design: StudyDesign,
    layouts: Layout,
    rates: CutRates,
    repetition: int,
    key: jax.Array,
    num_episodes: int,
) -> list[dict[str, Any]]:
    longest = max(design.num_paths)
    episodes = play(design.world, layouts, logging_policy(design), random_key(design, LOGS, repetition), longest)
    features, is_possible = encode_states(episodes.states)
    encoded = Encoded(np.asarray(features), np.asarray(is_possible), np.asarray(episodes.action))
    fold = folds(design, repetition, longest)
    logs = {(kind, share): cut_log(design, episodes, rate, kind, repetition) for (kind, share), rate in rates.items()}
    rows: list[dict[str, Any]] = []
    policies: list[LinearTablePolicy] = []
    for num_paths in design.num_paths:
        first = {which: first_paths(log, num_paths) for which, log in logs.items()}
        treated = [treat(first[arm.cut_kind, arm.cut_share], arm.treatment, design.world) for arm in arms(design)]
        policies.append(learn(Encoded(*(leaf[:num_paths] for leaf in encoded)), treated, fold[:num_paths]))
        rows += [_described(arm, num_paths, one) for arm, one in zip(arms(design), treated, strict=True)]
    together = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *policies)
    totals = evaluate_batch(design.world, layouts, together, key, num_episodes)
    earned = [means(jax.tree.map(lambda leaf, k=k: leaf[k], totals)) for k in range(len(rows))]
    return [row | mean for row, mean in zip(rows, earned, strict=True)]


def _described(arm: Arm, num_paths: int, treated: Treated) -> dict[str, Any]:
    diagnostics = weight_diagnostics(treated.weight)
    return asdict(arm) | {
        "num_paths": num_paths,
        "effective_sample_size": diagnostics.effective_sample_size,
        "largest_weight": diagnostics.largest_weight,
    }


def folds(design: StudyDesign, repetition: int, num_paths: int) -> Int[np.ndarray, " n"]:
    """Fold of each path of a repetition's log."""
    return np.random.default_rng([design.seed, repetition]).permutation(num_paths) % NUM_FOLDS


@partial(jax.jit, static_argnames="num_episodes")
def evaluate_batch(config: WorldConfig, layouts: Layout, policies: Policy, key: jax.Array, num_episodes: int) -> Totals:
    """Play a batch of policies of one kind on the same episodes."""
    return jax.vmap(lambda policy: evaluate(config, layouts, policy, key, num_episodes))(policies)


def cut_log(design: StudyDesign, episodes: Episodes, rate: float, kind: CutKind, repetition: int) -> CutEpisodes:
    """Cut the episodes of a repetition."""
    # The same draws for every share and kind: a path that is cut at a small share is cut earlier at a large one.
    return cut(episodes, rate, kind, np.random.default_rng([design.seed, repetition, 1]))


def first_paths(cuts: CutEpisodes, num_paths: int) -> CutEpisodes:
    """Keep the first paths of a log."""
    return CutEpisodes(
        jax.tree.map(lambda leaf: leaf[:num_paths], cuts.episodes),
        cuts.end_s[:num_paths],
        cuts.is_finished[:num_paths],
        cuts.is_completed[:num_paths],
        cuts.is_begun[:num_paths],
    )


def means(totals: Totals) -> dict[str, float]:
    """Mean reward and robot time of a block of episodes."""
    return {
        "reward": float(np.mean(np.asarray(totals.reward, dtype=np.float64))),
        "robot_s": float(np.mean(np.asarray(totals.robot_s, dtype=np.float64))),
    }


def random_key(design: StudyDesign, purpose: int, repetition: int = 0) -> jax.Array:
    """Key of one purpose of a repetition."""
    return jax.random.fold_in(jax.random.fold_in(jax.random.key(design.seed), purpose), repetition)
