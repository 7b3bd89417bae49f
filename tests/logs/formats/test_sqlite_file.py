import os
import sqlite3
from contextlib import closing

import pytest

from halfseen.logs.formats.sqlite_file import check_sqlite


@pytest.mark.parametrize("page_bytes", [512, 65536])
def test_a_database_that_lacks_a_byte_is_refused_unless_its_log_may_hold_it(tmp_path, page_bytes):
    file = tmp_path / "a.db"
    with closing(sqlite3.connect(file)) as connection:
        connection.execute(f"PRAGMA page_size = {page_bytes}")
        connection.execute("CREATE TABLE a (b)")
        connection.execute("INSERT INTO a VALUES (zeroblob(200000))")
        connection.commit()
    check_sqlite(file)
    size = file.stat().st_size
    os.truncate(file, size - 1)
    with pytest.raises(ValueError, match=f"it is cut off: of {size:,} bytes {size - 1:,} are there"):
        check_sqlite(file)
    (tmp_path / "a.db-wal").touch()
    check_sqlite(file)
    (tmp_path / "other").write_bytes(b"DUCK" * 100)
    check_sqlite(tmp_path / "other")
