"""The censored SVM (paper, eqs. 1 and 2): min over f of λ‖f‖² + (1/n) Σ_i w_i L(Y(T_i), f(Z_i)).

The times T_i may be right-censored; w_i are the inverse-probability-of-censoring weights.

The modules, in the order of the work. The objective: `rows` (targets Y, weights w, folds) → `losses` (L) → `kernels`
(‖f‖) → `nystrom` (low rank, for many rows). The optimisation: `newton` (smooth functions) → `solver` (all losses, and
the duality gap). The estimators: `machine` (the common base) → `estimators`.
"""
