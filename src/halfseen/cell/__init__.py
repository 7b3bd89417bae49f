"""The physical cell: arms that try what they planned from their own cloud.

Read down: `contacts` (what holds in simulated contact) → `arm`, `gripper` (what moves) → `cup_walls` (what is held) →
`model` (room, cups, rack and arms as one MuJoCo model) → `kinematics` (where a hand is, and how it gets there).
"""
