"""Laws that are estimated from what a cell tried, not assumed.

Read down: `trials` (logs → attempts and glances) → `grasp_fit`, `time_fit`, `seeing_fit` (one law each) → `law` (all of
them, and a world that takes them) → `law_folder` (on disk).
"""
