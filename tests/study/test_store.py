import pytest

from halfseen.errors import ArgumentError
from halfseen.study.store import Store, as_json

DESIGN = {"seed": 0}


def again():
    raise AssertionError("it is there already")


def test_a_piece_comes_back_as_it_was_made(tmp_path):
    store = Store(tmp_path / "new" / "study", DESIGN, is_resumed=False)
    piece = {"values": [0.1, 1 / 3, 1e-300], "names": ["ö"]}

    assert store.kept("piece", lambda: piece) == piece
    assert store.kept("piece", again) == piece


def test_resuming_keeps_pieces_and_beginning_anew_drops_them(tmp_path):
    Store(tmp_path, DESIGN, is_resumed=False).kept("piece", lambda: [1])

    assert Store(tmp_path, DESIGN, is_resumed=True).kept("piece", again) == [1]
    assert Store(tmp_path, DESIGN, is_resumed=False).kept("piece", lambda: [2]) == [2]


def test_pieces_of_another_design_are_never_mixed_in(tmp_path):
    Store(tmp_path, DESIGN, is_resumed=False).kept("piece", lambda: [1])

    with pytest.raises(ArgumentError, match=r"--resume: .*belongs to a study of another design, seed or version"):
        Store(tmp_path, {"seed": 1}, is_resumed=True)
    assert Store(tmp_path, DESIGN, is_resumed=True).kept("piece", again) == [1]


@pytest.mark.parametrize("change", [("1.5", "1.6"), ('"sha256"', '"sha512"'), ("1.5", ""), ("{", "[")])
def test_a_piece_that_was_changed_is_not_believed(tmp_path, change):
    Store(tmp_path, DESIGN, is_resumed=False).keep("piece", {"value": 1.5})
    file = tmp_path / "piece.json"
    file.write_text(file.read_text().replace(*change, 1))
    with pytest.raises(ArgumentError, match=r"piece.json cannot be read .*; remove it and go on with --resume"):
        Store(tmp_path, DESIGN, is_resumed=True).read("piece")


def test_the_same_value_gives_the_same_bytes_and_nan_is_refused():
    assert as_json({"a": 1, "b": 2}) == as_json({"b": 2, "a": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        as_json(float("nan"))


def test_what_no_study_wrote_is_not_removed(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")

    with pytest.raises(ArgumentError, match=r"holds no study .design.json is missing., so it is not removed"):
        Store(tmp_path, DESIGN, is_resumed=False)
    assert (tmp_path / "notes.txt").read_text() == "mine"
