"""Laws that are estimated from what a cell tried, not assumed.

`attempts` (logs → attempts, labels, shares) → `grasping` (the law of grasping, also as a predictor) → `law` (all of
them, and a world under them) → `law_folder` (on disk, with `figures` of it).
The attempts themselves are a campaign: `halfseen.cell.campaign.attempts_of`.
"""
