"""While a robot runs: trajectories are recorded as they happen, from Python or by lines of JSON.

Read down: `log_so_far` (the trajectory in progress, as a log) → `trajectory_recorder` (one trajectory) → `recorder` (a
folder of them) → `line_protocol` (without Python) → `line_socket` (from another process).
"""
