import json

import pytest

from drawn_tables import Can, draw
from halfseen.errors import ArgumentError
from halfseen.perception import Label, LabelFile, Labeller, perceive, read_labels
from halfseen.perception.labels import share_in_view

ROWS = [{"object": 2, "label": "unknown"}, {"object": 0, "label": "dirty", "share_in_view": 0.25}]
ROWS += [{"object": 1, "label": "clean"}]
TOLD = (Label(True, 0.25), Label(False), Label(None))


def test_csv_and_json_say_the_same(tmp_path):
    (tmp_path / "a.csv").write_text("\ufefflabel, object, share_in_view\nunknown,2,\ndirty,0,0.25\n\nclean,1,\n")
    (tmp_path / "a.json").write_text(json.dumps(ROWS))
    assert read_labels(tmp_path / "a.csv", 3) == read_labels(tmp_path / "a.json", 3) == TOLD


def test_the_share_in_view_is_that_of_the_view_unless_the_file_says(tmp_path):
    drawn = draw(Can(-0.15, 0.0), Can(0.15, 0.0), Can(0.0, 0.1))
    view = perceive(drawn.cloud)
    assert len(view.objects) == 3
    (tmp_path / "a.json").write_text(json.dumps(ROWS))
    labeller = LabelFile(tmp_path / "a.json")
    assert isinstance(labeller, Labeller)
    labels = labeller(view, drawn.cloud)
    assert [label.word for label in labels] == ["dirty", "clean", "unknown"]
    assert [label.share_in_view for label in labels] == [0.25, *(share_in_view(seen) for seen in view.objects[1:])]


BAD = {
    "word": ("a.csv", "object,label\n0,filthy\n1,clean\n", "row 1: label is 'filthy'; give dirty, clean, unknown"),
    "empty word": ("a.csv", "object,label\n0,\n1,clean\n", "row 1: label is ''"),
    "word of another kind": ("a.json", '[{"object": 0, "label": ["dirty"]}]', r"row 1: label is \['dirty'\]"),
    "missing": ("a.csv", "object,label\n0,dirty\n", "object 1 of 2 has no label"),
    "twice": ("a.csv", "object,label\n0,dirty\n0,clean\n", "row 2: object 0 is labelled before"),
    "too many": ("a.csv", "object,label\n0,dirty\n1,clean\n2,clean\n", "row 3: object is '2', and the view has"),
    "negative": ("a.json", '[{"object": -1, "label": "dirty"}]', "row 1: object is -1"),
    "no number": ("a.csv", "object,label\nmug,dirty\n", "row 1: object is 'mug'"),
    "true": ("a.json", '[{"object": true, "label": "dirty"}]', "row 1: object is True"),
    "share": ("a.csv", "object,label,share_in_view\n0,dirty,1.5\n", "row 1: share_in_view is '1.5'"),
    "share as text": ("a.json", '[{"object": 0, "label": "dirty", "share_in_view": "all"}]', "share_in_view is 'all'"),
    "share of another kind": ("a.json", '[{"object": 0, "label": "dirty", "share_in_view": []}]', "share_in_view is"),
    "no head": ("a.csv", "0,dirty\n1,clean\n", "row 1 has 0, dirty; it has object, label"),
    "no label": ("a.csv", "object\n0\n", "row 1 has object; it has object, label"),
    "more columns": ("a.csv", "object,label,colour\n0,dirty,red\n", "row 1 has object, label, colour"),
    "ragged": ("a.csv", "object,label\n0,dirty,1\n", "row 1 has 3 cells, and the first line 2"),
    "empty": ("a.csv", "", "object 0 of 2 has no label"),
    "no list": ("a.json", '{"object": 0, "label": "dirty"}', "it is no list of objects"),
    "no JSON": ("a.json", "{", "it cannot be read as labels"),
    "binary": ("a.csv", b"\xff\xfe\x00", "it cannot be read as labels"),
    "suffix": ("a.txt", "object,label\n0,dirty\n", r"ends in \.csv or \.json"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, case):
    name, content, message = BAD[case]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ArgumentError, match=message) as caught:
        read_labels(tmp_path / name, 2)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
