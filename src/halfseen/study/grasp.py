"""What a grasp estimate is worth: one repetition of the ablation (paper, §3: the mean of a Beta against the SVM).

From the log of a repetition, cut as in Table 1, each model learns the chance of a grasp. It is scored on the attempts
of fresh paths that nothing cut, and serves in the features of the learned policy and in the best heuristic.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from halfseen.learners.q_learning.encoding import Encoded, encode_states
from halfseen.logs.frames import FrameLike, as_frame
from halfseen.planners.heuristics import TrueGrasp
from halfseen.study.design import StudyDesign
from halfseen.study.learning import learn
from halfseen.study.policies import heuristics, logging_policy
from halfseen.study.repetition import (
    EVALUATION,
    HELD_OUT,
    LOGS,
    CutRates,
    cut_log,
    evaluate_batch,
    first_paths,
    folds,
    means,
    random_key,
)
from halfseen.study.treatments import treat
from halfseen.tables.grasp.attempts import attempts
from halfseen.tables.grasp.beta_grasp import BetaGrasp
from halfseen.tables.grasp.grasp_table import GraspEstimator, tabulate
from halfseen.tables.grasp.svm_grasp import SVMGrasp
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.cuts import CutEpisodes, CutKind, cut
from halfseen.world.episodes import Totals, evaluate, play
from halfseen.world.grasp_model import GraspModel
from halfseen.world.policy import Policy
from halfseen.world.recording import to_logs
from halfseen.world.scene import Scene
from halfseen.world.state import Layout, TableState

LAPLACE, ORACLE = "laplace", "oracle"
HEURISTIC = "history-penalty"
"""The rule of thumb that grasp models serve in; with the true model it is that baseline."""
GRASP_MODELS = (LAPLACE, "beta", "beta-dropped", "svm", ORACLE)
CUT_KIND: CutKind = "independent"
MOST_HELD_OUT = 400
"""Fresh paths of each repetition, some six attempts each, on which all models are scored; no more than were learned
from."""
NUM_BINS = 10
"""Of predicted chances, evenly over [0, 1]."""


class LaplaceGrasp:
    """Laplace's rule, (1 + successes) / (2 + attempts), whatever is hidden."""

    def fit(self, frame: FrameLike) -> "LaplaceGrasp":
        """There is nothing to learn."""
        return self

    def predict_proba(self, frame: FrameLike) -> Float[np.ndarray, "m 2"]:
        """Chance that an attempt fails, and that it succeeds."""
        counts = as_frame("attempts", frame)[["successes", "failures"]].to_numpy(dtype=np.float64)
        chance = (1.0 + counts[:, 0]) / (2.0 + counts.sum(axis=1))
        return np.column_stack([1.0 - chance, chance])


class HeldOut(NamedTuple):
    """Attempts of fresh paths that nothing cut."""

    table: pd.DataFrame
    """As `halfseen.learners.attempts` gives them."""
    oracle: Float[np.ndarray, " m"]
    """The chance of each under the true model, given the object's whole history."""


def run_grasp_repetition(
    design: StudyDesign,
    scenes: Sequence[Scene],
    layouts: Layout,
    rates: CutRates,
    repetition: int,
) -> dict[str, Any]:
    """Learn, score and play; return plain numbers, one row for each model and size of log."""
    longest = max(design.grasp_num_paths)
    episodes = play(design.world, layouts, logging_policy(design), random_key(design, LOGS, repetition), longest)
    log = cut_log(design, episodes, rates[CUT_KIND, design.table_cut_share], CUT_KIND, repetition)
    tried = attempts(to_logs(log, CUT_KIND, scenes), design.world.horizon)
    held_out = _held_out(design, scenes, layouts, repetition)
    rows: list[dict[str, Any]] = []
    learners: list[LinearTablePolicy] = []
    rules: list[Policy] = []
    knowing = heuristics(design)[HEURISTIC]
    for num_paths in design.grasp_num_paths:
        estimators = _fitted(pd.DataFrame(tried[tried["path"] < num_paths]))
        for name in GRASP_MODELS:
            chance = held_out.oracle if name == ORACLE else estimators[name].predict_proba(held_out.table)[:, 1]
            scores = scored(chance, held_out.table["succeeded"].to_numpy(dtype=bool))
            rows.append({"model": name, "num_paths": num_paths} | scores)
            grasp = _inside(design, estimators, name)
            features_grasp = None if name == LAPLACE else grasp
            learners.append(_learned(design, log, num_paths, features_grasp, repetition))
            rules.append(knowing if name == ORACLE else replace(knowing, grasp=grasp))
    for word, policies in (("learned", learners), ("heuristic", rules)):
        for row, totals in zip(rows, _played(design, layouts, policies, repetition), strict=True):
            row[f"{word}_reward"] = means(totals)["reward"]
    return {"repetition": repetition, "grasp": rows}


def scored(chance: Float[np.ndarray, " m"], succeeded: np.ndarray) -> dict[str, Any]:
    """Log-loss, Brier score, and by bin of predicted chances: attempts, sum of chances, successes."""
    where = np.minimum((chance * NUM_BINS).astype(int), NUM_BINS - 1)
    return {
        "log_loss": float(-np.mean(np.log(np.where(succeeded, chance, 1.0 - chance)))),
        "brier": float(np.mean(np.square(chance - succeeded))),
        "bins": {
            "attempts": np.bincount(where, minlength=NUM_BINS).tolist(),
            "chances": np.bincount(where, chance, NUM_BINS).tolist(),
            "successes": np.bincount(where, succeeded, NUM_BINS).tolist(),
        },
    }


def _fitted(tried: pd.DataFrame) -> dict[str, GraspEstimator]:
    # Threads gain nothing on matrices this small, wait for one another on a busy machine (a fit was seen to take 21 s
    # in place of 0.2), and add up in an order that depends on their number.
    with threadpool_limits(1):
        return {
            LAPLACE: LaplaceGrasp(),
            "beta": BetaGrasp().fit(tried),
            "beta-dropped": BetaGrasp(censoring="none").fit(tried),
            "svm": SVMGrasp().fit(tried),
        }


def _inside(design: StudyDesign, estimators: Mapping[str, GraspEstimator], name: str) -> GraspModel:
    """The model as it runs inside a policy."""
    return TrueGrasp(design.world) if name == ORACLE else tabulate(estimators[name], design.world.horizon)


def _held_out(design: StudyDesign, scenes: Sequence[Scene], layouts: Layout, repetition: int) -> HeldOut:
    key = random_key(design, HELD_OUT, repetition)
    # Played at the size of the log, for which the call is compiled already.
    played = play(design.world, layouts, logging_policy(design), key, max(design.grasp_num_paths))
    episodes = jax.tree.map(lambda leaf: leaf[:MOST_HELD_OUT], played)
    uncut = cut(episodes, 0.0, CUT_KIND, np.random.default_rng(0))
    table = attempts(to_logs(uncut, CUT_KIND, scenes), design.world.horizon)
    at = table["path"].to_numpy(), table["stage"].to_numpy() - 1
    target = (np.asarray(episodes.action)[at] - 1) % episodes.states.num_objects
    chances = np.asarray(_true_chances(TrueGrasp(design.world), episodes.states), dtype=np.float64)
    return HeldOut(table, chances[*at, target])


@jax.jit
def _true_chances(grasp: TrueGrasp, states: TableState) -> jax.Array:
    return jax.vmap(jax.vmap(grasp.chance))(states)


def _learned(
    design: StudyDesign, log: CutEpisodes, num_paths: int, grasp: GraspModel | None, repetition: int
) -> LinearTablePolicy:
    """The policy that censored Q-learning makes of the first paths of the log with these features."""
    # All paths at once, so that one compiled call serves all sizes.
    features, is_possible = encode_states(log.episodes.states, grasp)
    encoded = Encoded(*(np.asarray(leaf)[:num_paths] for leaf in (features, is_possible, log.episodes.action)))
    treated = treat(first_paths(log, num_paths), "weighted", design.world)
    fold = folds(design, repetition, max(*design.num_paths, *design.grasp_num_paths))
    policies = learn(encoded, [treated], fold[:num_paths])
    return LinearTablePolicy(policies.coefficients[0], grasp)


def _played(design: StudyDesign, layouts: Layout, policies: Sequence[Policy], repetition: int) -> list[Totals]:
    """What each policy earns on the repetition's evaluation episodes; policies of a kind play together."""
    key = random_key(design, EVALUATION, repetition)
    num_episodes = design.episodes_per_scene * layouts.is_object.shape[0]
    totals: dict[int, Totals] = {}
    kinds = [jax.tree.structure(policy) for policy in policies]
    for kind in dict.fromkeys(kinds):
        members = [k for k, other in enumerate(kinds) if other == kind]
        if all(policies[k] is policies[members[0]] for k in members):
            once: Totals = evaluate(design.world, layouts, policies[members[0]], key, num_episodes)
            for k in members:
                totals[k] = once
            continue
        batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(policies[k] for k in members))
        played = evaluate_batch(design.world, layouts, batch, key, num_episodes)
        totals |= {k: jax.tree.map(lambda leaf, j=j: leaf[j], played) for j, k in enumerate(members)}
    return [totals[k] for k in range(len(policies))]
