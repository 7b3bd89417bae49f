"""Perception of a table from a depth camera: cloud → table plane → objects → mutual occlusion.

Reading order: `clouds` (depth cameras and their point clouds), `frames` (the camera of a pixel grid and the frame of
the points), `pcd`, `cloud_files` (file formats) → `range_image` → `plane` (the table) → `objects` (sheets above it) →
`solids` (completed shapes), `walls` (residuals of points), `marquardt` (least squares), `vessel_fits` → `grouping`
(sheets → objects) → `occlusion` (silhouettes, hidden ends, and who hides whom) → `view` (the whole pipeline) →
`picture`, `tracking` (matching of objects between looks); `labels` (which objects look dirty).
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
