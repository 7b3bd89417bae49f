"""What a depth camera sees on a table: cloud → table plane → objects → who hides whom.

Read down: `clouds` (what a camera returned), `sensor` (how far it errs) → `range_image` → `plane` (the table) →
`objects` (sheets above it) → `solids` (what completes them), `polygons`, `silhouette` → `splitting`, `grouping`
(sheets → objects) → `extension` (hidden ends) → `occlusion` (who hides whom) → `view` (all of it) → `picture`.
"""

from halfseen.perception.clouds import Cloud, read_cloud, write_pcd
from halfseen.perception.plane import Plane
from halfseen.perception.sensor import XTION, DepthSensor, DisparitySensor
from halfseen.perception.view import SeenObject, View, perceive

__all__ = [
    "XTION",
    "Cloud",
    "DepthSensor",
    "DisparitySensor",
    "Plane",
    "SeenObject",
    "View",
    "perceive",
    "read_cloud",
    "write_pcd",
]
