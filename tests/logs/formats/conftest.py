import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bags import WITHOUT_CLOUD, mapping_for, tables_of, write_bag, write_mcap
from halfseen.logs.formats import mapping_of, read_bag, read_event_table


@pytest.fixture
def mapping(tmp_path):
    def write(message=WITHOUT_CLOUD):
        (tmp_path / "cell.toml").write_text(message if isinstance(message, str) else tables_of(message))
        return tmp_path / "cell.toml"

    return write


@pytest.fixture
def bag(tmp_path):
    def write(messages, name="bag", storage="mcap"):
        return write_bag(tmp_path / name, messages, storage)

    return write


@pytest.fixture
def read(bag, mapping):
    """Read messages from a bag of ROS."""
    return lambda messages, message=WITHOUT_CLOUD, **options: read_bag(bag(messages), mapping(message), **options)


@pytest.fixture
def read_mcap(tmp_path, mapping):
    """Read messages from MCAP in some encoding."""

    def read(messages, encode, message=None, name="a.mcap", **options):
        file = mapping(mapping_for(encode) if message is None else message)
        return read_bag(write_mcap(tmp_path / name, messages, encode, **options), file)

    return read


@pytest.fixture
def read_table(tmp_path):
    """Read text, or a table as Parquet, by a mapping."""

    def write_and_read(content, mapping, encoding="utf-8", name="events.csv", missing=None):
        file = tmp_path / ("t.parquet" if isinstance(content, pa.Table) else name)
        if isinstance(content, pa.Table):
            pq.write_table(content, file)
        else:
            file.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
        (tmp_path / "cell.toml").write_text(mapping, encoding="utf-8")
        return read_event_table(file, tmp_path / "cell.toml", missing=missing)

    return write_and_read


@pytest.fixture
def draft(tmp_path):
    """Draft the mapping of a text; these lines are in it."""

    def write_and_draft(text, *lines, encoding="utf-8"):
        (tmp_path / "draft.csv").write_text(text, encoding=encoding)
        made = mapping_of(tmp_path / "draft.csv")
        assert [line for line in lines if line not in made.splitlines()] == []
        return made

    return write_and_draft
