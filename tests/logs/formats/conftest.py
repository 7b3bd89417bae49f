import pytest

from bags import WITHOUT_CLOUD, mapping_for, tables_of, write_bag, write_mcap
from halfseen.logs.formats import read_bag, read_event_table


@pytest.fixture
def mapping(tmp_path):
    def write(told=WITHOUT_CLOUD):
        (tmp_path / "cell.toml").write_text(told if isinstance(told, str) else tables_of(told))
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
    return lambda messages, told=WITHOUT_CLOUD, **options: read_bag(bag(messages), mapping(told), **options)


@pytest.fixture
def read_mcap(tmp_path, mapping):
    """Read messages from MCAP in some encoding."""

    def read(messages, encode, told=None, name="a.mcap", **options):
        file = mapping(mapping_for(encode) if told is None else told)
        return read_bag(write_mcap(tmp_path / name, messages, encode, **options), file)

    return read


@pytest.fixture
def read_table(tmp_path):
    """Read text by a mapping."""

    def write_and_read(text, mapping, encoding="utf-8", name="events.csv"):
        (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
        (tmp_path / "cell.toml").write_text(mapping, encoding="utf-8")
        return read_event_table(tmp_path / name, tmp_path / "cell.toml")

    return write_and_read
