"""Censored Q-learning (paper, eq. 3): from weighted logs to policies.

Read down: `least_squares` (one weighted regression) → `recursion` (eq. 3, backwards) → `table_features` (what Q looks
at on a table) → `encoding` (logs → arrays) → `variance_reduction` (less noise in the targets) → `path_covariates` (what
cuts may depend on) → `linear_policy` (what was learned) → `q_learner` (the estimator) → `explanation` (how sure a
learned policy may be).
"""
