"""The laws of the world, fitted to logged paths of which some were cut: what a planner plans with who knows no law.

Read down: `evidence` (logs → attempts, as far as each was watched, and what looks said) → `posterior` (what all fits
maximise) → `grasping` and `seeing`, two families of laws each. `halfseen.tables.fitted_world` puts them together.
"""
