"""Folders named after a column and its value, such as ``run=7/part-0.parquet``, as Hive and Spark write them."""

from itertools import takewhile
from pathlib import Path
from urllib.parse import unquote

_NULL = "__HIVE_DEFAULT_PARTITION__"


def partition_of(file: Path) -> dict[str, str]:
    """Columns and values after which the folders of a file are named; no value is an empty text."""
    names = takewhile(lambda name: "=" in name, (folder.name for folder in file.parents))
    pairs = (name.partition("=") for name in names)
    return {unquote(column): "" if value == _NULL else unquote(value) for column, _, value in pairs}
