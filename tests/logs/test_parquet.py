"""What a footer says of columns: as the library that wrote it says; anything else is reported or refused."""

import json
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from halfseen.errors import LogError
from halfseen.logs import read_logs
from halfseen.logs.parquet import MAGIC, chunks_of

TABLE = pa.table({"x": [0.5, None, 2.0] * 20, "name": ["a", "b", "a"] * 20, "lists": [[1, 2], [], None] * 20})


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    file = tmp_path_factory.mktemp("footer") / "table.parquet"
    pq.write_table(TABLE, file, row_group_size=7)
    return file


@pytest.mark.parametrize(("version", "num_rows"), [("1.0", 60), ("2.6", 60), ("2.6", 0)])
def test_chunks_are_those_that_the_library_tells_of(tmp_path, version, num_rows):
    nested = TABLE.append_column("of", pa.array([{"a": 1, "b": [{"c": "x"}]}] * 60)).slice(0, num_rows)
    pq.write_table(nested, tmp_path / "t.parquet", row_group_size=7, version=version, compression="zstd")
    result = pq.ParquetFile(tmp_path / "t.parquet").metadata
    groups = [result.row_group(k) for k in range(result.num_row_groups)]
    chunks = [[group.column(k) for k in range(result.num_columns)] for group in groups]
    wanted = [[(chunk.num_values, chunk.total_uncompressed_size) for chunk in group] for group in chunks]
    assert chunks_of(tmp_path / "t.parquet") == wanted


@given(st.data())
def test_a_broken_footer_is_reported_of_or_refused(file, tmp_path_factory, data):
    content = bytearray(file.read_bytes())
    num_bytes = int.from_bytes(content[-8:-4], "little")
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(len(content) - 8 - num_bytes, len(content) - 1))] = data.draw(st.integers(0, 255))
    broken = tmp_path_factory.mktemp("broken") / "t.parquet"
    broken.write_bytes(content)
    try:
        chunks_of(broken)
    except ValueError as error:
        assert str(error).startswith("its footer ")  # noqa: PT017


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"PAR1",
        b"\xff" * 40,
        b"\x80" * 10**5 + (10**5).to_bytes(4, "little") + MAGIC,
        b"\x1c" * 500 + (500).to_bytes(4, "little") + MAGIC,
        b"\x19\xfc\xff\xff\xff\xff\x0f" + (7).to_bytes(4, "little") + MAGIC,
    ],
    ids=["empty", "short", "no magic", "a number without end", "nested", "a list longer than the file"],
)
def test_what_is_no_footer_is_refused(tmp_path, content):
    (tmp_path / "t.parquet").write_bytes(content)
    with pytest.raises(ValueError, match="its footer"):
        chunks_of(tmp_path / "t.parquet")


def test_a_file_that_ends_the_library_s_process_is_refused(tmp_path):
    """Its footer has a histogram that is longer than there are levels: asked for a column, Arrow 26 dies."""
    broken = Path(__file__).with_name("histogram_too_long.parquet")
    tell = {"format": "halfseen-logs", "version": 2, "rows": {"stages": 3, "trajectories": 3}}
    (tmp_path / "logs.json").write_text(json.dumps(tell))
    for name in ("stages", "trajectories"):
        shutil.copy(broken, tmp_path / f"{name}.parquet")
    with pytest.raises(LogError, match="histogram size mismatch"):
        read_logs(tmp_path)
