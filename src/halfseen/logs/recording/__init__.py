"""While a robot runs: paths are recorded as they happen, from Python or by lines of JSON.

Read down: `log_so_far` (the path in progress, as a log) → `path_recorder` (one path) → `recorder` (a folder of them) →
`line_protocol` (without Python) → `line_socket` (from another process).
"""
