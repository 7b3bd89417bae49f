"""Several arms at one table, in one clock, in physics.

Read down: `pair` (where two arms stand) → `volumes` (the space that an arm takes) → `reservations` (who has which) →
`crew` (arms that move together; waits, and who gives way) → `touches` (what must not happen) → `team_table` (the state
that a team decides in, and the columns of its log) → `team_episode` (one table to its end).
"""
