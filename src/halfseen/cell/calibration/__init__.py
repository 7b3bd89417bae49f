"""Laws that are estimated from what a cell tried, not assumed.

`attempts` (logs → attempts, labels, shares) → `fits` (the laws of grasping, of times and of seeing) → `law` (all of
them, a world under them, and its folder, with `figures` of it).
The attempts themselves are a campaign: `halfseen.cell.campaign.attempts_of`.
"""
