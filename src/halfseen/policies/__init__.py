"""Policies at work: kept in folders, asked for decisions, and what they do.

Read down: `folder` (policies on disk) → `shares` (what a policy does in the states of a log) → `reasons` (why).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.policies.folder import StoredPolicy, read_policy, write_policy

__all__ = ["StoredPolicy", "read_policy", "write_policy"]

__getattr__ = lazy_names(__name__, {"StoredPolicy": "folder", "read_policy": "folder", "write_policy": "folder"})
