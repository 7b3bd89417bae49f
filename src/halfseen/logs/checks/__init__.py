"""What must hold for a log: the invariants that each path, stage, object and robot keeps.

Read down: `paths` (each ends once) → `robots` (no two at one object) → `stages` (numbered without gaps, on a clock that
runs) → `objects` (each belongs to a stage).
"""
