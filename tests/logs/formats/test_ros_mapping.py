import inspect

import pytest

from halfseen.errors import ArgumentError
from halfseen.logs.formats import MAPPING_TEMPLATE, read_mapping

SMALLEST = """
[action]
topic = "/a"
field = "data"
[reward]
topic = "/r"
field = "data"
[ending]
topic = "/e"
field = "data"
"""


def read(tmp_path, text):
    (tmp_path / "cell.toml").write_text(text)
    return read_mapping(tmp_path / "cell.toml")


def test_the_template_is_a_whole_mapping(tmp_path):
    mapping = read(tmp_path, MAPPING_TEMPLATE)
    assert [source.key for source in mapping.sources] == [
        *("path", "covariates.occlusion", "cloud", "action", "object", "probability", "reward", "ending")
    ]
    assert (mapping.action.topic, mapping.action.field) == ("/pick/action", "data")
    assert mapping.finished == ("finished",)


def test_the_example_of_the_documentation_says_the_same_as_the_template(tmp_path):
    example = inspect.cleandoc(read_mapping.__doc__ or "").partition("are needed::")[2]
    assert read(tmp_path, example) == read(tmp_path, MAPPING_TEMPLATE)


def test_the_smallest_mapping_has_three_tables(tmp_path):
    mapping = read(tmp_path, SMALLEST)
    assert [source.topic for source in mapping.sources] == ["/a", "/r", "/e"]
    assert mapping.clock == "log"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[reward]", "[rewards]", r"cell\.toml, rewards: it is unknown; there are clock, path, .*reward"),
        ('[reward]\ntopic = "/r"\nfield = "data"\n', "", r"cell\.toml, reward: it is missing; say which topic"),
        ('topic = "/r"\n', "", r"cell\.toml, reward\.topic: it is missing"),
        ('topic = "/r"', "topic = 3", r"cell\.toml, reward\.topic: 3 is no text"),
        ('topic = "/r"', 'topic = ""', r"cell\.toml, reward\.topic: '' is no text"),
        (
            'topic = "/r"',
            'topic = "/r"\ntype = "x"',
            r"cell\.toml, reward\.type: it is unknown; there are topic, field",
        ),
        ("[action]", 'clock = "sim"\n[action]', r"cell\.toml, clock: 'sim' is none of 'log', 'publish', 'header'"),
        ("[action]", "covariates = 1\n[action]", r"cell\.toml, covariates: 1 is no table"),
        ("[action]", "path = 1\n[action]", r"cell\.toml, path: 1 is no table"),
        (
            "[action]",
            "[covariates.reward]\ntopic='/x'\nfield='data'\n[action]",
            r"covariates\.reward: stages have such",
        ),
        ("[action]", "[covariates.x]\ntopic='/x'\n[action]", r"covariates\.x\.field: it is missing"),
        ('topic = "/e"', 'topic = "/e"\nfinished = []', r"ending\.finished: \[\] is no list of values"),
        ('topic = "/e"', 'topic = "/e"\nfinished = "done"', r"ending\.finished: 'done' is no list of values"),
        ("[action]", "[action", r"cell\.toml: it is no TOML .*line 2"),
    ],
)
def test_a_broken_mapping_is_told_with_file_and_key(tmp_path, old, new, message):
    assert old in SMALLEST
    with pytest.raises(ArgumentError, match=message) as told:
        read(tmp_path, SMALLEST.replace(old, new, 1))
    assert "\n" not in str(told.value)


def test_a_missing_mapping_names_the_template(tmp_path):
    with pytest.raises(ArgumentError, match=r"none\.toml: it cannot be read .*--mapping-template"):
        read_mapping(tmp_path / "none.toml")
