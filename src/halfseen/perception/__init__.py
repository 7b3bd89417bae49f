"""What a depth camera sees on a table: cloud → table plane → objects → who hides whom."""

from halfseen.perception.clouds import Cloud, read_cloud, write_pcd

__all__ = ["Cloud", "read_cloud", "write_pcd"]
