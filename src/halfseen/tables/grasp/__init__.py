"""How likely a grasp is to succeed, from logged attempts of which some were cut (paper, §3).

Read down: `attempts` (logs → attempts) → `inputs` (what a fit accepts) → `beta_grasp`, `svm_grasp` (the models) →
`grasp_table` (a model as a table, which policies carry) → `choice` (which model, by the attempts themselves).
"""
