"""Displays: reports of a log and a policy, pictures of decisions, and runs stage by stage, also in 3-D.

Reports: `log_findings` and `policy_findings` (numbers) → `findings` → `words`, `log_figures`, `policy_figures` (text
and figures) → `page`. Decisions: `decision_picture`. Runs: `shapes` (solids, shadows, occlusion) → `stage_view` (one
stage, independent of its source) → `stages`, `cell_watch` (sources of stages); two back ends draw a stage: `recording`
(pictures, and stages in a folder) and `viewer` (3-D, a page or a file).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.view.cell_watch import CellWatch
    from halfseen.view.recording import read_recording, write_recording
    from halfseen.view.stage_view import Hand, Option, Part, Shown, StageView, Watched
    from halfseen.view.stages import watched_cloud, watched_logs

__all__ = [
    "CellWatch",
    "Hand",
    "Option",
    "Part",
    "Shown",
    "StageView",
    "Watched",
    "read_recording",
    "watched_cloud",
    "watched_logs",
    "write_recording",
]

_NAMES = {
    "cell_watch": "CellWatch",
    "recording": "read_recording write_recording",
    "stage_view": "Hand Option Part Shown StageView Watched",
    "stages": "watched_cloud watched_logs",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
