import pytest

from halfseen.errors import PolicyError
from halfseen.policies.ranges import beyond, refuse_far


def values(**of):
    return {name: {name: value} for name, value in of.items()}


@pytest.mark.parametrize(
    ("value", "is_refused"), [(-1.0, False), (-1.01, True), (5.0, False), (5.01, True), (2.0, False)]
)
def test_more_than_a_whole_range_beyond_an_end_is_refused(value, is_refused):
    ranges, told = {"x": (1.0, 3.0)}, values(x=value)
    if not is_refused:
        refuse_far(ranges, told)
        return
    with pytest.raises(PolicyError, match=r"^x is .*, outside the logs \(1 to 3\) by more than these span") as refusal:
        refuse_far(ranges, told)
    assert "--extrapolate" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_what_never_varied_is_taken_to_be_as_wide_as_its_value_is_large():
    refuse_far({"x": (4.0, 4.0), "y": (0.0, 0.0)}, values(x=8.0, y=1.0))
    for name, value in (("x", 8.1), ("y", 1.1)):
        with pytest.raises(PolicyError, match=f"^{name} is"):
            refuse_far({"x": (4.0, 4.0), "y": (0.0, 0.0)}, values(x=4.0, y=0.0) | values(**{name: value}))


def test_the_first_that_is_far_is_named():
    with pytest.raises(PolicyError, match=r"^b is 800,"):
        refuse_far({"a": (0.0, 1.0), "b": (0.1, 3.0)}, values(a=1.5, b=800.0))


def test_words_and_stages_that_no_path_came_to_are_not_refused():
    refuse_far(None, values(x=1e9))
    refuse_far({"x": {"red": 3}}, values(x="mauve"))
    assert beyond(None, {}) == ("no path of the logs came to this stage; Q is extrapolated",)
