"""What the study found, as tables; figures and report are drawn from this alone."""

from dataclasses import dataclass, field

import pandas as pd

from halfseen.study.design import StudyDesign
from halfseen.world.scene import Scene

BASELINE_NAMES = {
    "greedy": "greedy",
    "history": "greedy with history",
    "greedy-penalty": "greedy, counting the penalty",
    "history-penalty": "history, counting the penalty",
    "pomdp-1": "POMDP, 1 step ahead",
    "pomdp-2": "POMDP, 2 steps ahead",
    "pomdp-3": "POMDP, 3 steps ahead",
    "pomdp-4": "POMDP, 4 steps ahead",
}
"""Name in the tables → name for people."""

TREATMENT_NAMES = {
    "weighted": "weighted by 1/Ĝ",
    "unweighted": "completed stages, no weights",
    "dropped": "cut paths dropped",
    "failures": "cuts counted as failures",
}

MEASURES = {
    "reward": "reward of a path",
    "decision_ms": "time of one decision [ms]",
    "robot_s": "robot time until a path ends [s]",
}

GRASP_NAMES = {
    "laplace": "Laplace's rule",
    "beta": "Beta mean",
    "beta-dropped": "Beta mean, cut attempts dropped",
    "svm": "SVM",
    "oracle": "true model",
}
"""Model of the chance of a grasp → name for people."""

GRASP_MEASURES = {
    "log_loss": "log-loss on held-out attempts",
    "brier": "Brier score on held-out attempts",
    "learned_reward": "reward of the learned policy",
    "heuristic_reward": "reward of the heuristic",
}
"""What grasp models are judged by; the scores are better the smaller they are, the rewards the larger."""


@dataclass(frozen=True)
class StudyResults:
    """Tables of the study.

    Parameters
    ----------
    design
        What was done.
    scenes
        The tables, as perception saw them.
    figure1
        policy, num_paths, cut_share, repetitions, mean_reward, se. Policies are ``cql`` (weighted), the other
        treatments ``cql-unweighted``, ``cql-dropped``, ``cql-failures`` (independent cuts, at one cut share), and the
        baselines, whose num_paths and cut_share are null.
    figure4
        treatment, cut_kind, num_paths, cut_share, repetitions, mean_reward, se, behind_weighted, se_behind: the last
        two are the paired mean difference (weighted − this treatment) and its standard error.
    table1
        baseline, measure, cql, other, p_value, p_holm, effect, supported, effect_low, effect_high: one-sided paired
        tests that the learned policy is better (more reward, less time); the effect is the mean paired difference
        cql − other with its 95 % interval.
    grasp
        model, num_paths, cut_share, repetitions; and of each measure in `GRASP_MEASURES` its mean, standard error
        (``…_se``), paired mean difference from the true model (``…_over_oracle``) and the error of that.
    grasp_tests
        measure, num_paths, svm, beta, p_value, p_holm, effect, supported, effect_low, effect_high: as in `table1`, for
        the claim that the SVM is better than the Beta mean; the effect is svm − beta.
    figure5
        model, num_paths, bin_from, attempts, mean_chance, share_succeeded, se: calibration; se is of the difference of
        the two before it.
    best_planner
        The baseline ``pomdp-h`` with the largest mean reward.
    best_heuristic
        The strongest of the four heuristics.
    weights
        num_paths, cut_share, effective_sample_size, largest_weight: means over repetitions.
    sentences
        The answer in three sentences.
    versions
        Of the packages that matter.
    """

    design: StudyDesign
    scenes: tuple[Scene, ...]
    figure1: pd.DataFrame
    figure4: pd.DataFrame
    table1: pd.DataFrame
    weights: pd.DataFrame
    grasp: pd.DataFrame
    grasp_tests: pd.DataFrame
    figure5: pd.DataFrame
    best_planner: str
    best_heuristic: str
    sentences: tuple[str, ...] = ()
    versions: dict[str, str] = field(default_factory=dict)
