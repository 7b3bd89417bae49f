"""The censored SVM (paper, eqs. 1 and 2): min over f of λ‖f‖² + (1/n) Σ_i w_i L(Y(T_i), f(Z_i)).

The times T_i may be right-censored; w_i are the inverse-probability-of-censoring weights.

Read down, in the order of the work. What is minimised: `rows` (Y, of times that may be cut, w, and what is held out) →
`losses` (L) → `kernels` (‖f‖), `nystrom` (when there are many rows). How: `newton` (smooth functions) → `solver` (all
losses, and the duality gap). The estimators: `machine` (what both share) → `estimators`.
"""
