"""Whether an SQLite file, such as a database or a bag, is whole."""

import os
from pathlib import Path

from halfseen.reading import TABLE, opened


def check_sqlite(path: Path) -> None:
    """Refuse an SQLite file that is shorter than its header says, of which SQLite may read the rest without a word.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It was cut off. One that is not of SQLite, or beside which a write-ahead log lies, is not judged.
    """
    with opened(path, TABLE) as file:
        header, num_bytes = file.read(100), os.fstat(file.fileno()).st_size
    is_counted = header[24:28] == header[92:96]  # the number of pages belongs to the last change
    if not header.startswith(b"SQLite format 3\0") or not is_counted or path.with_name(f"{path.name}-wal").exists():
        return
    page_bytes = int.from_bytes(header[16:18]) if header[16:18] != b"\0\1" else 65536
    whole_bytes = page_bytes * int.from_bytes(header[28:32])
    if num_bytes < whole_bytes:
        raise ValueError(f"it is cut off: of {whole_bytes:,} bytes {num_bytes:,} are there")
