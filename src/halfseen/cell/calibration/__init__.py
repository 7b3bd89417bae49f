"""Laws that are estimated from what a cell tried, not assumed.

Read down: `trials` (logs → attempts and glances) → `grasp_fit`, `time_fit`, `seeing_fit` (one law each) → `law` (all of
them, and a world that takes them) → `law_folder` (on disk, with `pictures` of it: `held_figure`, `labels_figure`).
Beside it: `held_given_past` (the law of grasping as a predictor), `clustered_share` (shares with intervals).
"""
