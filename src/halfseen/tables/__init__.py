"""The table task: learning from logs of tables, for one robot or several.

In reading order: `features` (inputs of Q) → `grasp_attempts`, `grasp_models`, `grasp_table`, `grasp_choice` (the
probability of a grasp, learned from attempts) → `encoding` (logs → features, and covariates of cuts) → `rewards`
(targets with less noise) → `policy` (learned policies, and action probabilities of any policy) → `task` (all of these
behind one interface) → `explain` (the reason for an action) → `present` (the current view and the trajectory so far →
the state to decide in), `first_look` (labels → P(DIRTY) of each object). `agent_logs` extracts the log of one robot
from that of a team.

A second group fits the laws of a world to the same log, for planners that are given none: `evidence` →
`law_grasping`, `law_seeing` and `recorder` → `laws`. The model-assisted learners build on these laws: `look_ahead` (the
one-step look-ahead) → `excess` (its error) → `assisted` (the policies) → `law_test` (does the log contradict the
laws?) → `learner`.
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
