"""What must hold for a log: the invariants that each trajectory, stage, object and robot keeps.

Read down: `trajectories` (each ends once) → `robots` (no two at one object) → `stages` (numbered without gaps, on a
clock that runs) → `objects` (each belongs to a stage).
"""
