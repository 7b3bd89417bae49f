"""Tables of three cups before a coarse camera, for tests of what comes of a run: an arm clears them in seconds."""

from dataclasses import replace

from halfseen.scene import Table, read_table
from halfseen.scene.shipped import NUM_TABLES


def small_table(seed):
    """Three cups of a table that ships, before a camera of half the rows and columns."""
    table = read_table(seed % NUM_TABLES)
    (fx, fy), (cx, cy) = table.camera.focal_px, table.camera.centre_px
    shape = {"num_rows": table.camera.num_rows // 2, "num_columns": table.camera.num_columns // 2}
    camera = replace(table.camera, focal_px=(fx / 2, fy / 2), centre_px=((cx - 0.5) / 2, (cy - 0.5) / 2), **shape)
    return Table(table.cups[:3], table.world_from_cup[:3], camera, f"small table {seed}")


def draw_small_tables(monkeypatch):
    """Let cells draw such tables, all in this process: others would draw tables of full size."""
    monkeypatch.setattr("halfseen.cell.campaign.random_table", small_table)
    monkeypatch.setattr("halfseen.workers.workers.num_cores", lambda: 1)
