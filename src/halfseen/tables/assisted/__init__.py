"""Model-assisted censored Q-learning of tables: Q starts from what laws imply that were fitted to the same log.

Read down: `features` (the look one step ahead, and what describes it) → `synthetic` (E, what the look misses, by eq. 3
on simulated trajectories) → `mending` (log-odds of a wrong recorder, made anew) → `policy` → `law_test` (does the log
contradict the laws?) → `choice` (by which policy, if it does) → `learner`.
"""
