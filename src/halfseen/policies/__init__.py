"""Stored policies, their decisions, and what they would do in the states of a log.

Read down: `folder` (policies on disk) → `decision` (the interface: question, answer, and how sure Q is) → `ranges`
(what lies outside the logs) → `named_decider`, `table_decider` (policies behind the interface, and their reasons) →
`history`, `table_observation` (from a point cloud to an observation; loaded for tables only) → `observations` (from
policies and files to deciders and observations) → `shares` (what a policy does in the states of a log) →
`learner_choice` (the learner that suits a log). `rule_table` and `rule_files` hold rules of thumb, as policies of named
actions and as fallbacks of a policy; `exploration` draws other actions than the best.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.policies.decision import Decider, Decision
    from halfseen.policies.folder import StoredPolicy, read_policy, write_policy
    from halfseen.policies.named_decider import NamedDecider, NamedObservation
    from halfseen.policies.observations import decider_of
    from halfseen.policies.rule_files import read_rule_table
    from halfseen.policies.rule_table import Rule, RuleTable
    from halfseen.policies.table_decider import TableDecider

__all__ = [
    "Decider",
    "Decision",
    "NamedDecider",
    "NamedObservation",
    "Rule",
    "RuleTable",
    "StoredPolicy",
    "TableDecider",
    "decider_of",
    "read_policy",
    "read_rule_table",
    "write_policy",
]

_NAMES = {
    "decision": "Decider Decision",
    "folder": "StoredPolicy read_policy write_policy",
    "named_decider": "NamedDecider NamedObservation",
    "observations": "decider_of",
    "rule_files": "read_rule_table",
    "rule_table": "Rule RuleTable",
    "table_decider": "TableDecider",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
