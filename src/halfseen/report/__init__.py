"""One page about a log and a policy: what it is worth, and what nobody can know from that log.

Read it down: `log_findings` (what the log holds) → `policy_findings` (what was learned, and what it would do) →
`findings` (both, and the value) → `sentences`, `figures` (the same, to be read) → `page`.
"""
