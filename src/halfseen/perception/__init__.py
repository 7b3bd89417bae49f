"""What a depth camera sees on a table: cloud → table plane → objects → who hides whom.

Read down: `clouds` (a depth camera, and what it returned), `frames` (which camera a pixel grid shows, and which frame
points are in), `pcd`, `cloud_files` (the files that hold them) → `range_image` → `plane` (the table) → `objects`
(sheets above it) → `solids` (what completes them), `walls` (by how much points miss them), `marquardt` (making that
small), `vessel_fits` → `grouping` (sheets → objects) → `occlusion` (silhouettes, hidden ends, and who hides whom) →
`view` (all of it) → `picture`, `tracking` (which object is which of the look before); `labels` (what looks dirty).
"""

from halfseen.perception.cloud_files import read_cloud
from halfseen.perception.clouds import XTION, Cloud, DepthSensor, DisparitySensor
from halfseen.perception.labels import Label, LabelFile, Labeller, StainCounter, read_labels
from halfseen.perception.pcd import write_pcd
from halfseen.perception.plane import Plane
from halfseen.perception.view import SeenObject, View, perceive

__all__ = [
    "XTION",
    "Cloud",
    "DepthSensor",
    "DisparitySensor",
    "Label",
    "LabelFile",
    "Labeller",
    "Plane",
    "SeenObject",
    "StainCounter",
    "View",
    "perceive",
    "read_cloud",
    "read_labels",
    "write_pcd",
]
