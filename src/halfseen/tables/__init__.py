"""The task of tables: where the learners meet the world.

Read down: `features` and `team_features` (what Q looks at) → `grasp` (how likely a grasp is to succeed, learned from
attempts) → `encoding` (logs → features, and what cuts may depend on) → `prior` → `rewards` (less noise in the targets)
→ `policy` (what was learned, and what policies would have done) → `task` (all of it behind one seam, for any number of
robots) → `explain` (why, and how sure it may be) → `present` (what is seen now, and what was logged of the trajectory
so far → the state to decide in). Of several robots: `agent_logs`, `independent` (each for itself).

Beside them, `laws`: a world whose laws were fitted to the same log, for planners that know no law; and `assisted`, the
learner that starts from what these laws imply: `features` and `synthetic` (the look one step ahead, and what it
misses), `mending` (log-odds made anew), `policy`, `law_test` (does the log contradict the laws), `choice` (by which
policy, if it does), `learner`.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.tables.agent_logs import agent_view
    from halfseen.tables.assisted.learner import TableLearner
    from halfseen.tables.assisted.policy import AssistedPolicy, RulePolicy
    from halfseen.tables.explain import LearnedExplainer
    from halfseen.tables.grasp.attempts import attempts
    from halfseen.tables.grasp.beta_grasp import BetaGrasp
    from halfseen.tables.grasp.svm_grasp import SVMGrasp
    from halfseen.tables.independent import IndependentPolicies
    from halfseen.tables.laws import fit_world
    from halfseen.tables.policy import LinearTablePolicy, LinearTeamPolicy
    from halfseen.tables.task import TableTask, TeamTask

__all__ = [
    "AssistedPolicy",
    "BetaGrasp",
    "IndependentPolicies",
    "LearnedExplainer",
    "LinearTablePolicy",
    "LinearTeamPolicy",
    "RulePolicy",
    "SVMGrasp",
    "TableLearner",
    "TableTask",
    "TeamTask",
    "agent_view",
    "attempts",
    "fit_world",
]

__getattr__ = lazy_names(
    __name__,
    {
        "AssistedPolicy": "assisted.policy",
        "BetaGrasp": "grasp.beta_grasp",
        "IndependentPolicies": "independent",
        "LearnedExplainer": "explain",
        "LinearTablePolicy": "policy",
        "LinearTeamPolicy": "policy",
        "RulePolicy": "assisted.policy",
        "SVMGrasp": "grasp.svm_grasp",
        "TableLearner": "assisted.learner",
        "TableTask": "task",
        "TeamTask": "task",
        "agent_view": "agent_logs",
        "attempts": "grasp.attempts",
        "fit_world": "laws",
    },
)
