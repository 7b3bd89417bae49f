"""Laws as they may be fitted to a cell, and what a plain reading of them says."""

from halfseen.world import FittedGrasping, PersistentSeeing, WorldConfig

GRASPING = FittedGrasping(
    log_odds=2.0,
    log_odds_per_occlusion=-1.5,
    offset_std=0.8,
    log_held_s=1.6,
    log_missed_s=1.1,
    log_std=0.4,
    limit_s=8.0,
)
SEEING = PersistentSeeing(
    facing=0.6,
    views=(0.2, 0.5, 0.6, 1.0),
    sensitivity=(0.2, 0.55, 0.6, 0.95),
    false_alarms=(0.02, 0.06, 0.1, 0.2),
)
FITTED = WorldConfig(grasping=GRASPING, seeing=SEEING)
