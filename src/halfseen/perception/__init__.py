"""What a depth camera sees on a table: cloud → table plane → objects → who hides whom.

Read down: `clouds` (what a camera returned), `sensor` (how far it errs, and which camera a pixel grid shows), `frames`
(which frame points are in), `formats` (the files that hold them) → `range_image` → `plane` (the table) → `objects`
(sheets above it) → `solids` (what completes them), `walls` (by how much points miss them), `marquardt` (making that
small), `vessel_fits` → `silhouette` → `splitting`, `grouping` (sheets → objects) → `occlusion` (hidden ends, and who
hides whom) → `view` (all of it) → `picture`, `tracking` (which object is which of the look before); `labels` (what
looks dirty), `label_files`; `kind` (are these cups at all).
"""

from halfseen.perception.clouds import Cloud
from halfseen.perception.formats import read_cloud, write_pcd
from halfseen.perception.label_files import LabelFile, read_labels
from halfseen.perception.labels import Label, Labeller, StainCounter
from halfseen.perception.plane import Plane
from halfseen.perception.sensor import XTION, DepthSensor, DisparitySensor
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
