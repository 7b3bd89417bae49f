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
    "pomdp-5": "POMDP, 5 steps ahead",
    "pomdp-6": "POMDP, 6 steps ahead",
    "planner-100ms": "strongest planner within 100 ms",
    "planner-1s": "strongest planner within 1 s",
}
"""Name in the tables → name for people."""

BUDGETS_MS = {"planner-100ms": 100.0, "planner-1s": 1000.0}
"""Baseline that stands for the strongest planner → time that its decision may take [ms]."""

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
        heuristics and the strongest planners, whose num_paths and cut_share are null.
    figure2
        policy, kind, simulations, decision_ms, mean_reward, se, low, high, over_cql, se_over, over_low, over_high,
        repetitions, episodes: see `halfseen.study.planning_table.figure2`.
    figure3
        planning_horizon, simulations, decision_ms, mean_reward, se, low, high, and differences from shorter horizons:
        see `halfseen.study.planning_table.figure3`.
    learning_s
        Time that learning the headline policy took, once [s].
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
    map
        num_objects, occlusion, label_gain, reward_wash_clean, grip_offset_std, num_paths, cut_share, repetitions, cql,
        best_heuristic, heuristic_reward, finish_reward, gain, gain_se, gain_share, gain_share_low, gain_share_high,
        verdict: see `halfseen.study.map_table.map_table`.
    regret
        policy, num_paths, cut_share, regret, se, regret_share, optimum, repetitions. se is over repetitions (of learned
        policies: logs; of planners: the states in which they were asked, and their own draws); heuristics and the
        optimum are exact, their se 0 and repetitions null; how tables differ is in no se.
    strongest_planners
        Baseline of `BUDGETS_MS` → the planner of `figure2` that it stands for.
    best_planner
        The baseline that stands for the strongest planner of all.
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
    figure2: pd.DataFrame
    figure3: pd.DataFrame
    learning_s: float
    figure4: pd.DataFrame
    table1: pd.DataFrame
    weights: pd.DataFrame
    grasp: pd.DataFrame
    grasp_tests: pd.DataFrame
    figure5: pd.DataFrame
    map: pd.DataFrame
    regret: pd.DataFrame
    strongest_planners: dict[str, str]
    best_planner: str
    best_heuristic: str
    sentences: tuple[str, ...] = ()
    versions: dict[str, str] = field(default_factory=dict)
