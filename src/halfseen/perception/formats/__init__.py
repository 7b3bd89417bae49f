"""Files that hold clouds, one file a format: PCD, PLY, and NPZ with a depth image."""

from halfseen.perception.formats.pcd import write_pcd
from halfseen.perception.formats.reading import read_cloud

__all__ = ["read_cloud", "write_pcd"]
