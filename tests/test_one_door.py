import io
import json
import os
import socket
import tracemalloc
import zipfile

import numpy as np
import pytest

from halfseen import reading
from halfseen.reading import (
    check_unpacked,
    json_of,
    opened_text,
    read_arrays,
    read_bytes,
    read_text,
    toml_of,
)


def test_a_file_and_what_a_link_leads_to_are_read(tmp_path):
    (tmp_path / "a").write_bytes("größer\r\n".encode())
    (tmp_path / "link").symlink_to("a")
    assert read_bytes(tmp_path / "link") == (tmp_path / "a").read_bytes()
    assert read_text(tmp_path / "a") == "größer\r\n"
    with opened_text(tmp_path / "a") as file:
        assert file.readline() == "größer\r\n"


def test_what_is_no_file_is_refused_and_nothing_hangs(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        for name, kind in (("pipe", "a pipe"), ("socket", "a socket"), (".", "a folder"), ("zero", "a device")):
            with pytest.raises(OSError, match=f"it is {kind}, not a file"):
                read_bytes(tmp_path / name)
    with pytest.raises(OSError, match=r"the link leads to /dev/zero"):
        read_text(tmp_path / "zero")
    with pytest.raises(FileNotFoundError):
        read_bytes(tmp_path / "none")


def test_a_pipe_that_takes_the_place_of_a_file_is_neither_waited_for_nor_read(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr("halfseen.reading.check_file", lambda *_: 0)
    with pytest.raises(OSError, match="it is a pipe, not a file"):
        read_bytes(tmp_path / "pipe")


def test_no_more_memory_is_asked_for_than_a_file_has(tmp_path):
    (tmp_path / "a").write_bytes(bytes(1000))
    tracemalloc.start()
    read_bytes(tmp_path / "a", reading.NUMBERS)
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < 10**6


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(2, "No such file or directory", "a"), "No such file or directory"),
        (ValueError("line 1\nline 2"), "line 1"),
        (KeyError("trajectories"), "it lacks 'trajectories'"),
        (TypeError("'NoneType' object is not subscriptable"), "its parts do not fit together"),
        (ValueError("1 validation error for MetaData"), "its parts do not fit together"),
        (RuntimeError(), "RuntimeError"),
        (ValueError("x" * 300), "x" * 200),
    ],
)
def test_the_reason_is_one_short_line_for_users(error, message):
    assert reading.reason_of(error) == message


def test_a_file_that_is_too_large_is_refused_unless_that_is_meant(tmp_path, monkeypatch):
    with (tmp_path / "a").open("wb") as file:
        file.truncate(70 * 10**6)  # a hole: nothing is written
    with pytest.raises(OSError, match=r"70 MB, and at most 32 MB are read; .* set HALFSEEN_LARGEST_MB"):
        read_bytes(tmp_path / "a")
    monkeypatch.setenv(reading.LARGEST_MB, "71")
    assert len(read_bytes(tmp_path / "a")) == 70 * 10**6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested more than 64 levels"),
        ("[" * 66 + "]" * 66, "nested more than 64 levels"),
        ('{"a":' * 200 + "1" + "}" * 200, "nested more than 64 levels"),
        ("NaN", "NaN is not a JSON number"),
        ("[1e999]", "1e999 is not a JSON number"),
        ("9" * 5000, "not a 64-bit whole number"),
        (str(2**64), "not a 64-bit whole number"),
        ("{", "Expecting"),
        (b"\xff\xfe\x00", "decode"),
        ('{"a": {"b": 1, "c": 2, "b": 1}}', "'b' is given twice in an object"),
    ],
)
def test_json_that_would_do_harm_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        json_of(text)


def test_half_a_character_is_no_text():
    assert json_of('{"a": ["\\ud83d\\ude00"]}') == {"a": ["\U0001f600"]}
    for half in ('{"a": ["\\ud83d"]}', '{"\\uD83D": 1}', b'["\\ud83d"]', b'["\xed\xa0\xbd"]'):
        with pytest.raises(ValueError, match=r"'\\ud83d' is half of a character"):
            json_of(half)


def test_other_json_is_read_as_ever():
    value = {"a": [1, -(2**63), 2**64 - 1, 0.1, 1e-320, None, True, "]" * 100], "b": {"ö": []}}
    assert json_of(json.dumps(value)) == value
    assert json_of("[" * 64 + "]" * 64)


def test_numbers_that_json_does_not_have_are_read_where_that_is_meant():
    read = json_of(f'{{"a": [NaN, -Infinity, 1e999, {2**70}, {2**63}, 1700000000000000001]}}', any_number=True)["a"]
    assert np.isnan(read[0])
    assert read[1:] == [-np.inf, np.inf, 2.0**70, 2**63, 1700000000000000001]
    assert [type(each) for each in read[4:]] == [int, int]


def test_toml_is_read_and_one_too_deep_is_refused():
    assert toml_of("a = [1]\n[b]\nc = 2.5\n") == {"a": [1], "b": {"c": 2.5}}
    for deep in ("a = " + "[" * 50_000, "a = " + "[" * 70 + "]" * 70, ".".join(["a"] * 200) + " = 1"):
        with pytest.raises(ValueError, match="nested more than 64 levels"):
            toml_of(deep)


def test_arrays_come_back_and_only_those_asked_for(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(["x"]), "c": np.asfortranarray(np.eye(3))}
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    for name, array in read_arrays(tmp_path / "a.npz").items():
        np.testing.assert_array_equal(array, arrays[name])
    assert list(read_arrays(tmp_path / "a.npz", ("b", "none"))) == ["b"]


def member(header, data=b""):
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue() + data


def test_arrays_that_state_more_than_is_there_are_refused_before_they_are_asked_for(tmp_path):
    bad = {
        "more than it holds": (member({"descr": "<f8", "fortran_order": False, "shape": (10**15,)}), "announces"),
        "objects": (member({"descr": "|O", "fortran_order": False, "shape": (1,)}, b"x"), "never pickled"),
        "nothing": (b"", "EOF|magic"),
    }
    for content, message in bad.values():
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            archive.writestr("a.npy", content)
        with pytest.raises(ValueError, match=message):
            read_arrays(tmp_path / "a.npz")
    for content in (b"", b"hello there", b"PK\x03\x04" + b"\0" * 100):
        (tmp_path / "a.npz").write_bytes(content)
        with pytest.raises(ValueError, match=r"cut short, or not an .npz file"):
            read_arrays(tmp_path / "a.npz")


def test_a_bomb_is_refused_by_what_it_states(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "ALWAYS_UNPACKED", 10**6)
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**6))
    with pytest.raises(OSError, match="unpacked, it has 8 MB, and at most"):
        read_arrays(tmp_path / "a.npz")


def test_what_unpacks_as_usual_passes():
    check_unpacked(10, 200 * 10**6)
    check_unpacked(10**9, 10**10)
    with pytest.raises(OSError, match="unpacked, it has 5,000 MB"):
        check_unpacked(10**6, 5 * 10**9)
