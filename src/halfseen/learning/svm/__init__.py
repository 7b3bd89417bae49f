"""The censored SVM (paper, eqs. 1 and 2): min over f of λ‖f‖² + (1/n) Σ_i w_i L(Y(T_i), f(Z_i)).

The times T_i may be right-censored; w_i are the inverse-probability-of-censoring weights.

Read down, in the order of the work. What is minimised: `targets` (Y, from times that may be cut) → `weighting` (w) →
`losses`, `user_loss` (L) → `vector_kernels`, `set_kernel`, `kernels` (‖f‖), `nystrom` and `memory` (when there are many
rows) → `designs` (rows as the solver sees them). How: `edited_factor` (linear systems near one another) → `spaces` (f
by a Gram matrix or by features) → `newton` (smooth losses) → `interior_point` (losses with kinks, where most rows lie
on one) → `solver` (all losses, and the duality gap). The estimators: `folds`, `cross_validation` (λ and γ) →
`censored_svm` (what both share) → `regressor`, `calibration`, `classifier`.
"""
