"""Laws of grasping, durations and seeing, estimated from a cell's attempts.

`attempts` (logs → attempts, labels, shares) → `fits` (the laws of grasping, durations and seeing) → `law` (all of them,
a world under them, and their folder, with `figures`).
The attempts themselves come from a campaign: `halfseen.cell.campaign.attempts_of`.
"""
