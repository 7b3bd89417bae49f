import pytest

from halfseen.suggestions import closest, did_you_mean

KNOWN = ["mass", "size", "Shine_2", 7]


@pytest.mark.parametrize(("given", "meant"), [("maas", "mass"), ("MASS", "mass"), ("shine2", "Shine_2"), ("zzz", None)])
def test_the_closest_name(given, meant):
    assert closest(given, KNOWN) == meant


def test_the_question_ends_a_message_or_is_left_out():
    assert did_you_mean("siez", KNOWN) == "; did you mean 'size'?"
    assert did_you_mean("zzz", KNOWN) == ""
    assert did_you_mean("size", []) == ""
