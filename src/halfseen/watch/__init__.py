"""Watching: what was seen, decided and done, in 3-D and stage by stage, with the reasons.

Read down: `shapes` (solids as meshes, their shadows, what they hide) → `stage_view` (one stage as it is shown: plain
data, whatever it comes from) → `seen_objects` (a view's objects as they are shown) → `of_cloud`, `of_cell`, `of_logs`
(where stages come from) → `recording` (stages in a folder) → `wording` (a stage in words) → `drawing` (a stage in the
viewer), `page` (its controls, served on this machine), `standalone` (one file that opens without a server), `moving`
(an animated picture).

The viewer is viser. MuJoCo's own web viewer was tried beside it: it draws a MuJoCo model, so that each point of a cloud
would be a geom (with 20,000 of the 300,000, Chromium on a software renderer stopped answering), its controls are drawn
into the canvas, where no narrow screen can rearrange them, and it needs its server; viser draws points as points and
keeps a scene as one file.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.watch.of_cell import CellWatch
    from halfseen.watch.of_cloud import watched_cloud
    from halfseen.watch.of_logs import watched_logs
    from halfseen.watch.recording import read_recording, write_recording
    from halfseen.watch.stage_view import Hand, Option, Part, Shown, StageView, Watched

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

__getattr__ = lazy_names(
    __name__,
    {
        "CellWatch": "of_cell",
        "Hand": "stage_view",
        "Option": "stage_view",
        "Part": "stage_view",
        "Shown": "stage_view",
        "StageView": "stage_view",
        "Watched": "stage_view",
        "read_recording": "recording",
        "watched_cloud": "of_cloud",
        "watched_logs": "of_logs",
        "write_recording": "recording",
    },
)
