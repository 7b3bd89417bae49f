"""The task of tables: where the learners meet the world, for any number of robots.

Read down: `features` (what Q looks at) → `grasp_attempts`, `grasp_models`, `grasp_table`, `grasp_choice` (how likely a
grasp is to succeed, learned from attempts) → `encoding` (logs → features, and what cuts may depend on) → `rewards`
(less noise in the targets) → `policy` (what was learned, and what policies would have done) → `task` (all of it behind
one seam) → `explain` (why) → `present` (what is seen now, and what was logged of the trajectory so far → the state to
decide in), `first_look` (labels → how likely each object is dirty). Of several robots: `agent_logs`, what each made by
itself.

Beside them, a world whose laws were fitted to the same log, for planners that know no law: `evidence` →
`law_grasping`, `law_seeing` and `recorder` → `laws`; and the learners that start from what these laws imply:
`look_ahead` (the look one step ahead) → `excess` (what it misses) → `assisted` (the policies) → `law_test` (does the
log contradict the laws) → `learner`.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.tables.agent_logs import agent_view
    from halfseen.tables.assisted import AssistedPolicy, RulePolicy
    from halfseen.tables.grasp_attempts import attempts
    from halfseen.tables.grasp_models import BetaGrasp, SVMGrasp
    from halfseen.tables.laws import fit_world
    from halfseen.tables.learner import TableLearner, TeamLearner
    from halfseen.tables.policy import IndependentPolicies, LinearTablePolicy, LinearTeamPolicy
    from halfseen.tables.task import TableTask, TeamTask

__all__ = [
    "AssistedPolicy",
    "BetaGrasp",
    "IndependentPolicies",
    "LinearTablePolicy",
    "LinearTeamPolicy",
    "RulePolicy",
    "SVMGrasp",
    "TableLearner",
    "TableTask",
    "TeamLearner",
    "TeamTask",
    "agent_view",
    "attempts",
    "fit_world",
]
__getattr__ = lazy_names(
    __name__,
    {
        "AssistedPolicy": "assisted",
        "BetaGrasp": "grasp_models",
        "IndependentPolicies": "policy",
        "LinearTablePolicy": "policy",
        "LinearTeamPolicy": "policy",
        "RulePolicy": "assisted",
        "SVMGrasp": "grasp_models",
        "TableLearner": "learner",
        "TableTask": "task",
        "TeamLearner": "learner",
        "TeamTask": "task",
        "agent_view": "agent_logs",
        "attempts": "grasp_attempts",
        "fit_world": "laws",
    },
)
