"""Censored Q-learning (paper, eq. 3): from weighted logs to policies. It runs on arrays and knows no world.

Read down: `least_squares` (one weighted regression) → `recursion` (eq. 3, backwards) → `judging` (what Q says of a log)
→ `kernel_map` (Q in an RKHS) → `task` (the seam: logs → arrays, Q → policy), `path_arrays` (logs → arrays), `behaviour`
(what the log does of itself), `named_actions`, `flat_policy` (the task of named actions and its policy) → `imputation`,
`targets` (what stands for what cuts took) → `q_space` (𝒬 and λ) → `fitting` (one log or a batch) → `q_model` (all of it
composed) → `streaming` (logs larger than memory), `q_learner` (the estimator) → `bootstrap` (how sure it may be).
"""
