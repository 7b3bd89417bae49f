"""The laws of the world, fitted to logged paths of which some were cut: what a planner plans with who knows no law.

Read down: `watched` (logs → attempts, as far as each was watched) → `grasping_fit` and `logistic_fit`, a family each;
`labels` (logs → what looks said, and what washing showed) → `seeing_fit` and `persistent_fit`, a family each;
`families` chooses. `halfseen.tables.fitted_world` puts them together.
"""
