"""Policies on disk, as numbers and text: loading one runs no code.

::

    FOLDER/
      policy.json          what the policy looks at, its log and how it was learned, its importance weights
            policy.safetensors   its numbers
            policy.sha256        digests of both (``sha256sum -c policy.sha256`` checks them, too)

Read down: `files` (atomic, checked folders) → `record` (the schema of policy.json) → `kinds`, `table_kinds`,
`law_kinds` (what differs between kinds of policies, and their arrays) → `stored` (reading) → `specification` (how it
was learned), `log_facts`, `promised_parts` (facts about the log), `writing`.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.policies.folder.files import check_target
    from halfseen.policies.folder.log_facts import log_digest
    from halfseen.policies.folder.specification import q_space_of_record, reg_of_record, targets_of_record
    from halfseen.policies.folder.stored import StoredPolicy, read_policy
    from halfseen.policies.folder.writing import write_policy

__all__ = [
    "StoredPolicy",
    "check_target",
    "log_digest",
    "q_space_of_record",
    "read_policy",
    "reg_of_record",
    "targets_of_record",
    "write_policy",
]

_NAMES = {
    "files": "check_target",
    "log_facts": "log_digest",
    "specification": "q_space_of_record reg_of_record targets_of_record",
    "stored": "StoredPolicy read_policy",
    "writing": "write_policy",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
