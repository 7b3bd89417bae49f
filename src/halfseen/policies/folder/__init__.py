"""Policies on disk: numbers and text, so that loading one runs no code.

::

    FOLDER/
      policy.json          what the policy looks at, what it was learned from and how, what its weights are worth
      policy.safetensors   its numbers
      policy.sha256        digests of both (``sha256sum -c policy.sha256`` checks them, too)

Read down: `files` (there whole or not at all, no byte changed) → `json_values`, `arrays` (numbers and text, checked) →
`log_digest`, `seen` (what the log was) → `specification` (how it was learned) → `named_kind`, `table_kind`, `kinds`
(what differs between kinds of policies) → `record` (policy.json) → `stored` (write and read).
"""

from halfseen.policies.folder.files import check_target
from halfseen.policies.folder.log_digest import log_digest
from halfseen.policies.folder.specification import q_space_of_record, reg_of_record, targets_of_record
from halfseen.policies.folder.stored import StoredPolicy, read_policy, write_policy

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
