"""A known model → what a team does: what learning is compared with.

Read down: `effort` (what seconds cost) → `round_robin`, `reservation` (rules of thumb) → `myopic` (the look-ahead of
one step, with WAIT in it) → `unknown` (what nobody knows, drawn from what is seen) → `rollout` (futures in which all
robots follow a rule, improved one robot at a time). What they are measured by: `grid_grasping`, `grid_model`,
`grid_events`, `grid_optimum` (the best there is, on small tables), `regret`.
"""
