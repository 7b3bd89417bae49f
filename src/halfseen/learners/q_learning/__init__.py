"""Censored Q-learning (paper, eq. 3): from weighted logs to policies.

Read down: `least_squares` (one weighted regression) → `recursion` (eq. 3, backwards) → `table_features` (what Q looks
at on a table) → `encoding` (logs → features) → `cut_covariates`, `path_arrays` (logs → arrays) → `cut_model` (Ĝ, by
path or by stage) → `imputation` (targets for stages that were cut) → `variance_reduction` (less noise in the targets)
→ `kernel_map` (Q in an RKHS) → `flat_policy`, `linear_policy` (what was learned) → `checks`, `q_learner` (the
estimator) → `bootstrap`, `explanation` (how sure it may be).
"""
